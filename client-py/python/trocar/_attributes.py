"""Attributes and methods of single environments, read through their vector environment."""

from __future__ import annotations

from typing import Any

import numpy as np

from trocar.env import TrocarEnv
from trocar.errors import InvalidOption, refuse

OWN = frozenset(name for name in dir(TrocarEnv) if not name.startswith("_")) | {
    "action_space",
    "observation_space",
}
"""Public attributes of a single environment."""

SESSION = ("step", "restore", "fork", "unwrapped")
"""Attributes of a single environment that a session of several environments lacks."""


class Attributes:
    """Methods ``call``, ``get_attr`` and ``set_attr``, with the results of Gymnasium's vectors.

    Attributes of the task are the same for all environments. Other attributes have a value for each
    environment, and no effect on the simulation.
    """

    num_envs: int
    _notes: dict[str, tuple[Any, ...]]

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Results of the method ``name`` of each environment, or values of that attribute.

        Raises:
            AttributeError: A single environment has no such attribute.
            ValueError: The method needs a session for each environment.
        """
        rows = getattr(self, f"_call_{name}", None) if name in OWN else None
        if rows is not None:
            results: tuple[Any, ...] = rows(*args, **kwargs)
            return results
        values = self.get_attr(name)
        if name in OWN and callable(values[0]):
            return (values[0](*args, **kwargs),) * self.num_envs
        return tuple(value(*args, **kwargs) if callable(value) else value for value in values)

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """The attribute ``name`` of each environment; methods are returned, not called.

        Raises:
            AttributeError: A single environment has no such attribute.
            ValueError: The attribute needs a session for each environment.
        """
        if name in self._notes:
            return self._notes[name]
        if name not in OWN:
            task = self.task_spec.id  # type: ignore[attr-defined]
            raise AttributeError(f"an environment of {task} has no attribute {name!r}")
        if name in SESSION:
            allowed = f"the environments share a session; use {type(self).__name__}.{name}"
            raise refuse(InvalidOption, "name", name, allowed)
        if name == "metadata":
            kept = {key: value for key, value in self.metadata.items() if key != "autoreset_mode"}  # type: ignore[attr-defined]
            return (kept,) * self.num_envs
        return (getattr(self, _shared(name)),) * self.num_envs

    def set_attr(self, name: str, values: Any) -> None:
        """Sets the attribute ``name``: one value for all environments, or a list with a value each.

        Raises:
            ValueError: A list has another length, or different values of a shared attribute.
        """
        each = tuple(values) if isinstance(values, list | tuple) else (values,) * self.num_envs
        if len(each) != self.num_envs:
            allowed = f"expected a value for each of {self.num_envs} environments"
            raise refuse(InvalidOption, name, values, allowed)
        if name not in OWN:
            self._notes[name] = each
            return
        if not all(_same(value, each[0]) for value in each):
            allowed = "expected one value, since the environments of a session share it"
            raise refuse(InvalidOption, name, values, allowed)
        setattr(self, _shared(name), each[0])

    # ---- Methods with a result for each environment ----

    def _call_render(self) -> tuple[Any, ...]:
        return self.render() or (None,) * self.num_envs  # type: ignore[attr-defined]

    def _call_expert_action(self) -> tuple[Any, ...]:
        return tuple(self.expert_action())  # type: ignore[attr-defined]

    def _call_snapshot(self) -> tuple[Any, ...]:
        return tuple(self.snapshot([row]) for row in range(self.num_envs))  # type: ignore[attr-defined]

    def _call_reset(self, *, seed: Any = None, options: Any = None) -> tuple[Any, ...]:
        seeds = None if seed is None else [seed] * self.num_envs
        observations, infos = self.reset(seed=seeds, options=options)  # type: ignore[attr-defined]
        return tuple(
            (_row(observations, row), _row(_values(infos), row)) for row in range(self.num_envs)
        )

    def _call_has_wrapper_attr(self, name: str) -> tuple[bool, ...]:
        try:
            self.get_attr(name)
        except AttributeError:
            return (False,) * self.num_envs
        return (True,) * self.num_envs

    def _call_get_wrapper_attr(self, name: str) -> tuple[Any, ...]:
        return self.get_attr(name)

    def _call_set_wrapper_attr(
        self, name: str, value: Any, *, force: bool = True
    ) -> tuple[bool, ...]:
        is_set = force or self._call_has_wrapper_attr(name)[0]
        if is_set:
            self.set_attr(name, [value] * self.num_envs)
        return (is_set,) * self.num_envs


def _shared(name: str) -> str:
    """Name of the vector's attribute with the value of single environments."""
    return f"single_{name}" if name.endswith("_space") else name


def _values(infos: dict[str, Any]) -> dict[str, Any]:
    return {name: rows for name, rows in infos.items() if not name.startswith("_")}


def _row(arrays: Any, row: int) -> Any:
    if isinstance(arrays, dict):
        return {name: _row(rows, row) for name, rows in arrays.items()}
    value = arrays[row]
    return value.item() if isinstance(value, np.generic) else value


def _same(one: Any, other: Any) -> bool:
    """Whether two values are equal; arrays, in all of their elements."""
    return one is other or bool(np.array_equal(one, other))
