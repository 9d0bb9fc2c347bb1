"""What cables and registration do to a real arm: the numbers of ``domain = {"preset": "dvrk"}``.

An encoder follows its set-point late. A link follows its encoder with play: p ← min(max(p, q - r),
q + r) of half-width r, and is slope · q + weight · p. The wrist's links are also moved by each
other's motors. Source: lags from set-points and encoders of a PSM at 75 to 80 mm/s; plays from
fits to commanded and optically measured joints (Hwang et al., RA-L 2020).
"""

from __future__ import annotations

import numpy as np

from mujoco_twin.kinematics import Pose, rotate
from mujoco_twin.model import SERVO, Numbers

LAG = np.array([[47, 51], [47, 51], [49, 54], [15, 15], [33, 36], [28, 28], [28, 36]], float) / 1e3
"""Range of each joint's time constant, and of the jaw's, s; the joints' servos are a part of it."""

DEGREE = np.pi / 180.0

PLAY = np.array(
    [
        [0.0, 0.0],
        [0.0, 0.0],
        [0.2e-3, 0.2e-3],
        [1.5 * DEGREE, 1.5 * DEGREE],
        [8.0 * DEGREE, 9.0 * DEGREE],
        [12.5 * DEGREE, 15.0 * DEGREE],
    ]
)
"""Range of each joint's half-width of play, rad; index 2 in m."""

WEIGHT = np.array([[1, 1], [1, 1], [1.1, 1.2], [0.55, 0.55], [0.55, 0.55], [0.62, 0.62]])
"""Range of the part of each link's motion that has the play."""

GAIN = np.array([1.0, 1.0, 1.0, 1.0, 0.97, 0.90])
"""What a link moves by for each unit of its encoder, once the play is taken up."""

PITCH_BY_PLAY, PITCH_BY_YAW, YAW_BY_PITCH = -0.65, 0.12, 0.2
"""What the wrist pitch moves by for each unit of the wrist yaw's play, and of its encoder once the
play is taken up; what the wrist yaw moves by for each unit of the wrist pitch's encoder."""

BASE_POSITION, BASE_ANGLE = 3.5e-3, 2.0 * DEGREE
"""How far the base may be off along each axis, m, and about each, rad."""

MIDDLE = np.array([0.55, 0.0, 0.71])
"""The middle of the workspace, about which the base is turned, m."""


class Cables:
    """The drivetrain of an arm in one episode, at rest where its encoders say ``joints``.

    There the links are where the encoders say if all plays are in their middle: an arm is
    calibrated where it works.

    Args:
        rng: What draws the numbers of the episode.
        joints: Six joints, rad; index 2 in m.
    """

    def __init__(self, rng: np.random.Generator, joints: Numbers) -> None:
        self._lag = rng.uniform(*LAG.T) - [*[2.0 / SERVO] * 6, 0.0]
        self._play, self._weight = rng.uniform(*PLAY.T), rng.uniform(*WEIGHT.T)
        begin = rng.uniform(-1.0, 1.0, 6)
        self.encoders = np.append(joints, 0.0)
        """What the encoders of the joints and the jaw say."""
        self._plays, self._offsets = joints.copy(), np.zeros(6)
        self._offsets = joints - self.links()
        self._plays += begin * self._play

    def advance(self, set_points: Numbers, seconds: float) -> None:
        """Lets time pass in which the motors are told these set-points of joints and jaw."""
        self.encoders += (set_points - self.encoders) * seconds / (self._lag + seconds)
        joints = self.encoders[:6]
        self._plays = np.clip(self._plays, joints - self._play, joints + self._play)

    def links(self) -> Numbers:
        """Where the six links are."""
        encoders, plays = self.encoders[:6], self._plays
        links = (GAIN - self._weight) * encoders + self._weight * plays + self._offsets
        links[4] += (PITCH_BY_YAW - PITCH_BY_PLAY) * encoders[5] + PITCH_BY_PLAY * plays[5]
        links[5] += YAW_BY_PITCH * encoders[4]
        return np.asarray(links)


def moved_base(rng: np.random.Generator, base: Pose) -> Pose:
    """Where the base of an arm truly is that is believed to be at ``base``."""
    turn, shift = rng.uniform(-1.0, 1.0, (2, 3)) * [[BASE_ANGLE], [BASE_POSITION]]
    angle = float(np.linalg.norm(turn))
    about = np.array([np.cos(angle / 2), *(np.sin(angle / 2) * turn / angle)])
    position = MIDDLE + shift + rotate(about, base.position - MIDDLE)
    return Pose(position, (Pose(np.zeros(3), about) @ base).quaternion)
