"""The Gymnasium ids of the tasks."""

from __future__ import annotations

import gymnasium as gym

from trocar import _trocar
from trocar._connection import connect

NAMESPACE = "trocar"

# From the bindings, so that importing needs no server. Gymnasium's registry has no numbers of
# steps: its TimeLimit would cut episodes of other rates short. An environment's own spec has one.
TASKS = {task: steps for task, (steps, _, _) in _trocar.TASKS.items()}
"""Steps of an episode at each task's nominal rate."""

RATES = {task: int(hertz) for task, (_, hertz, _) in _trocar.TASKS.items()}
"""Nominal rates of the tasks, Hz."""

TAGS = {task: frozenset(tags) for task, (_, _, tags) in _trocar.TASKS.items()}
"""The kind of each task: ``psm``, ``grasp``, ``tissue``, ``bimanual``, ``camera``, ``endless``."""


def register_all(server: str | None = None) -> list[str]:
    """Registers the tasks as ``trocar/<task>``; once is enough, more does no harm.

    Args:
        server: A server that offers tasks of its own: they are registered too, and made there
            unless another server is named.

    Returns:
        The ids of all tasks that were registered: Trocar's, or those that ``server`` offers.
    """
    if server is None:
        return [register(task) for task in TASKS]
    tasks = connect(server).tasks()
    return [register(task, server=None if task in TASKS else server) for task in tasks]


def register(task: str, max_steps: int | None = None, *, server: str | None = None) -> str:
    """Registers a task as ``trocar/<task>``, without asking any server, and returns that id.

    Args:
        task: Its id without namespace.
        max_steps: Steps after which Gymnasium cuts its episodes short, besides the server.
        server: Where it is made unless another server is named.
    """
    name = f"{NAMESPACE}/{task}"
    if name not in gym.registry:
        gym.register(
            id=name,
            entry_point="trocar.env:TrocarEnv",
            vector_entry_point="trocar.vector:TrocarVectorEnv",
            max_episode_steps=max_steps,
            kwargs={"task": task} if server is None else {"task": task, "server": server},
        )
    return name
