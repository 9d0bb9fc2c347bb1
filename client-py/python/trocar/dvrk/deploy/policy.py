"""Policies: the ones that come with Trocar, ONNX files, and Python functions."""

from __future__ import annotations

import importlib
import json
import subprocess
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar import _trocar
from trocar.dvrk.deploy.observation import Seen
from trocar.errors import InvalidAction, InvalidRequest, refuse
from trocar.registration import TASKS
from trocar.server import binary

INPUTS = ("observation", "achieved_goal", "desired_goal")

ALLOWED = (
    "allowed are a task that Trocar has a policy of (`trocar policies` lists them), a file that "
    "ends in .onnx, or module:function"
)


@dataclass(frozen=True)
class Policy:
    """What chooses the actions."""

    name: str
    """As it was asked for."""
    act: Callable[[Seen, int], Any]
    """From what is seen, and how many numbers are needed, to an action."""
    network: _trocar.Network | None = None
    """The network, where it is one: it knows what task it was trained for."""

    @property
    def task(self) -> str | None:
        """The task that it was trained for, where that is known."""
        return self.network.task if self.network else None

    @property
    def options(self) -> Mapping[str, Any]:
        """The options of the task that it was trained with."""
        told = self.network.options if self.network else None
        return json.loads(told or "{}")  # type: ignore[no-any-return]

    def check(self, spec: _trocar.TaskSpec) -> None:
        """Refuses a task that it was not made for.

        Raises:
            trocar.errors.InvalidOption: It is of another task, or of other observations.
        """
        if self.network is not None:
            self.network.check(spec)

    def __call__(self, seen: Seen, numbers: int) -> NDArray[np.float32]:
        """An action: float32 (numbers,), each in [-1, 1].

        Raises:
            trocar.errors.InvalidAction: It has another shape, or numbers that are not finite.
        """
        action = np.asarray(self.act(seen, numbers), np.float32).reshape(-1)
        if action.shape != (numbers,) or not np.isfinite(action).all():
            allowed = f"{self.name} must give {numbers} finite numbers"
            raise refuse(InvalidAction, "action", action.tolist(), allowed)
        return np.clip(action, -1.0, 1.0)


def load(name: str) -> Policy:
    """The policy of a name: a task's id with or without version, FILE.onnx, or module:function.

    A function takes what Gymnasium's environment of the task observes, and returns an action.

    Raises:
        trocar.errors.InvalidRequest: There is none, or the file is none; the message says why.
    """
    if name.endswith(".onnx"):
        try:
            return _network(name, Path(name).read_bytes())
        except OSError as error:
            raise refuse(InvalidRequest, "policy", name, str(error)) from error
    if ":" in name:
        call = function(name, "policy")
        return Policy(name, lambda seen, _: call(seen))
    if f"{name.removesuffix('-v0')}-v0" not in TASKS:
        raise refuse(InvalidRequest, "policy", name, ALLOWED)
    with tempfile.TemporaryDirectory() as folder:
        command = [binary(), "policies", "--save", folder]
        subprocess.run(command, check=True, capture_output=True)
        path = Path(folder) / f"{name.removesuffix('-v0')}-v0.onnx"
        if not path.exists():
            raise refuse(InvalidRequest, "policy", name, ALLOWED)
        return _network(name, path.read_bytes())


def function(name: str, field: str) -> Callable[..., Any]:
    """What ``module:function`` names.

    Raises:
        trocar.errors.InvalidRequest: There is no such module or function.
    """
    module, _, attribute = name.partition(":")
    try:
        found = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError, ValueError) as error:
        raise refuse(
            InvalidRequest, field, name, f"module:function was expected: {error}"
        ) from error
    if not callable(found):
        raise refuse(InvalidRequest, field, name, "it cannot be called")
    return found  # type: ignore[no-any-return]


def _network(name: str, content: bytes) -> Policy:
    network = _trocar.Network(name, content)
    nothing = np.zeros(0, np.float32)

    def act(seen: Seen, numbers: int) -> NDArray[np.float32]:
        if isinstance(seen, dict):
            state, achieved, desired = (seen[name] for name in INPUTS)
            return network.act(state, achieved, desired, numbers)
        return network.act(seen, nothing, nothing, numbers)

    return Policy(name, act, network)
