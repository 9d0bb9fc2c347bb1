"""The scripted expert that picks up an object and brings it to a goal, on what a policy observes.

Its stages and distances are those of the server's expert (``server/src/tasks/pick.rs``,
``needle_pick.rs``, ``gauze_retrieve.rs``). That one is told what presses on its fingers; this one
takes an object that keeps closed jaws apart for held.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from mujoco_twin.model import TIP_OFFSET, Numbers

STEP_LENGTH, STEP_ANGLE = 0.01, math.radians(30.0)
"""What 1.0 in an action stands for, m and rad."""

JAW_OPEN = math.radians(40.0)

HOVER, LEVEL = 5e-3, 5e-3
ALIGNED, ABOUT, TURNED = 1.5e-3, 2e-3, 0.1
LOW, LOW_ENOUGH, STILL = 0.3e-3, 1.5e-3, 0.1e-3
OPEN, EMPTY = 0.9 * JAW_OPEN, 0.02
"""The expert's distances (m) and angles (rad), see ``pick.rs`` and ``expert.rs``."""

WRIST, JAW, OBJECT, PLACE, YAW, LINK_YAW = slice(0, 3), 6, slice(7, 10), slice(13, 16), 18, 5
"""Where the observation of tasks that pick up one object has what."""


class Expert:
    """A policy: from what is observed to an action.

    Args:
        depth: The height of the tip over the place of the grasp, m.
        press: How far below the grasp the wrist is sent, m: what is below stops it.
        turns: Whether the jaws turn to close across the object's y axis.
    """

    def __init__(self, depth: float, press: float, *, turns: bool) -> None:
        self._depth, self._press, self._turns = depth, press, turns
        self._closes = True
        self._height = math.inf

    def __call__(self, seen: Any) -> Numbers:
        """The action for what is seen, which is of the next step of an episode or of a new one."""
        state = np.asarray(seen["observation"], np.float64)
        carried, goal = (np.asarray(seen[f"{of}_goal"], float) for of in ("achieved", "desired"))
        wrist, opening = state[WRIST], state[JAW]
        is_still = abs(wrist[2] - self._height) < STILL
        self._height = wrist[2]
        if self._closes and opening > EMPTY:
            way = goal - carried
            if way[2] > LEVEL:
                way[:2] = 0.0
            return self._act(way, 0.0, closes=True)
        grasp = state[PLACE] + np.array([0.0, 0.0, TIP_OFFSET + self._depth])
        off = wrist - grasp
        turn = self._yaw_error(state) if self._turns else 0.0
        aside = math.hypot(off[0], off[1])
        is_open = opening > OPEN and not self._closes
        is_ready = is_open and abs(turn) < TURNED
        if is_ready and aside < ABOUT and (off[2] < LOW or (off[2] < LOW_ENOUGH and is_still)):
            return self._act([*-off[:2], -self._press - off[2]], turn, closes=True)
        if is_ready and aside < ALIGNED:
            return self._act([*-off[:2], -self._press - off[2]], turn, closes=False)
        return self._act([*-off[:2], HOVER - off[2]], turn, closes=False)

    def _yaw_error(self, state: Numbers) -> float:
        """The least turn about the vertical for the jaws to close across the object's y axis, rad.

        The hinge is the z axis of the wrist link, and a half turn makes no difference: either
        finger may be on either side.
        """
        # The link's roll is a quarter turn and its pitch 0, so its hinge lies a quarter turn before
        # its y axis would without the roll: along the object's y axis where both yaws are equal.
        turn = state[YAW] - state[LINK_YAW]
        return float(turn - math.pi * round(turn / math.pi))

    def _act(self, way: Any, turn: float, *, closes: bool) -> Numbers:
        self._closes = closes
        step = np.asarray(way, float) / STEP_LENGTH
        step /= max(np.abs(step).max(), 1.0)
        angle = min(max(turn / STEP_ANGLE, -1.0), 1.0)
        return np.array([*step, angle, -1.0 if closes else 1.0])


needle_pick = Expert(-0.45e-3, 2e-3, turns=True)
"""The expert of NeedlePick."""

gauze_retrieve = Expert(0.15e-3 - 1.55e-3, 0.0, turns=False)
"""That of GauzeRetrieve, which grasps above the sheet, 1.55 mm below the crest of the pleat."""
