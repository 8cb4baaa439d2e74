"""Forward and inverse kinematics of the arm: camera poses from joint positions and back."""

from itertools import pairwise
from typing import NoReturn

import mink
import mujoco
import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform, Rotation, Slerp

from extremal.estimator.camera import Array
from extremal.estimator.errors import InvalidInput
from extremal.sim.arm import CAMERA, add_arm
from extremal.sim.axes import swap_camera_axes
from extremal.sim.chain import NOMINAL, ArmGeometry

# The base is mounted on its side, its first axis along world +y: then joints 2, 3 and 4 turn about the vertical and
# carry the camera along y and round the target by themselves, and no wrist singularity comes near the path
# (smallest singular value of the Jacobian above 0.18 for baselines up to 0.8 m at 0.4 to 1.2 m).
T_PATH_BASE = RigidTransform.from_components([-0.5, -0.3, -0.1], Rotation.from_rotvec([-np.pi / 2, 0, 0]))
HOME = np.array([0.23, -1.93, -2.37, 1.16, 1.55, 1.57])

RESIDUAL = 1e-9  # accepted distance from the wanted pose [m] and [rad]
MIN_SINGULAR_VALUE = 0.02  # of the Jacobian; below it the arm is at a singularity
STEP_LENGTH, STEP_ANGLE = 0.04, 0.08  # along a path [m], [rad]
REACH = 10.0  # [m] from its base: no arm like this, and no path there that would not be endless
BRANCH_STEP = 0.6  # a joint that moves further in one step has changed its branch [rad]


class UnreachablePose(InvalidInput):
    """A camera pose that the arm can't take, or not without changing its branch."""


