"""The Gymnasium ids of the tasks."""

from __future__ import annotations

import gymnasium as gym

from trocar._connection import connect

NAMESPACE = "trocar"

# The steps of an episode at each task's nominal rate, here so that importing needs no server; a
# test compares them with the server's. Gymnasium's registry has none: its TimeLimit would cut
# episodes of other rates short. An environment's own spec says how many steps its episodes have.
TASKS = {
    "NeedleReach-v0": 50,
    "NeedlePick-v0": 50,
    "GauzeRetrieve-v0": 50,
    "PegTransfer-v0": 50,
    "NeedleRegrasp-v0": 50,
    "BiPegTransfer-v0": 50,
    "EcmReach-v0": 50,
    "MisOrient-v0": 50,
    "StaticTrack-v0": 50,
    "ActiveTrack-v0": 500,
}

RATES = dict.fromkeys(("EcmReach-v0", "MisOrient-v0", "StaticTrack-v0", "ActiveTrack-v0"), 10)
"""Nominal rates of the tasks that have another one than 5 Hz."""


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
