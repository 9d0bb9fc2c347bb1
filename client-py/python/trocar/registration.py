"""The Gymnasium ids of the tasks."""

from __future__ import annotations

import gymnasium as gym

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
    "EcmReach-v0": 50,
}


def register_all() -> None:
    """Registers ``trocar/<task>`` for every task; once is enough, more does no harm."""
    for task, max_steps in TASKS.items():
        name = f"{NAMESPACE}/{task}"
        if name not in gym.registry:
            gym.register(
                id=name,
                entry_point="trocar.env:TrocarEnv",
                vector_entry_point="trocar.vector:TrocarVectorEnv",
                max_episode_steps=max_steps,
                kwargs={"task": task},
            )
