"""What every registered environment has to be: Gymnasium's own check, deterministic, safe against nonsense, pictured."""

import gc
import pickle
import warnings
from pathlib import Path
from typing import Any

import gymnasium as gym
import mujoco
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from extremal.estimator import InvalidInput
from extremal.sim.buffers import thread_context
from extremal.sim.gl import select_backend
from extremal.sim.rendering import _Stage
from extremal.tasks import ENVIRONMENTS
from extremal.tasks.eye import _Drawing

NAMES = sorted(ENVIRONMENTS)


def made(name: str, **arguments: Any) -> gym.Env[Any, Any]:
    return gym.make(f"extremal.tasks:{name}", **arguments)


def equal(a: dict[str, Any], b: dict[str, Any]) -> bool:
    return a.keys() == b.keys() and all(np.array_equal(a[k], b[k]) for k in a)


def rollout(env: gym.Env[Any, Any], seed: int, steps: int = 6) -> list[dict[str, Any]]:
    rng = np.random.default_rng(seed)
    seen = [env.reset(seed=seed)[0]]
    for _ in range(steps):
        low, high = env.action_space.low, env.action_space.high  # pyright: ignore[reportAttributeAccessIssue]
        action = rng.uniform(0.2 * low, 0.2 * high)
        if "Inspect" in env.spec.id:  # pyright: ignore[reportOptionalMemberAccess]
            action[6] = -1  # go on
        observation, _, terminated, truncated, _ = env.step(action)
        seen.append(observation)
        if terminated or truncated:
            break
    return seen


@pytest.mark.parametrize("name", NAMES)
def test_gymnasium_has_nothing_to_say(name: str) -> None:
    env = made(name, render_mode="rgb_array").unwrapped
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env)
    env.close()


@pytest.mark.parametrize("name", NAMES)
def test_a_seed_is_an_episode(name: str) -> None:
    """The same in a used environment, a new one and an environment of another process; observations don't share memory."""
    env = made(name)
    first = rollout(env, 5)
    rollout(env, 6)
    for again in (rollout(env, 5), rollout(made(name), 5)):
        assert len(again) == len(first) and all(map(equal, first, again))
    assert not equal(first[0], rollout(env, 7)[0])
    assert not np.shares_memory(first[1]["features"], first[2]["features"])
    env.close()


@pytest.mark.parametrize("name", NAMES)
def test_nonsense_is_refused_or_clipped(name: str) -> None:
    env = made(name).unwrapped
    shape = env.action_space.shape or ()
    with pytest.raises(InvalidInput, match="reset"):
        env.step(np.zeros(shape))
    env.reset(seed=0)
    for action in (np.full(shape, np.nan), np.zeros(3), "left"):
        with pytest.raises((InvalidInput, ValueError)):
            env.step(action)
    observation, *_ = env.step(np.full(shape, 1e9))
    assert env.observation_space.contains(observation)
    with pytest.raises(InvalidInput, match="option is 'colour'; accepted: families"):
        env.reset(options={"colour": "red"})
    env.close()


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("sensor", "lidar"),
        ("obs_mode", "x"),
        ("action_mode", "x"),
        ("tier", "x"),
        ("arm", "x"),
        ("max_steps", 0),
    ],
)
def test_unknown_arguments_are_named(name: str, key: str, value: Any) -> None:
    with pytest.raises(InvalidInput, match=r"accepted: "):
        made(name, **{key: value})


@pytest.mark.parametrize("name", NAMES)
def test_pixels(name: str) -> None:
    """Images as observations, and the picture for people: two views side by side that are not blank."""
    env = made(name, obs_mode="both", render_mode="rgb_array")
    observation, _ = env.reset(seed=1)
    assert observation["rgb"].shape == (128, 128, 3) and observation["rgb"].std() > 5
    picture = env.render()
    assert isinstance(picture, np.ndarray) and picture.shape == (480, 1280, 3) and picture.dtype == np.uint8
    assert picture[:, :640].std() > 5 and picture[:, 640:].std() > 5
    env.close()


