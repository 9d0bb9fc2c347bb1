"""Poses and angles, in the conventions of the tasks' observations."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Numbers = NDArray[np.float64]

SINGULAR = 1e-12
"""From 1, the sine of a pitch that counts as a quarter turn."""

HALF_TURN = 1e-9
"""From half a turn, an angle that counts as minus half a turn, rad."""


@dataclass(frozen=True)
class Pose:
    """Where something is: a rotation matrix, shape (3, 3), and a position, shape (3,), m."""

    rotation: Numbers
    position: Numbers

    @classmethod
    def of_frame(cls, frame: Any) -> Pose:
        """Of a frame of PyKDL, or one shaped like it."""
        rotation = np.array([[frame.M[row, column] for column in range(3)] for row in range(3)])
        return cls(rotation, np.array([frame.p[axis] for axis in range(3)]))

    @classmethod
    def of_numbers(cls, numbers: Sequence[float]) -> Pose:
        """Of x, y, z (m), then x, y, z, w of a quaternion."""
        x, y, z, *quaternion = (float(number) for number in numbers)
        i, j, k, w = np.array(quaternion) / math.sqrt(math.fsum(n * n for n in quaternion))
        rotation = np.array(
            [
                [1.0 - 2.0 * (j * j + k * k), 2.0 * (i * j - k * w), 2.0 * (i * k + j * w)],
                [2.0 * (i * j + k * w), 1.0 - 2.0 * (i * i + k * k), 2.0 * (j * k - i * w)],
                [2.0 * (i * k - j * w), 2.0 * (j * k + i * w), 1.0 - 2.0 * (i * i + j * j)],
            ]
        )
        return cls(rotation, np.array([x, y, z]))

    @classmethod
    def identity(cls) -> Pose:
        """No turn, no step."""
        return cls(np.eye(3), np.zeros(3))

    def frame(self, kdl: Any) -> Any:
        """A frame of a module shaped like PyKDL."""
        rotation = kdl.Rotation(*self.rotation.ravel().tolist())
        return kdl.Frame(rotation, kdl.Vector(*self.position.tolist()))

    def __matmul__(self, other: Pose) -> Pose:
        position = self.position + self.rotation @ other.position
        return Pose(self.rotation @ other.rotation, position)

    def inverse(self) -> Pose:
        """The other way round."""
        back = self.rotation.T
        return Pose(back, -back @ self.position)

    def moved(self, step: Numbers, turn: Numbers) -> Pose:
        """Moved by a step (m) and turned in place by a rotation vector (rad), both outside axes."""
        return Pose(rotation_matrix(turn) @ self.rotation, self.position + step)


def numbers(text: str) -> tuple[float, ...]:
    """Numbers between commas."""
    return tuple(float(part) for part in text.split(","))


def rotation_matrix(turn: Numbers) -> Numbers:
    """The rotation matrix of a rotation vector, rad (Rodrigues' formula)."""
    angle = float(np.linalg.norm(turn))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = turn / angle
    across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turned = np.eye(3) + math.sin(angle) * across + (1.0 - math.cos(angle)) * (across @ across)
    return np.asarray(turned)


def rotation_vector(rotation: Numbers) -> Numbers:
    """The rotation vector of a rotation matrix, rad, up to half a turn."""
    doubled = np.array(
        [
            rotation[2, 1] - rotation[1, 2],
            rotation[0, 2] - rotation[2, 0],
            rotation[1, 0] - rotation[0, 1],
        ]
    )
    sine, cosine = float(np.linalg.norm(doubled)) / 2.0, (float(np.trace(rotation)) - 1.0) / 2.0
    angle = math.atan2(sine, cosine)
    if sine > 1e-9:
        return np.asarray(doubled * (angle / (2.0 * sine)))
    if cosine > 0.0:
        return np.asarray(doubled / 2.0)
    # Half a turn: R = 2 a aᵀ - 1, whose longest column is along the axis.
    columns = rotation + np.eye(3)
    axis = columns[:, int(np.argmax(np.diag(columns)))]
    return np.asarray(axis * (math.pi / float(np.linalg.norm(axis))))


def euler_xyz(rotation: Numbers) -> Numbers:
    """Extrinsic XYZ Euler angles, rad: R = Rz(yaw) Ry(pitch) Rx(roll), as observations have them.

    Roll and yaw are in [-π, π[. At a pitch of ±π/2 the roll is 0.
    """
    sine = -float(rotation[2, 0])
    if abs(sine) > 1.0 - SINGULAR:
        yaw = math.atan2(-rotation[0, 1], rotation[1, 1])
        roll, pitch = 0.0, math.copysign(math.pi / 2.0, sine)
    else:
        roll = math.atan2(rotation[2, 1], rotation[2, 2])
        pitch = math.asin(sine)
        yaw = math.atan2(rotation[1, 0], rotation[0, 0])
    return np.array([_wrapped(roll), pitch, _wrapped(yaw)])


def of_euler_xyz(angles: Sequence[float] | Numbers) -> Numbers:
    """The rotation matrix of roll, pitch and yaw, rad."""
    (sr, sp, sy), (cr, cp, cy) = np.sin(angles), np.cos(angles)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def between(start: Pose, end: Pose, share: float) -> Pose:
    """Part of the way: straight in position, evenly about one axis in rotation."""
    turn = rotation_vector(end.rotation @ start.rotation.T)
    return start.moved(share * (end.position - start.position), share * turn)


def smooth(part: float) -> float:
    """The share of the way after a part of the time, from rest to rest."""
    return part * part * (3.0 - 2.0 * part)


def _wrapped(angle: float) -> float:
    return -math.pi if angle > math.pi - HALF_TURN else angle
