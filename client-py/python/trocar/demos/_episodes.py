"""Episodes as they are recorded; those of the scripted expert, many at a time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.vector import TrocarVectorEnv

PICTURES = "pictures/"
"""Prefix of the names of pictures among the arrays of an episode."""

STATE = ("observation", "achieved_goal", "desired_goal")
"""Arrays of an observation that are no pictures."""


@dataclass(frozen=True)
class Episode:
    """An episode of T steps. Arrays of T + 1 rows also tell of the state that it ended in."""

    seed: int
    """Its seed; it is the first episode of that."""
    observation: NDArray[np.float32]
    """(T + 1, observation dim); no columns if the state is not observed."""
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
    pictures: dict[str, NDArray[Any]] = field(default_factory=dict)
    """Pictures by the names of the observation, e.g. ``rgb`` or ``depth_left``: (T + 1, ...)."""

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
        episode_of({"seed": seed, **state.arrays(), **step.arrays()})
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
    pictures = [name for name in seen if name not in STATE]
    actions, stages = (np.asarray(infos[name]) for name in ("expert_action", "expert_stage"))
    for row, env in enumerate(running):
        states[env].note(
            **{name: seen.get(name, nothing)[row] for name in STATE},
            **{PICTURES + name: seen[name][row] for name in pictures},
            stage=stages[row],
        )
    return np.array(actions, np.float32)


def episode_of(arrays: dict[str, Any]) -> Episode:
    """An episode of arrays by name, with pictures among them."""
    pictures = {
        name.removeprefix(PICTURES): arrays[name] for name in arrays if name.startswith(PICTURES)
    }
    own = {name: value for name, value in arrays.items() if not name.startswith(PICTURES)}
    return Episode(**(own | {"seed": int(own["seed"])}), pictures=pictures)


def save(path: Path, episodes: Sequence[Episode]) -> None:
    """Writes episodes to a file, which is there only when it is whole.

    Raises:
        OSError: The file cannot be written; the error names it.
    """
    names = [each.name for each in fields(Episode) if each.name != "pictures"]
    arrays: dict[str, Any] = {}
    for number, episode in enumerate(episodes):
        arrays |= {f"{number}/{name}": np.asarray(getattr(episode, name)) for name in names}
        pictures = episode.pictures.items()
        arrays |= {f"{number}/{PICTURES}{name}": picture for name, picture in pictures}
    beside = path.with_suffix(".tmp")
    try:
        with beside.open("wb") as file:
            np.savez(file, **arrays)
        beside.replace(path)
    except OSError as error:
        beside.unlink(missing_ok=True)
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error


def load(path: Path) -> Iterator[Episode]:
    """The episodes that :func:`save` wrote."""
    with np.load(path) as arrays:
        names: dict[int, list[str]] = {}
        for name in arrays.files:
            names.setdefault(int(name.partition("/")[0]), []).append(name)
        for number in sorted(names):
            yield episode_of({name.partition("/")[2]: arrays[name] for name in names[number]})
