"""What an endoscope's camera sees, and how its arm turns it: the law of the ECM's tasks.

dVRK's camera frame is left, up, forward; the axes of a picture are right, down, forward. A picture
is -1 to 1 in x and y.
"""

from __future__ import annotations

import math

import numpy as np

from trocar.dvrk.deploy.geometry import Numbers, Pose

SPEED = 0.005
"""Camera velocity that 1.0 in an action stands for, m/s."""

AHEAD = 0.02
"""How far ahead of the lens the point is whose velocity an action sets, m."""

MOST_ROLL = math.radians(3.0)
"""Most that the camera rolls in a step of :data:`STEP`, rad."""

STEP = 0.1
"""The time in which the law takes the misorientation away, s."""


def misorientation(reference: Pose, camera: Pose) -> float:
    """The picture's turn against the natural line of sight, rad, positive where it is clockwise.

    Around the point where the optical axis meets the ground, z = 0, an affine map takes the picture
    of ``camera`` to that of ``reference``: the angle is that of the rotation in its polar
    decomposition, reversed. Source: MisOrient's description.

    Args:
        reference: The camera of the natural line of sight, in the world.
        camera: The camera, in the world.
    """
    right, down, forward = _axes(camera)
    apart = camera.position - reference.position
    target = forward * camera.position[2] - apart * forward[2]
    from_floor = np.array([right[:2], down[:2]])
    right, down, forward = _axes(reference)
    x, y, depth = right @ target, down @ target, forward @ target
    reference_from_floor = np.array(
        [depth * right[:2] - x * forward[:2], depth * down[:2] - y * forward[:2]]
    )
    (a, b), (c, d) = from_floor
    turn = reference_from_floor @ np.array([[-d, b], [c, -a]])
    return -math.atan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1])


def jacobian(camera: Pose, yaw: float) -> Numbers:
    """The geometric Jacobian of an ECM with a straight endoscope at its camera, shape (6, 4).

    All axes pass through the remote centre, the last two along the shaft: no length is needed.
    Rows are m/s and rad/s in the frame of the remote centre; columns are yaw, pitch, insertion,
    roll. Source: dVRK's table of Denavit and Hartenberg.
    """
    along = camera.rotation[:, 2]
    axes = (
        np.array([0.0, -1.0, 0.0]),
        np.array([-math.cos(yaw), 0.0, -math.sin(yaw)]),
    )
    columns = [np.concatenate([np.cross(axis, camera.position), axis]) for axis in axes]
    zeros = np.zeros(3)
    columns += [np.concatenate([along, zeros]), np.concatenate([zeros, along])]
    return np.asarray(np.array(columns).T)


def steered(
    joints: Numbers, camera: Pose, error: float, velocity: Numbers, scale: float
) -> Numbers:
    """The joints after a step with a velocity of the camera, as the tasks' ``paper`` action has it.

    The turn about the optical axis is not commanded: it takes the misorientation away. The joints'
    rates are those whose twist comes nearest in least squares.

    Args:
        joints: The joints now, rad; index 2 in m.
        camera: The camera now, in the frame of its remote centre.
        error: The misorientation, rad.
        velocity: Parts of :data:`SPEED` to the right of the picture, down, and forward.
        scale: The time of a step, in parts of :data:`STEP`.
    """
    across = velocity * (SPEED / AHEAD * STEP * scale)
    forward = velocity[2] * SPEED * STEP * scale
    roll = np.clip(error * scale, -MOST_ROLL * scale, MOST_ROLL * scale)
    linear = camera.rotation @ np.array([0.0, 0.0, forward])
    angular = camera.rotation @ np.array([across[1], -across[0], roll])
    twist = np.concatenate([linear, angular])
    step, *_ = np.linalg.lstsq(jacobian(camera, float(joints[0])), twist, rcond=None)
    return np.asarray(joints + step)


def _axes(camera: Pose) -> tuple[Numbers, Numbers, Numbers]:
    """Right, down, forward."""
    left, up, forward = camera.rotation.T
    return -left, -up, forward
