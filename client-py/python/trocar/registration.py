"""The Gymnasium ids of the tasks."""

from __future__ import annotations

import gymnasium as gym

from trocar._connection import connect

NAMESPACE = "trocar"

# Steps per episode stand here so that importing needs no server; a test compares them with the
# server's. They go into Gymnasium's spec because trainers, recorders and `make_vec` read the
# length of an episode there. Gymnasium's TimeLimit then counts the same steps as the server and
# truncates at the same one, so it changes nothing.
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


def register_all(server: str | None = None) -> list[str]:
    """Registers the tasks as ``trocar/<task>``; once is enough, more does no harm.

    Args:
        server: A server that offers tasks of its own: they are registered too, and made there
            unless another server is named.

    Returns:
        The ids of all tasks that were registered: Trocar's, or those that ``server`` offers.
    """
    if server is None:
        return [register(task, max_steps) for task, max_steps in TASKS.items()]
    client = connect(server)
    ids = []
    for task in client.tasks():
        if task in TASKS:
            ids.append(register(task, TASKS[task]))
        else:
            ids.append(register(task, client.describe(task).max_steps, server=server))
    return ids


def register(task: str, max_steps: int, *, server: str | None = None) -> str:
    """Registers a task as ``trocar/<task>``, without asking any server, and returns that id.

    Args:
        task: Its id without namespace.
        max_steps: Steps after which its episodes end.
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
