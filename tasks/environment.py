"""What the environments have in common: a camera that is carried, a sensor that follows contours, observations and pictures."""

import math
from abc import abstractmethod
from collections.abc import Iterator
from typing import Any, Generic, Literal, TypeVar

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from extremal.estimator import Camera
from extremal.estimator.camera import Array
from extremal.estimator.errors import ExtremalError, InvalidInput, is_whole
from extremal.scenes import Scene
from extremal.sim import ArmErrors, get_arm
from extremal.tasks.carried import CarriedCamera, whole_error
from extremal.tasks.eye import Eye
from extremal.tasks.features import with_mounting
from extremal.tasks.overlay import picture
from extremal.tasks.rigid import is_finite
from extremal.tasks.sensors import make_sensor
from extremal.tasks.spaces import (
    checked_action,
    feature_rows,
    feature_space,
    motion_space,
    moved,
    pose_values,
)
from extremal.tasks.tiers import Tier, get_tier

SensorName = Literal["geometric", "rendered"]
RGB = 128  # [px] sides of an `rgb` observation
Observation = dict[str, Any]
Setup = TypeVar("Setup")


class NonsenseObserved(ExtremalError, RuntimeError):
    """Numbers of an observation or reward that mean nothing: the episode is worth nothing."""


class ActiveVisionEnv(gym.Env[Observation, Any], Generic[Setup]):
    """A camera that may be moved about a scene; subclasses say what for.

    Every environment takes the same keyword arguments:

    | argument | values | meaning |
    |---|---|---|
    | `sensor` | "geometric", "rendered" | exact contours with a model of edge errors; or MuJoCo's frames through the vision pipeline |
    | `obs_mode` | "features", "rgb", "both" | what is observed besides poses |
    | `action_mode` | "velocity", "pose" | see Action space |
    | `reward_mode` | "shaped", "sparse" | see Rewards |
    | `tier` | a name in `extremal.tasks.tiers.TIERS` | what episodes are drawn from |
    | `arm` | a name in `extremal.sim.ARMS`, None | replaces the tier's calibration |
    | `max_steps` | a whole number | time limit; the episode is truncated |
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 10}  # noqa: RUF012  as Gymnasium declares it

    def __init__(
        self,
        sensor: SensorName = "geometric",
        obs_mode: str = "features",
        action_mode: str = "velocity",
        reward_mode: str = "shaped",
        tier: str = "standard-v0",
        arm: str | None = None,
        max_steps: int = 200,
        render_mode: str | None = None,
    ) -> None:
        for name, value, accepted in (
            ("obs_mode", obs_mode, ("features", "rgb", "both")),
            ("reward_mode", reward_mode, ("shaped", "sparse")),
            ("render_mode", render_mode, (None, "rgb_array")),
        ):
            if not isinstance(value, str | None) or value not in accepted:
                raise InvalidInput(f"{name} is {value!r:.200}; accepted: {', '.join(map(str, accepted))}")
        if not (isinstance(max_steps, int) and 1 <= max_steps <= 100_000):
            raise InvalidInput(f"max_steps is {max_steps!r}; accepted: a whole number from 1 to 100000")
        self.render_mode, self.obs_mode, self.action_mode, self.reward_mode = (
            render_mode, obs_mode, action_mode, reward_mode,
        )  # fmt: skip
        self.tier = get_tier(tier)
        if arm is not None:
            self.tier = self.tier.with_options({"arm_bias": arm, "arm_noise": arm})
        self.camera, self.max_steps = Camera(), max_steps
        self._sensor_name, self._sensor = sensor, make_sensor(sensor, self.tier.edge_noise)
        self._eyes: dict[str, Eye] = {}
        self.action_space = self._actions()
        self.observation_space = gym.spaces.Dict(self._observations())
        self._setup: Setup | None = None

    # What a task is.

    def _scatter(self, errors: ArmErrors) -> Array:
        """Covariance (6, 6) of the poses' errors that are drawn anew in every look (see `carried`)."""
        return whole_error(errors)

    @abstractmethod
    def _draw(self, seed: int, tier: Tier) -> Setup:
        """The set-up of a seed."""

    @abstractmethod
    def _begin(self) -> None:
        """Start an episode, of `self.setup`, after the first look."""

    @abstractmethod
    def _judge(self, action: Array, before: Array) -> tuple[float, bool, bool]:
        """Reward, whether the episode ends, and success after a step from the actual position `before` (3,) [m]."""

    @abstractmethod
    def _metrics(self) -> dict[str, float]:
        """Scores so far against the truth; NaN where there is none yet."""

    @abstractmethod
    def _scene(self) -> tuple[Scene, RigidTransform]:
        """The scene and the commanded camera pose at the start."""

    @abstractmethod
    def _onlooker(self) -> tuple[RigidTransform, list[tuple[Array, str]]]:
        """From where the scene is shown to people, and marks there: points (n, 3) and colours' names."""

    def _actions(self) -> gym.spaces.Box:
        return motion_space(self.action_mode)

    def _observations(self) -> dict[str, gym.Space[Any]]:
        """What is observed besides `extra`."""
        found: dict[str, gym.Space[Any]] = {
            "pose": gym.spaces.Box(-10.0, 10.0, (7,), np.float32),
            "time": gym.spaces.Box(0.0, 1.0, (1,), np.float32),
        }
        if self.obs_mode != "rgb":
            found["features"] = feature_space()
        if self.obs_mode != "features":
            found["rgb"] = gym.spaces.Box(0, 255, (RGB, RGB, 3), np.uint8)
        return found

    def _extra(self) -> Observation:
        """Further entries of the observation."""
        return {}

    # Where the camera is: T_world_camera (4, 4), `T_commanded` as the robot believes, `T_actual` in truth.

    @property
    def commanded(self) -> RigidTransform:
        """T_world_camera, as the robot believes."""
        return RigidTransform(self.T_commanded, normalize=False)

    @property
    def actual(self) -> RigidTransform:
        """T_world_camera, in truth."""
        return RigidTransform(self.T_actual, normalize=False)

    @property
    def here(self) -> Array:
        """(3,) [m] where the camera is in truth."""
        return self.T_actual[:3, 3].copy()

    # Gymnasium's interface.

    @property
    def setup(self) -> Setup:
        """Of the current episode, the truth included: for scores, never for policies."""
        if self._setup is None:
            raise InvalidInput("the environment was not reset; accepted: reset() before anything else")
        return self._setup

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start the episode of a seed; without one, of the next that the generator draws. `options` replace fields of the tier."""
        if seed is not None and not (is_whole(seed) and seed >= 0):
            raise InvalidInput(f"seed is {seed!r}; accepted: a whole number from 0, or none")
        super().reset(seed=None if seed is None else int(seed))
        tier = self.tier.with_options(options)
        episode = int(self.np_random.integers(2**31)) if seed is None else int(seed)
        self._setup = self._draw(episode, tier)
        self.close()
        self._sensor = make_sensor(self._sensor_name, tier.edge_noise)
        self.scene, start = self._scene()
        self.T_commanded = start.as_matrix()
        streams = np.random.default_rng([episode, 11]).spawn(3)
        self._noise = streams[0]
        self.robot = CarriedCamera.draw(
            get_arm(tier.arm_bias), self._scatter(get_arm(tier.arm_noise)), start, streams[1]
        )
        self._sensor.reset(self.scene, self.camera, streams[2])
        self.steps, self.travelled, self.is_success = 0, 0.0, False
        self.T_actual = self.robot.actual(self.T_commanded, self._noise)
        self._look()
        self._begin()
        return self._observe(), self._info()

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """One step of `DT` seconds; an action outside its space is clipped, one that is not finite raises InvalidInput."""
        values = checked_action(action, self.action_space)  # pyright: ignore[reportArgumentType]
        self.setup  # noqa: B018  raises before the first reset
        before = self.T_actual
        self.T_commanded = moved(self.T_commanded, values[:6], self.action_mode)
        self.T_actual = self.robot.actual(self.T_commanded, self._noise)
        self.steps += 1
        self.travelled += math.dist(self.T_actual[:3, 3], before[:3, 3])
        self._look()
        reward, ended, self.is_success = self._judge(values, before[:3, 3])
        if not math.isfinite(reward):
            raise NonsenseObserved(
                f"the reward of step {self.steps} is {reward!r}; accepted: a finite number"
            )
        truncated = not ended and self.steps >= self.max_steps
        return self._observe(), float(reward), ended, truncated, self._info()

    def _look(self) -> None:
        seen = self._sensor.look(self.T_actual, self.T_commanded, self.robot.covariance)
        if not seen.make_sense():
            raise NonsenseObserved(
                "a feature has no number for its radius or position; accepted: finite ones"
            )
        self.features = with_mounting(seen, self.T_commanded[:3, 3], *self.robot.mounting_sigma)

    def _observe(self) -> Observation:
        observation: Observation = {
            "pose": pose_values(self.T_commanded),
            "time": np.array([min(self.steps / self.max_steps, 1.0)], np.float32),
        } | self._extra()
        if self.obs_mode != "rgb":
            observation["features"] = feature_rows(self.features)
        if self.obs_mode != "features":
            observation["rgb"] = self._eye("rgb", RGB, RGB).image(self.actual).copy()
        return _finite(observation)

    def _info(self) -> dict[str, Any]:
        known = {name: value for name, value in self._metrics().items() if not math.isnan(value)}
        return known | {"is_success": self.is_success, "steps": self.steps, "path_length_m": self.travelled}

    # Pictures.

    def _eye(self, name: str, width: int, height: int) -> Eye:
        if name not in self._eyes:
            self._eyes[name] = Eye(self.scene, self.camera, width, height)
        return self._eyes[name]

    def render(self) -> NDArray[np.uint8] | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """What the hand's camera sees, with labelled features, beside a view of the scene (480, 1280, 3)."""
        if self.render_mode is None:
            return None
        self.setup  # noqa: B018
        return picture(
            self._eye("picture", 640, 480), self.camera, self.actual, self.features, *self._onlooker()
        )

    def afterwards(self) -> Iterator[NDArray[np.uint8]]:
        """Pictures (480, 1280, 3), ten a second, of what the last action set going; none where the episode ends with the action."""
        return iter(())

    def _close_eyes(self) -> None:
        for eye in self._eyes.values():
            eye.close()
        self._eyes = {}

    def close(self) -> None:
        """Free sensor and renderers."""
        self._sensor.close()
        self._close_eyes()


def _finite(observation: Observation) -> Observation:
    """The same observation; NonsenseObserved where a number of it is not finite."""
    for name, values in observation.items():
        if values.dtype != np.uint8 and not is_finite(values):
            raise NonsenseObserved(f"{name!r} of the observation is not finite; accepted: finite numbers")
    return observation
