"""Relative features of states and goals: where things are from each other."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar._trocar import TaskSpec
from trocar.errors import InvalidRequest, refuse


def features(
    observation: ArrayLike, achieved: ArrayLike, desired: ArrayLike, *, task: Any
) -> NDArray[np.float32]:
    """What state and goals say of each other, for policies: float32 of shape (..., features).

    A pure function with the bits of ``observation=("relative",)``, so that goals may be replaced
    afterwards (hindsight experience replay). ``task_spec.relative`` names its numbers.

    Args:
        observation: The state as the task describes it, of shape (..., state dim).
        achieved: Achieved goals, of shape (..., goal dim).
        desired: Desired goals, of the same shape.
        task: An environment of the task, or its ``task_spec``.

    Raises:
        ValueError: An array has another shape.
        trocar.errors.Unsupported: The task has no goals, and so no features.
    """
    spec = getattr(getattr(task, "unwrapped", task), "task_spec", task)
    if not isinstance(spec, TaskSpec):
        raise refuse(InvalidRequest, "task", task, "expected an environment or its task_spec")
    return spec.features(observation, achieved, desired)
