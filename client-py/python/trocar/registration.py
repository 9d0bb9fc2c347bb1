"""The Gymnasium ids of the tasks."""

from __future__ import annotations

import difflib

import gymnasium as gym

from trocar import _trocar
from trocar._connection import connect
from trocar.errors import UnknownTask, refuse

NAMESPACE = "trocar"

# From the bindings, so that importing needs no server. Gymnasium's registry has no numbers of
# steps: its TimeLimit would cut episodes of other rates short. An environment's own spec has one.
TASKS = {task: steps for task, (steps, _, _) in _trocar.TASKS.items()}
"""Steps of an episode at each task's nominal rate."""

RATES = {task: int(hertz) for task, (_, hertz, _) in _trocar.TASKS.items()}
"""Nominal rates of the tasks, Hz."""

TAGS = {task: frozenset(tags) for task, (_, _, tags) in _trocar.TASKS.items()}
"""The kind of each task: ``psm``, ``grasp``, ``tissue``, ``bimanual``, ``camera``, ``endless``."""


SERVED: dict[str, tuple[int, float]] = {}
"""Steps of an episode, and nominal rate in Hz, of tasks that are a server's own and registered."""


def schedule(task: str) -> tuple[int, float]:
    """Steps of an episode, and nominal rate in Hz, of a task.

    Raises:
        trocar.errors.UnknownTask: It is no task of Trocar, and of no server in :data:`SERVED`.
    """
    if task in TASKS:
        return TASKS[task], RATES[task]
    if task in SERVED:
        return SERVED[task]
    similar = difflib.get_close_matches(task, [*TASKS, *SERVED], 1)
    hint = f"did you mean {similar[0]!r}? " if similar else ""
    allowed = f"{hint}allowed are {[*TASKS, *SERVED]}, and tasks of a server that is named"
    raise refuse(UnknownTask, "task", task, allowed)


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
    client = connect(server)
    tasks = client.tasks()
    for task in tasks:
        if task not in TASKS:
            spec = client.describe(task)
            SERVED[task] = (spec.max_steps, round(1.0 / spec.seconds_per_step, 6))
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
