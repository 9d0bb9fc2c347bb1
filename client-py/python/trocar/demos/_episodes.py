"""Episodes as they are recorded; those of the scripted expert, many at a time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.vector import TrocarVectorEnv


@dataclass(frozen=True)
class Episode:
    """An episode of T steps. Arrays of T + 1 rows also tell of the state that it ended in."""

    seed: int
    """Its seed; it is the first episode of that."""
    observation: NDArray[np.float32]
    """(T + 1, observation dim)."""
    achieved_goal: NDArray[np.float32]
    """(T + 1, goal dim); without goals, no columns."""
    desired_goal: NDArray[np.float32]
    """(T + 1, goal dim)."""
    stage: NDArray[np.uint8]
    """What the expert is about in each state, by number in ``trocar.STAGES``: (T + 1).

    Of a person's episode it is 0.
    """
    action: NDArray[np.float32]
    """What was done: (T, action dim)."""
    reward: NDArray[np.float32]
    """(T)."""
    is_success: NDArray[np.bool_]
    """Whether the goal was reached after each step: (T)."""
    terminated: NDArray[np.bool_]
    """(T)."""
    truncated: NDArray[np.bool_]
    """(T)."""

    def __len__(self) -> int:
        """Number of steps."""
        return len(self.reward)

    @property
    def succeeded(self) -> bool:
        """Whether its last step ends in success; without goals, whether it lasted to the end."""
        if self.achieved_goal.shape[1] == 0:
            return not bool(self.terminated[-1])
        return bool(self.is_success[-1])


def run(envs: TrocarVectorEnv, seeds: Sequence[int]) -> list[Episode]:
    """The expert's episodes of some seeds, in their order.

    Args:
        envs: As many environments, made with ``expert=True`` and autoreset ``disabled``.
        seeds: Their seeds.
    """
    observations, infos = envs.reset(seed=seeds)
    running = np.arange(envs.num_envs)
    states = [Track() for _ in seeds]
    steps = [Track() for _ in seeds]
    actions = _note(states, running, observations, infos)
    while running.size:
        envs.send(actions, running)
        observations, rewards, terminated, truncated, infos = envs.recv()
        for row, env in enumerate(running):
            steps[env].note(
                action=actions[row],
                reward=rewards[row],
                is_success=infos["is_success"][row],
                terminated=terminated[row],
                truncated=truncated[row],
            )
        actions = _note(states, running, observations, infos)
        goes_on = ~(terminated | truncated)
        running, actions = running[goes_on], actions[goes_on]
    return [
        Episode(seed, **state.arrays(), **step.arrays())
        for seed, state, step in zip(seeds, states, steps, strict=True)
    ]


class Track:
    """What was noted of one environment, by name, in order."""

    def __init__(self) -> None:
        self._noted: dict[str, list[NDArray[np.generic]]] = {}

    def note(self, **values: NDArray[Any] | np.generic) -> None:
        for name, value in values.items():
            self._noted.setdefault(name, []).append(np.array(value))

    def arrays(self) -> dict[str, NDArray[Any]]:
        return {name: np.stack(values) for name, values in self._noted.items()}


def _note(
    states: list[Track], running: NDArray[np.int_], observations: Any, infos: dict[str, Any]
) -> NDArray[np.float32]:
    """Notes the states that the environments are in; the expert's actions there."""
    seen = observations if isinstance(observations, dict) else {"observation": observations}
    nothing = np.zeros((len(running), 0), np.float32)
    actions, stages = (np.asarray(infos[name]) for name in ("expert_action", "expert_stage"))
    for row, env in enumerate(running):
        states[env].note(
            observation=seen["observation"][row],
            achieved_goal=seen.get("achieved_goal", nothing)[row],
            desired_goal=seen.get("desired_goal", nothing)[row],
            stage=stages[row],
        )
    return np.array(actions, np.float32)


def save(path: Path, episodes: Sequence[Episode]) -> None:
    """Writes episodes to a file, which is there only when it is whole."""
    arrays = {
        f"{number}/{field.name}": np.asarray(getattr(episode, field.name))
        for number, episode in enumerate(episodes)
        for field in fields(Episode)
    }
    beside = path.with_suffix(".tmp")
    with beside.open("wb") as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]
    beside.replace(path)


def load(path: Path) -> Iterator[Episode]:
    """The episodes that :func:`save` wrote."""
    with np.load(path) as arrays:
        count = len({name.partition("/")[0] for name in arrays.files})
        for number in range(count):
            parts = {field.name: arrays[f"{number}/{field.name}"] for field in fields(Episode)}
            yield Episode(**(parts | {"seed": int(parts["seed"])}))
