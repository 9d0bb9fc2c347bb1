"""Poses, and the joints that bring the wrist to one: by MuJoCo's kinematics, not the project's."""

from __future__ import annotations

import copy

import mujoco
import numpy as np

from mujoco_twin.model import JOINTS, Numbers

ITERATIONS = 30
CLOSE = 1e-10
"""Most steps of Newton's method, and the error at which it ends, m and rad."""

DAMPING = 1e-12 * np.eye(6)
"""Keeps the step finite where a joint is open, as of a shaft whose end is at the remote centre."""

LONGEST = 0.2
"""Longest step of a joint, rad or m: far from the goal the method would leap."""


class Pose:
    """A position (m) and an orientation: a unit quaternion w, x, y, z."""

    def __init__(self, position: Numbers, quaternion: Numbers) -> None:
        self.position = np.array(position, float)
        self.quaternion = np.array(quaternion, float)

    @classmethod
    def of(cls, values: Numbers) -> Pose:
        """From seven numbers: x, y, z, then x, y, z, w of the quaternion, as ROS has them."""
        return cls(values[:3], values[[6, 3, 4, 5]])

    def numbers(self) -> list[float]:
        """The same the other way."""
        w, *xyz = self.quaternion.tolist()
        return [*self.position.tolist(), *xyz, w]

    def __matmul__(self, other: Pose) -> Pose:
        position, quaternion = np.empty(3), np.empty(4)
        mujoco.mju_mulPose(
            position, quaternion, self.position, self.quaternion, other.position, other.quaternion
        )
        return Pose(position, quaternion)

    def inverse(self) -> Pose:
        """From the other side."""
        position, quaternion = np.empty(3), np.empty(4)
        mujoco.mju_negPose(position, quaternion, self.position, self.quaternion)
        return Pose(position, quaternion)

    def apply(self, point: Numbers) -> Numbers:
        """Where a point of this frame is, m."""
        return self.position + rotate(self.quaternion, point)

    def rotation_from(self, other: Pose) -> Numbers:
        """The rotation vector (rad) that turns ``other`` into this."""
        back, difference, vector = np.empty(4), np.empty(4), np.empty(3)
        mujoco.mju_negQuat(back, other.quaternion)
        mujoco.mju_mulQuat(difference, self.quaternion, back)
        mujoco.mju_quat2Vel(vector, difference, 1.0)
        return vector


def rotate(quaternion: Numbers, vector: Numbers) -> Numbers:
    """A vector, turned."""
    turned = np.empty(3)
    mujoco.mju_rotVecQuat(turned, np.array(vector, float), quaternion)
    return turned


LINK_FROM_WRIST = Pose(np.zeros(3), np.array([0.5, -0.5, 0.5, 0.5]))
"""The wrist frame of dVRK on the link of the wrist's yaw: its z axis points to the tip."""


class Kinematics:
    """Where the wrist is for joints, and the other way round: in the frame of the remote centre."""

    def __init__(self, model: mujoco.MjModel) -> None:
        model = copy.deepcopy(model)
        self._model, self._data = model, mujoco.MjData(model)
        joints = [model.joint(name) for name in JOINTS]
        self._at = np.array([joint.qposadr[0] for joint in joints])
        self._dofs = np.array([joint.dofadr[0] for joint in joints])
        self.limits: Numbers = np.array([joint.range for joint in joints])
        self._link = model.body("wrist_yaw_link").id
        mujoco.mj_kinematics(model, self._data)
        centre = model.body("rcm").id
        self.world_from_rcm = Pose(self._data.xpos[centre], self._data.xquat[centre])
        self._rcm_from_world = self.world_from_rcm.inverse()
        rotation = self._data.xmat[centre].reshape(3, 3).T
        self._turn = np.kron(np.eye(2), rotation)

    def wrist(self, joints: Numbers) -> Pose:
        """The wrist for six joint positions (rad; index 2 m)."""
        self._data.qpos[self._at] = joints
        mujoco.mj_kinematics(self._model, self._data)
        world_from_link = Pose(self._data.xpos[self._link], self._data.xquat[self._link])
        return self._rcm_from_world @ world_from_link @ LINK_FROM_WRIST

    def inverse(self, wrist: Pose, near: Numbers) -> Numbers:
        """The joints near to others that bring the wrist to a pose, or as near as limits let it."""
        joints = np.array(near, float)
        jacobian = np.empty((6, self._model.nv))
        for _ in range(ITERATIONS):
            now = self.wrist(joints)
            error = np.concatenate([wrist.position - now.position, wrist.rotation_from(now)])
            if np.abs(error).max() < CLOSE:
                break
            mujoco.mj_comPos(self._model, self._data)
            mujoco.mj_jacBody(self._model, self._data, jacobian[:3], jacobian[3:], self._link)
            own = self._turn @ jacobian[:, self._dofs]
            step = own.T @ np.linalg.solve(own @ own.T + DAMPING, error)
            joints += step / max(np.abs(step).max() / LONGEST, 1.0)
            joints = np.clip(joints, *self.limits.T)
        return joints
