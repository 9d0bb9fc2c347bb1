"""What the options of a reset ask for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from trocar import _trocar
from trocar._arrays import numbers, refused
from trocar.errors import InvalidOption

Placement = tuple[list[float] | None, dict[str, list[float]], list[float] | None]
"""How an episode shall begin: goal, poses of objects by name, tips."""


class ResetOptions:
    """Reads the options of resets, and warns once of those that it does not know.

    Args:
        spec: The task.
        num_envs: How many environments one reset is about; ``None`` for a single environment, whose
            values have no axis of environments.
    """

    def __init__(self, spec: _trocar.TaskSpec, num_envs: int | None) -> None:
        self._num_envs = num_envs
        self._arms = 1 + any(element.name.startswith("PSM2") for element in spec.action)
        self._warned = False

    def placements(
        self, options: Mapping[str, Any] | None, envs: Sequence[int] = (0,)
    ) -> list[Placement]:
        """How the episodes of ``envs`` shall begin: one for each, one for all, or none."""
        if options is not None and not isinstance(options, Mapping):
            raise refused(InvalidOption, "options", options, "a dictionary")
        given = {name: value for name, value in (options or {}).items() if value is not None}
        goal, objects, tip = (given.pop(name, None) for name in ("goal", "objects", "tip"))
        if self._num_envs is not None:
            given.pop("reset_mask", None)
        if given and not self._warned:
            self._warned = True
            gym.logger.warn(f"unknown reset options are ignored: {sorted(map(str, given))}")
        objects = {} if objects is None else objects
        if not isinstance(objects, Mapping):
            raise refused(InvalidOption, "options.objects", objects, "poses by name")
        goals = None if goal is None else self._rows("options.goal", goal)
        tips = None if tip is None else self._rows("options.tip", tip, self._arms)
        poses = {
            str(name): self._rows(f"options.objects.{name}", pose) for name, pose in objects.items()
        }
        asked = [rows for rows in (goals, tips, *poses.values()) if rows is not None]
        if not asked:
            return []
        if all(len(rows) == 1 for rows in asked):
            envs = (0,)
        return [
            (
                None if goals is None else _row(goals, env),
                {name: _row(rows, env) for name, rows in poses.items()},
                None if tips is None else _row(tips, env),
            )
            for env in envs
        ]

    def _rows(self, field: str, value: Any, arms: int = 1) -> NDArray[np.float64]:
        """A value as (1, numbers), for all environments, or (num_envs, numbers), one for each."""
        shape = "(n,)" if arms == 1 else f"({arms}, n)"
        each = "" if self._num_envs is None else f", or {self._num_envs} such arrays"
        expected = f"numbers of shape {shape}{each}"
        array = numbers(value, field, InvalidOption, expected=expected)
        one = min(arms, 2)
        is_one = array.ndim == one
        is_each = array.ndim == one + 1 and len(array) == self._num_envs
        is_whole = arms == 1 or array.shape[-2:-1] == (arms,)
        if not (is_one or is_each) or not is_whole:
            raise refused(InvalidOption, field, value, expected)
        return array.astype(np.float64).reshape(len(array) if is_each else 1, -1)


def _row(rows: NDArray[np.float64], env: int) -> list[float]:
    return [float(number) for number in rows[env if len(rows) > 1 else 0]]