class ArmKinematics:
    """The arm at a given base pose.

    Args:
        T_world_base: pose of the arm's base.
        geometry: what is believed of the arm; joint positions are encoder readings.
    """

    def __init__(self, T_world_base: RigidTransform, geometry: ArmGeometry = NOMINAL) -> None:
        spec = mujoco.MjSpec()
        add_arm(spec, T_world_base, geometry)
        self.T_world_base, self.geometry = T_world_base, geometry
        self._configuration = mink.Configuration(spec.compile())
        self._limits = [mink.ConfigurationLimit(self._configuration.model)]
        self._task = mink.FrameTask("flange", "body", position_cost=1.0, orientation_cost=0.5)
        self._camera = self._configuration.model.camera(CAMERA).id
        self._flange = self._configuration.model.body("flange").id
        self._jacobian = np.zeros((6, self._configuration.model.nv))

    @classmethod
    def behind(cls, path_centre: ArrayLike, geometry: ArmGeometry = NOMINAL) -> "ArmKinematics":
        """The arm placed so that it reaches camera poses around `path_centre` (3,) that look along world +x."""
        return cls(RigidTransform.from_translation(np.asarray(path_centre, float)) * T_PATH_BASE, geometry)

    def camera_poses(self, joint_positions: ArrayLike) -> RigidTransform:
        """T_world_camera (V) at joint positions (V, 6) [rad], by MuJoCo's forward kinematics in double precision."""
        model, data = self._configuration.model, self._configuration.data
        q = np.asarray(joint_positions, float)
        if q.ndim != 2 or q.shape[1] != 6 or not np.all(np.isfinite(q)):
            raise InvalidInput(f"joint positions are {q.shape}; accepted: finite numbers (V, 6) [rad]")
        centres, rotations = np.empty((len(q), 3)), np.empty((len(q), 3, 3))
        for i, row in enumerate(q):
            data.qpos[:] = row
            mujoco.mj_kinematics(model, data)
            mujoco.mj_camlight(model, data)
            centres[i] = data.cam_xpos[self._camera]
            rotations[i] = data.cam_xmat[self._camera].reshape(3, 3)
        return swap_camera_axes(RigidTransform.from_components(centres, Rotation.from_matrix(rotations)))

    def flange_motion(self, joint_positions: Array) -> tuple[Array, Array]:
        """T_world_flange (4, 4) at joint positions (6,) [rad], and its Jacobian (6, 6): twists (translation, rotation vector) in the flange frame."""
        model, data = self._configuration.model, self._configuration.data
        data.qpos[:] = joint_positions
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_jacBody(model, data, self._jacobian[:3], self._jacobian[3:], self._flange)
        pose, R = np.eye(4), data.xmat[self._flange].reshape(3, 3)
        pose[:3, :3], pose[:3, 3] = R, data.xpos[self._flange]
        return pose, np.concatenate([R.T @ self._jacobian[:3], R.T @ self._jacobian[3:]])

    def joint_positions(self, T_world_camera: RigidTransform) -> Array:
        """Joint positions (V, 6) [rad] along a path of camera poses (V), all on the branch of `HOME`.

        Starts at the middle pose and follows the path to both ends, interpolating between the poses.

        Raises:
            UnreachablePose: a pose is out of reach, at a joint limit, or behind a singularity.
        """
        if T_world_camera.single or not np.all(np.isfinite(T_world_camera.as_matrix())):
            raise InvalidInput("camera poses must be a path (V,) of finite transforms")
        away = np.max(np.abs(T_world_camera.translation - self.T_world_base.translation), axis=1)
        if not np.all(away < REACH):
            self._fail(T_world_camera[int(np.argmax(away))], "out of reach")
        count = len(T_world_camera)
        middle = count // 2
        q = np.empty((count, 6))
        q[middle] = self._solve(HOME, T_world_camera[middle])
        for order in (range(middle, count), range(middle, -1, -1)):
            for a, b in pairwise(order):
                q[b] = self._follow(q[a], T_world_camera[a], T_world_camera[b])
        return q

    def _follow(self, q: Array, start: RigidTransform, end: RigidTransform) -> Array:
        """Joint positions (6,) at `end`, reached in small steps from q at `start`."""
        length = np.linalg.norm(end.translation - start.translation)
        angle = (start.rotation.inv() * end.rotation).magnitude()
        steps = int(np.ceil(max(length / STEP_LENGTH, angle / STEP_ANGLE, 1)))
        s = np.linspace(0, 1, steps + 1)[1:]
        rotations = Slerp([0, 1], Rotation.concatenate([start.rotation, end.rotation]))(s)
        centres = start.translation + s[:, None] * (end.translation - start.translation)
        for i in range(steps):
            pose = end if i == steps - 1 else RigidTransform.from_components(centres[i], rotations[i])
            reached = self._solve(q, pose)
            if np.max(np.abs(reached - q)) > BRANCH_STEP:
                self._fail(pose, "the arm would have to change its branch")
            q = reached
        return q

    def _solve(self, start: Array, T_world_camera: RigidTransform) -> Array:
        """Joint positions (6,): mink's limited steps towards the pose, then Newton's method."""
        T_world_flange = T_world_camera * self.geometry.T_flange_camera.inv()
        self._task.set_target(mink.SE3.from_matrix(T_world_flange.as_matrix()))
        configuration = self._configuration
        configuration.update(start.copy())
        for _ in range(100):
            try:
                velocity = mink.solve_ik(
                    configuration, [self._task], 1.0, "daqp", damping=1e-9, limits=self._limits
                )
            except mink.NoSolutionFound:
                self._fail(T_world_camera, "no step within the joint limits leads there")
            longest = np.max(np.abs(velocity))
            configuration.integrate_inplace(velocity * min(1.0, 0.3 / max(longest, 1e-12)), 1.0)
            if longest < 1e-7:
                break
        for _ in range(3):
            jacobian = self._task.compute_jacobian(configuration)
            if np.linalg.svd(jacobian, compute_uv=False)[-1] < MIN_SINGULAR_VALUE:
                self._fail(T_world_camera, "out of reach or at a singularity of the arm")
            step = -np.linalg.solve(jacobian, self._task.compute_error(configuration))
            if np.max(np.abs(step)) > 1e-3:
                self._fail(T_world_camera, "out of reach or beyond a joint limit")
            configuration.integrate_inplace(step, 1.0)
        if not np.max(np.abs(self._task.compute_error(configuration))) < RESIDUAL:
            self._fail(T_world_camera, "the residual stays above 1e-9 m")
        return configuration.q.copy()

    def _fail(self, T_world_camera: RigidTransform, reason: str) -> NoReturn:
        centre = np.round(T_world_camera.translation, 3).tolist()
        base = np.round(self.T_world_base.translation, 3).tolist()
        raise UnreachablePose(
            f"the arm at {base} can't bring its camera to {centre} [m]: {reason}; accepted: poses within about 0.5 m of "
            "the path's centre, that look towards the target"
        )
