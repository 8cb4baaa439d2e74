"""SHA-256 of all that environments give away on fixed episodes, and of their frames; the committed ones of the locked versions.

python tests/support/fingerprint.py --write      after a change that is meant to change them
"""

import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

NAMES = ("extremal/Grasp-v0", "extremal/Inspect-v0", "extremal/Navigate-v0")
SEED = 1_000_000
SHORT, STEPS = 20, 200
FILE = Path(__file__).parents[1] / "data" / "fingerprints.json"
PACKAGES = ("gymnasium", "mujoco", "numpy", "scipy")  # whose versions the committed ones are for
# Sums in floating point hang on the width of vector instructions: references are made with those that every x86-64 machine
# of the last ten years has.
PLAIN = {
    "OPENBLAS_CORETYPE": "Haswell",
    "OPENBLAS_NUM_THREADS": "1",
    "NPY_DISABLE_CPU_FEATURES": "X86_V4 AVX512_ICL AVX512_SPR",
    "LP_NUM_THREADS": "1",
}

Step = tuple[dict[str, Any], float, bool]
Prints = dict[str, str]


def made(name: str) -> gym.Env[Any, Any]:
    return gym.make(f"extremal.tasks:{name}", obs_mode="both")


def actions(space: gym.Space[Any], number: int, steps: int) -> np.ndarray:
    """Actions (steps, A) of environment `number`: to and fro sideways, so that there are features, and a little of all else; now
    and then the answer or the grasp that ends an episode."""
    at = np.arange(steps)
    chosen = np.random.default_rng([SEED, number]).uniform(-0.1, 0.1, (steps, *(space.shape or ())))
    chosen[:, 0] += 0.8 * np.cos(2 * np.pi * at / 24)
    chosen[:, 6:7] = np.where(at % 40 == 31, 1.0, -1.0)[:, None]
    return chosen.astype(np.float32)


def alone(env: gym.Env[Any, Any], steps: int, number: int = 0) -> Iterator[Step]:
    """What the environment gives, step by step; the step after an episode's last starts the next, as in Gymnasium's vectors."""
    yield env.reset(seed=SEED + number)[0], 0.0, False
    over = False
    for action in actions(env.action_space, number, steps):
        if over:
            observation, reward, over = env.reset()[0], 0.0, False
        else:
            observation, value, ended, truncated, _ = env.step(action)
            reward, over = float(value), ended or truncated
        yield observation, reward, over


def in_vector(envs: gym.vector.VectorEnv[Any, Any, Any], steps: int) -> Iterator[list[Step]]:
    """The same of all environments of a vector."""
    n = envs.num_envs

    def each(observations: dict[str, np.ndarray], rewards: np.ndarray, over: np.ndarray) -> list[Step]:
        return [
            ({k: v[i] for k, v in observations.items()}, float(rewards[i]), bool(over[i])) for i in range(n)
        ]

    seeds: Any = [SEED + i for i in range(n)]
    yield each(envs.reset(seed=seeds)[0], np.zeros(n), np.zeros(n, bool))
    for action in np.stack([actions(envs.single_action_space, i, steps) for i in range(n)], axis=1):
        observations, rewards, ended, truncated, _ = envs.step(action)
        yield each(observations, rewards, ended | truncated)


def prints(steps: Iterator[Step]) -> Prints:
    """SHA-256 of observations with rewards and ends, and of frames, after SHORT steps and after all."""
    told, frames, found = hashlib.sha256(), hashlib.sha256(), {}
    done = 0
    for done, (observation, reward, over) in enumerate(steps):
        for key in sorted(observation):
            value = np.ascontiguousarray(observation[key])
            into = frames if key == "rgb" else told
            into.update(f"{key} {value.dtype.str} {value.shape} ".encode() + value.tobytes())
        told.update(np.array([reward, over], "<f8").tobytes())
        if done == SHORT:
            found |= {f"observations {done}": told.hexdigest(), f"frames {done}": frames.hexdigest()}
    return found | {f"observations {done}": told.hexdigest(), f"frames {done}": frames.hexdigest()}


def fresh(name: str, steps: int, number: int = 0) -> Prints:
    """Of a new environment."""
    env = made(name)
    found = prints(alone(env, steps, number))
    env.close()
    return found


def reused(name: str, steps: int) -> Prints:
    """Of one that was used for something else before."""
    env = made(name)
    for _ in alone(env, 3, number=7):
        pass
    found = prints(alone(env, steps))
    env.close()
    return found


def vector(mode: str, name: str, steps: int, number: int = 0) -> Prints:
    """Of one of two environments of a vector, "sync" or "async" in spawned processes."""
    kwargs = {"context": "spawn"} if mode == "async" else {}
    make: Callable[..., gym.vector.VectorEnv[Any, Any, Any]] = gym.make_vec
    envs = make(f"extremal.tasks:{name}", 2, vectorization_mode=mode, vector_kwargs=kwargs, obs_mode="both")
    found = prints(every[number] for every in in_vector(envs, steps))
    envs.close()
    return found


def elsewhere(
    names: Sequence[str], steps: int, environment: dict[str, str] | None = None
) -> dict[str, Prints]:
    """Of fresh ones in a new process, with further environment variables."""
    told = subprocess.run(
        [sys.executable, __file__, str(steps), *names],
        env=os.environ | (environment or {}),
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    ).stdout
    return json.loads(told.splitlines()[-1])


def installed() -> dict[str, str]:
    """The versions that floating-point results hang on."""
    return {name: version(name) for name in PACKAGES}


def opengl() -> str:
    """The renderer: frames are the same for the same one only."""
    from extremal.sim.gl import select_backend

    return select_backend().renderer


def references() -> list[dict[str, Any]]:
    """Committed prints: one entry for each set of versions."""
    return json.loads(FILE.read_text())


def write() -> None:
    """Replace the entry of the installed versions, or add one; those of versions that are no longer locked are to be deleted by hand."""
    kept = [e for e in references() if e["versions"] != installed()] if FILE.exists() else []
    entry = {"versions": installed(), "opengl": opengl(), "prints": elsewhere(NAMES, STEPS, PLAIN)}
    FILE.write_text(json.dumps([*kept, entry], indent=2) + "\n")


if __name__ == "__main__":
    if sys.argv[1:] == ["--write"]:
        write()
    else:
        print(json.dumps({name: fresh(name, int(sys.argv[1])) for name in sys.argv[2:]}))
