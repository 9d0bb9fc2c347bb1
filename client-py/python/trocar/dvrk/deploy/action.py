"""Where a task's action asks an arm to be: the numbers of the option ``action``, as set-points."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from trocar.dvrk.deploy.camera import misorientation, steered
from trocar.dvrk.deploy.geometry import Numbers, Pose, rotation_matrix
from trocar.dvrk.deploy.observation import WRIST_FROM_LINK
from trocar.dvrk.deploy.task import TIP, Task
from trocar.errors import Unsupported
from trocar.registration import RATES

STEP_LENGTH = 0.01
"""Movement that 1.0 stands for at the task's nominal rate, m."""

STEP_ANGLE = math.radians(30.0)
"""Turn that 1.0 stands for, rad."""

STEP_PITCH = math.radians(15.0)
"""Pitch that 1.0 stands for, rad; pitches end at a quarter turn."""

STEP_ROLL = math.radians(3.0)
"""Roll of the endoscope that 1.0 stands for, rad."""

JAW_CLOSED, JAW_OPEN = 0.0, math.radians(40.0)
"""Openings of the jaws, rad."""

PITCHED = {"PSM1": (0.0, -math.pi / 2.0), "PSM2": (-math.pi, math.pi / 2.0)}
"""Roll and yaw of wrist links where only the pitch turns, rad."""


@dataclass(frozen=True)
class Aim:
    """Where an arm is, or is to be: a PSM's wrist in the scene and jaw, or the ECM's joints."""

    wrist: Pose | None = None
    jaw: float = JAW_CLOSED
    joints: Numbers | None = None
    camera: Pose | None = None
    """Of an ECM that is somewhere: its camera, in the frame of its remote centre."""


Decoder = Callable[[str, Aim, Numbers], Aim]
"""From an arm, where it is and its numbers of an action to where it is to be."""


class Actions:
    """The actions of a task, decoded as the simulator does, but for joint limits.

    What is confined is the wrist, to the task's box, and the tip in x, y and its height; the arm's
    own controller clips joints.

    Raises:
        trocar.errors.Unsupported: The task's action mode is none that this knows.
    """

    def __init__(self, task: Task) -> None:
        self._task = task
        numbers = task.numbers
        names = [element.name.removeprefix(f"{task.arms[0]} ") for element in task.spec.action]
        self._names = names[:numbers]
        if task.spec.id not in RATES:
            raise Unsupported(f"{task.spec.id}: allowed are {', '.join(RATES)}")
        self._scale = task.spec.seconds_per_step * RATES[task.spec.id]
        known: dict[tuple[str, ...], Decoder] = {
            ("vx", "vy", "vz"): self._velocity,
            ("roll joint increment",): self._roll,
        }
        decoder = known.get(tuple(self._names))
        if self._names[:3] == ["dx", "dy", "dz"] and not task.moves_camera:
            decoder = {5: self._paper, 7: self._cartesian}.get(numbers)
        if decoder is None:
            raise Unsupported(
                f"{task.spec.id}: actions {names}; allowed are those of action='paper' of tasks "
                "with PSMs, of MisOrient, StaticTrack and ActiveTrack, and action='cartesian'"
            )
        self._decode = decoder

    def aim(self, arm: str, now: Aim, numbers: Numbers) -> Aim:
        """Where an arm's numbers of an action, in [-1, 1], ask it to be.

        Args:
            arm: Its name.
            now: From where increments count.
            numbers: The numbers, shape (:attr:`Task.numbers`,).
        """
        return self._decode(arm, now, np.asarray(numbers, np.float64))

    def _paper(self, arm: str, now: Aim, numbers: Numbers) -> Aim:
        wrist = _wrist(now)
        turn = self._names[3]
        about = numbers[3] * STEP_ANGLE * self._scale if turn.startswith("turn about") else 0.0
        step = numbers[:3] * (STEP_LENGTH * self._scale)
        target = wrist.moved(step, np.array([0.0, 0.0, about]))
        if turn == "pitch":
            pitch = pitch_of(arm, wrist) + numbers[3] * STEP_PITCH * self._scale
            limited = min(max(pitch, -math.pi / 2.0), math.pi / 2.0)
            target = Pose(pitched(arm, limited), target.position)
        jaw = JAW_CLOSED if numbers[4] < 0.0 else JAW_OPEN
        return Aim(self._confined(arm, target), self._turned(now.jaw, jaw))

    def _cartesian(self, arm: str, now: Aim, numbers: Numbers) -> Aim:
        step = numbers[:3] * (STEP_LENGTH * self._scale)
        target = _wrist(now).moved(step, numbers[3:6] * (STEP_ANGLE * self._scale))
        jaw = JAW_CLOSED + (JAW_OPEN - JAW_CLOSED) * 0.5 * (numbers[6] + 1.0)
        return Aim(self._confined(arm, target), self._turned(now.jaw, float(jaw)))

    def _velocity(self, arm: str, now: Aim, numbers: Numbers) -> Aim:
        assert now.joints is not None
        assert now.camera is not None
        base = self._task.bases[arm]
        error = misorientation(base @ self._task.reference, base @ now.camera)
        return Aim(joints=steered(now.joints, now.camera, error, numbers, self._scale))

    def _roll(self, arm: str, now: Aim, numbers: Numbers) -> Aim:
        del arm
        assert now.joints is not None
        turn = numbers[0] * STEP_ROLL * self._scale
        return Aim(joints=now.joints + np.array([0.0, 0.0, 0.0, turn]))

    def _turned(self, before: float, asked: float) -> float:
        """From closed to open takes jaws a step at the nominal rate; tasks may keep them closed."""
        if self._names[-1].startswith("ignored"):
            return JAW_CLOSED
        most = (JAW_OPEN - JAW_CLOSED) * self._scale
        turn = asked - before
        return asked if abs(turn) <= most else before + math.copysign(most, turn)

    def _confined(self, arm: str, target: Pose) -> Pose:
        """The nearest place in which wrist and tip are where the task lets them."""
        low, high = self._task.boxes[arm]
        jaws = target.rotation @ TIP
        wrist = np.clip(target.position, low, high)
        tip = wrist + jaws
        inside = np.clip(tip, low, high) - tip
        wrist[:2] += inside[:2]
        lowest = self._task.lowest.get(arm)
        if lowest is not None:
            wrist[2] = max(wrist[2], lowest - jaws[2])
        return Pose(target.rotation, wrist)


def pitched(arm: str, pitch: float) -> Numbers:
    """The rotation of a wrist whose link has this pitch, as where only the pitch turns, rad."""
    roll, yaw = PITCHED[arm]
    about = (
        np.array([0.0, 0.0, yaw]),
        np.array([0.0, pitch, 0.0]),
        np.array([roll, 0.0, 0.0]),
    )
    z, y, x = (rotation_matrix(turn) for turn in about)
    return np.asarray(z @ y @ x @ WRIST_FROM_LINK.T)


def pitch_of(arm: str, wrist: Pose) -> float:
    """The pitch at which the hinge of :func:`pitched` jaws is as along that of a wrist, rad."""
    along = wrist.rotation @ WRIST_FROM_LINK[:, 2]
    level, upright = ((pitched(arm, at) @ WRIST_FROM_LINK)[:, 2] for at in (0.0, math.pi / 2.0))
    return math.atan2(along @ upright, along @ level)


def _wrist(aim: Aim) -> Pose:
    assert aim.wrist is not None
    return aim.wrist