@pytest.mark.parametrize("name", NAMES)
def test_specs_can_be_pickled(name: str) -> None:
    env = made(name, max_steps=17)
    again = gym.make(pickle.loads(pickle.dumps(env.spec)))
    assert again.unwrapped.max_steps == 17  # pyright: ignore[reportAttributeAccessIssue]


def test_vectors_agree() -> None:
    """Two environments after each other, and in spawned processes: the same to the last bit."""
    name = "extremal.tasks:extremal/Navigate-v0"
    seen = []
    for mode, more in (("sync", {}), ("async", {"context": "spawn"})):
        envs = gym.make_vec(name, num_envs=2, vectorization_mode=mode, vector_kwargs=more)
        observations = [envs.reset(seed=[3, 4])[0]]  # pyright: ignore[reportArgumentType]
        for _ in range(4):
            observations.append(envs.step(np.full((2, 6), 0.1, np.float32))[0])
        envs.close()
        seen.append(observations)
    assert all(map(equal, *seen))


@pytest.mark.slow
def test_a_killed_worker_is_reported() -> None:
    envs = gym.make_vec(
        "extremal.tasks:extremal/Navigate-v0",
        num_envs=2,
        vectorization_mode="async",
        vector_kwargs={"context": "spawn"},
    )
    envs.reset(seed=0)
    envs.processes[0].kill()  # pyright: ignore[reportAttributeAccessIssue]
    with pytest.raises((EOFError, OSError)):  # its pipe is broken or at its end; a timeout is neither
        for _ in range(3):
            envs.step_async(np.zeros((2, 6), np.float32))  # pyright: ignore[reportAttributeAccessIssue]
            envs.step_wait(timeout=60)  # pyright: ignore[reportAttributeAccessIssue]
    for process in envs.processes:  # pyright: ignore[reportAttributeAccessIssue]
        process.kill()
    envs.closed = True  # pyright: ignore[reportAttributeAccessIssue]  nothing is left to talk to


def test_what_is_learnt_stays_out_of_the_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No log of MuJoCo's, nothing else either."""
    monkeypatch.chdir(tmp_path)
    env = made("extremal/Navigate-v0", obs_mode="both")
    rollout(env, 2, steps=2)
    env.close()
    assert list(tmp_path.iterdir()) == []


def test_gymnasium_records_videos(tmp_path: Path) -> None:
    env = gym.wrappers.RecordVideo(
        made("extremal/Inspect-v0", render_mode="rgb_array"), str(tmp_path / "videos"), disable_logger=True
    )
    env.reset(seed=0)
    for _ in range(3):
        env.step(np.array([0.1, 0, 0, 0, 0, 0, -1], np.float32))
    env.close()
    (video,) = (tmp_path / "videos").glob("*.mp4")
    assert video.stat().st_size > 1000


@pytest.mark.slow
def test_a_hundred_environments_leave_nothing() -> None:
    """Made, rendered and closed in one process: no OpenGL context stays, nor what draws in it, and after the first ones no more memory
    is taken."""
    import resource

    select_backend()

    def contexts() -> int:
        """MuJoCo's drawing contexts can't be counted by themselves, but by what holds one each."""
        gc.collect()
        return sum(isinstance(o, mujoco.GLContext | _Stage | _Drawing) for o in gc.get_objects())

    def grown(count: int) -> int:
        for i in range(count):
            env = made(NAMES[i % 3], obs_mode="both", sensor="rendered" if i % 5 == 0 else "geometric")
            env.reset(seed=0)
            assert contexts() > before
            env.close()
            assert contexts() == before
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss

    thread_context()  # stays with every thread that has drawn
    before = contexts()
    warm = grown(25)
    assert grown(75) - warm < 30_000  # [kB]
