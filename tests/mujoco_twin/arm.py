"""The controller of a PSM: operating states, set-points and moves as of dVRK, tick by tick."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from mujoco_twin.kinematics import Kinematics, Pose
from mujoco_twin.model import JAW, Numbers

TICK = 1.0 / 240.0
"""How long a tick is, s."""

VELOCITY = np.array([np.pi / 2, np.pi / 2, 0.2, *4 * [6.0 * np.pi]])
ACCELERATION = np.array([np.pi / 2, np.pi / 2, 0.2, *4 * [4.0 * np.pi]])
"""Limits of moves, rad/s and rad/s², index 2 in m; the last is the jaw's (dVRK)."""

HOMING = 0.1
"""How long homing takes, s: the arm stays where it is."""


class Controller:
    """What turns commands into set-points of six joints and the jaw.

    Args:
        kinematics: Of the arm.
        joints: Where it is, rad; index 2 in m.
        tell: What is told of events: topic and value.
    """

    def __init__(
        self, kinematics: Kinematics, joints: Numbers, tell: Callable[[str, Any], None]
    ) -> None:
        self._kinematics, self._tell = kinematics, tell
        self.base = Pose(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
        """The remote centre in the frame in which poses are told and commanded."""
        self.set_point = np.append(joints, 0.0)
        """Joints and jaw as they are commanded."""
        self.state, self.is_homed, self.is_busy = "DISABLED", False, False
        self._move: tuple[Numbers, Numbers, float] | None = None
        self._passed = 0.0
        self._homing = 0.0

    def command(
        self, topic: str, numbers: Sequence[float], more: Sequence[float], text: str
    ) -> None:
        """Takes a command; one that cannot be carried out is told as a warning."""
        values = np.array(numbers, float)
        if topic == "state_command":
            self._change(text)
        elif topic == "set_base_frame":
            self.base = Pose.of(np.array([*numbers, *more]))
        elif topic in ("hold", "free"):
            self._stop()
        elif not self.is_homed or self.state != "ENABLED":
            self._tell("warning", f"{topic}: the arm is not homed")
        elif not (np.isfinite(values).all() and np.isfinite(np.array(more, float)).all()):
            self._tell("warning", f"{topic}: {numbers} {more} are not all finite")
        else:
            self._set(topic, values, np.array(more, float))

    def _set(self, topic: str, values: Numbers, more: Numbers) -> None:
        goal = self.set_point.copy()
        if topic in ("jaw/servo_jp", "jaw/move_jp") and len(values) == 1:
            goal[6] = np.clip(values[0], *JAW)
        elif topic in ("servo_jp", "move_jp") and len(values) == 6:
            goal[:6] = np.clip(values, *self._kinematics.limits.T)
        elif topic in ("servo_cp", "move_cp") and is_pose(values, more):
            wrist = self.base.inverse() @ Pose.of(
                np.array([*values, *(more / np.linalg.norm(more))])
            )
            goal[:6] = self._kinematics.inverse(wrist, self.set_point[:6])
        else:
            self._tell("warning", f"{topic}: not a command of this arm, or not its numbers")
            return
        if "move" in topic:
            self._begin(goal)
        else:
            self._stop()
            self.set_point = goal

    # ---- Time ----

    def tick(self) -> None:
        """Lets a tick pass."""
        if self._homing > 0.0:
            self._homing -= TICK
            if self._homing <= 0.0:
                self.is_homed = True
                self._state(is_busy=False)
        if self._move is not None:
            start, end, seconds = self._move
            self._passed += TICK
            share = min(self._passed / seconds, 1.0)
            self.set_point = start + (end - start) * share * share * (3.0 - 2.0 * share)
            if share >= 1.0:
                self._move = None
                self._tell("goal_reached", True)
                self._state(is_busy=False)

    def _begin(self, goal: Numbers) -> None:
        way = np.abs(goal - self.set_point)
        # The greatest velocity and acceleration of a smooth move from rest to rest.
        seconds = max((1.5 * way / VELOCITY).max(), np.sqrt(6.0 * way / ACCELERATION).max(), TICK)
        self._move, self._passed = (self.set_point.copy(), goal, seconds), 0.0
        self._state(is_busy=True)

    def _stop(self) -> None:
        if self._move is not None:
            self._move = None
            self._tell("goal_reached", False)
            self._state(is_busy=False)

    # ---- States ----

    def _change(self, word: str) -> None:
        if word == "enable":
            self.state = "ENABLED"
        elif word == "disable":
            self._stop()
            self.state, self._homing = "DISABLED", 0.0
        elif word == "unhome":
            self._stop()
            self.is_homed = False
        elif word == "home" and self.state == "ENABLED":
            if not self.is_homed:
                self._homing = HOMING
                self._state(is_busy=True)
                return
        else:
            self._tell("warning", f"state_command {word!r}: not now, or unknown")
        self._state(is_busy=self._move is not None)

    def _state(self, is_busy: bool) -> None:
        self.is_busy = is_busy
        self._tell("operating_state", (self.state, self.is_homed, is_busy))


def is_pose(position: Numbers, quaternion: Numbers) -> bool:
    """Whether numbers are a pose."""
    has_length = len(position) == 3 and len(quaternion) == 4
    return has_length and bool(np.linalg.norm(quaternion) > 0.5)
