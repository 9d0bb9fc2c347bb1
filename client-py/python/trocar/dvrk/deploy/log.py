"""The file of an episode: all that was read, decided and commanded."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import trocar
from trocar.dvrk.deploy.geometry import Numbers, Pose
from trocar.dvrk.deploy.observation import Reading, Seen
from trocar.dvrk.deploy.task import Task


class Log:
    """Collects an episode; :meth:`write` makes a file of it that ``numpy.load`` reads.

    Its arrays, of S steps and of T set-points:

    - ``time`` (S + 1), s: when each action was decided on; the last row is the end.
    - ``observation``, ``achieved_goal``, ``desired_goal`` (S + 1, …), ``action`` (S, …).
    - ``stamps`` (S + 1, topics), s; ``topics`` has their names.
    - ``<arm>/setpoint`` (T, 14): time (s), x, y, z (m), the rotation matrix by rows, the jaw (rad).
      Of the ECM (T, 5): time, and the joints (rad; index 2 in m).
    - ``<arm>/measured`` (T, 13): stamp (s), x, y, z (m), and the rotation matrix, in the scene. Of
      the ECM: its camera, in the frame of the remote centre.
    - ``jumps`` (S + 1): what poses jumped, in words.
    - ``about``: task, options, policy, seed, outcome and reason, as JSON.
    """

    def __init__(self, task: Task, policy: str, seed: int) -> None:
        self._about: dict[str, Any] = {
            "task": task.spec.id,
            "options": dict(task.options),
            "policy": policy,
            "seed": seed,
            "trocar": trocar.__version__,
        }
        self._rows: dict[str, list[Any]] = {"time": [], "jumps": [], "stamps": [], "action": []}
        self._topics: list[str] = []
        self._ticks: dict[str, list[Numbers]] = {}
        self.steps = 0
        """Actions so far."""

    def step(
        self,
        time: float,
        reading: Reading,
        seen: Seen,
        action: NDArray[np.float32] | None,
        jumped: str,
    ) -> None:
        """Writes a step down; ``action`` is ``None`` at the end."""
        self._topics = list(reading.stamps)
        self._rows["time"].append(time)
        self._rows["jumps"].append(jumped)
        self._rows["stamps"].append(list(reading.stamps.values()))
        for name, array in (seen if isinstance(seen, dict) else {"observation": seen}).items():
            self._rows.setdefault(name, []).append(array)
        if action is not None:
            self._rows["action"].append(action)
            self.steps += 1

    def command(self, arm: str, time: float, numbers: Numbers) -> None:
        """Writes a set-point down."""
        self._ticks.setdefault(f"{arm}/setpoint", []).append(np.array([time, *numbers]))

    def measured(self, arm: str, stamp: float, pose: Pose) -> None:
        """Writes down where an arm is."""
        numbers = np.array([stamp, *pose.position, *pose.rotation.ravel()])
        self._ticks.setdefault(f"{arm}/measured", []).append(numbers)

    def close(self, outcome: str, why: str) -> None:
        """Says what came of it."""
        self._about |= {"outcome": outcome, "why": why}

    def write(self, folder: Path) -> Path:
        """Writes ``<task>_<seed>.npz`` into a folder, which is made; and says where."""
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / f"{self._about['task']}_{self._about['seed']}.npz"
        arrays = {name: np.array(rows) for name, rows in (self._rows | self._ticks).items()}
        arrays |= {"about": np.array(json.dumps(self._about)), "topics": np.array(self._topics)}
        np.savez_compressed(path, allow_pickle=False, **arrays)
        return path
