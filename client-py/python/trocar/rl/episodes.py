"""Whole episodes as arrays, and transitions drawn from them with goals that were reached later."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import trocar
from trocar.demos import Episode
from trocar.vector import TrocarVectorEnv


class Seen(NamedTuple):
    """What there is to see before a step: rows of the environments that are stepped."""

    envs: NDArray[np.int64]
    """Which they are."""
    arrays: tuple[NDArray[Any], NDArray[Any], NDArray[Any]]
    """States, achieved and desired goals; goals without numbers where a task has none."""
    infos: dict[str, Any]
    """What came with them."""


Act = Callable[[Seen], NDArray[np.float32]]
"""Actions for each row."""


class Transitions(NamedTuple):
    """Steps of some episodes; arrays of shape (rows, …)."""

    observation: NDArray[np.float32]
    achieved: NDArray[np.float32]
    desired: NDArray[np.float32]
    action: NDArray[np.float32]
    label: NDArray[np.float32]
    reward: NDArray[np.float32]
    """Discounted sum of the step's and of those after it that count."""
    next_observation: NDArray[np.float32]
    """After the last step that counts; so is ``next_achieved``."""
    next_achieved: NDArray[np.float32]
    discount: NDArray[np.float32]
    """Of what is there: gamma, to the power of how many steps count; 0 where the last of them ended
    in a terminal state. A time limit is none."""

    @staticmethod
    def joined(parts: Sequence[Transitions]) -> Transitions:
        """The rows of all parts."""
        return Transitions(*map(np.concatenate, zip(*parts, strict=True)))


class Episodes:
    """The latest episodes of a task: arrays of shape (episodes, steps, …).

    Attributes:
        observation: Of each state, so one more than there are steps; so is ``achieved``.
        desired: The goal of each episode.
        label: What the expert would have done; the action itself where no expert was asked.
        length: Steps of each episode; what is beyond has no meaning.
    """

    NAMES = (
        *("observation", "achieved", "desired", "action", "label", "reward", "success"),
        *("terminated", "length", "seed"),
    )

    def __init__(self, spec: trocar.TaskSpec, capacity: int) -> None:
        """Has room for ``capacity`` episodes; later ones replace the oldest."""
        steps, goal = spec.max_steps, len(spec.goal or [])

        def zeros(*shape: int, dtype: Any = np.float32) -> NDArray[Any]:
            return np.zeros((capacity, *shape), dtype)

        self.observation = zeros(steps + 1, len(spec.observation))
        self.achieved = zeros(steps + 1, goal)
        self.desired = zeros(goal)
        self.action, self.label = zeros(steps, len(spec.action)), zeros(steps, len(spec.action))
        self.reward, self.success = zeros(steps), zeros(steps, dtype=np.bool_)
        self.terminated = zeros(steps, dtype=np.bool_)
        self.length, self.seed = zeros(dtype=np.int64), zeros(dtype=np.int64)
        self.capacity = capacity
        self.count = 0
        """Of all episodes that were ever added."""
        self._ends = np.zeros(0, np.int64)

    def __len__(self) -> int:
        """Number of episodes."""
        return min(self.count, self.capacity)

    @property
    def steps(self) -> int:
        """Of all episodes together."""
        return int(self.length[: len(self)].sum())

    @property
    def succeeded(self) -> NDArray[np.bool_]:
        """Of each episode: whether it ended in success; without goals, whether it lasted."""
        rows = np.arange(len(self))
        last = self.length[rows] - 1
        reached: NDArray[np.bool_] = self.success[rows, last]
        lasted: NDArray[np.bool_] = ~self.terminated[rows, last]
        return reached if self.desired.shape[1] else lasted

    def add(self, others: Episodes, chosen: NDArray[np.bool_] | None = None) -> None:
        """Takes other episodes in; of those only the chosen ones, if there is a choice."""
        rows = np.flatnonzero(np.ones(len(others), np.bool_) if chosen is None else chosen)
        rows = rows[-self.capacity :]
        places = (self.count + np.arange(len(rows))) % self.capacity
        for name in self.NAMES:
            getattr(self, name)[places] = getattr(others, name)[rows]
        self.count += len(rows)
        self._ends = self.length[: len(self)].cumsum()

    @classmethod
    def of(cls, spec: trocar.TaskSpec, shown: Sequence[Episode]) -> Episodes:
        """Recorded episodes of an expert."""
        made = cls(spec, len(shown))
        for row, episode in enumerate(shown):
            length = len(episode)
            made.observation[row, : length + 1] = episode.observation
            made.achieved[row, : length + 1] = episode.achieved_goal
            made.desired[row] = episode.desired_goal[0]
            made.action[row, :length] = made.label[row, :length] = episode.action
            made.reward[row, :length] = episode.reward
            made.success[row, :length] = episode.is_success
            made.terminated[row, :length] = episode.terminated
            made.length[row], made.seed[row] = length, episode.seed
        made.count = len(shown)
        made._ends = made.length.cumsum()
        return made

    def every_step(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """The episode and the time of every step."""
        episode = np.repeat(np.arange(len(self)), self.length[: len(self)])
        begins = np.concatenate(([0], self._ends[:-1]))
        return episode, np.arange(self.steps) - begins[episode]

    def sample(
        self,
        rows: int,
        hindsight: float,
        goals: Any,
        random: np.random.Generator,
        *,
        gamma: float = 1.0,
        n_steps: int = 1,
    ) -> Transitions:
        """Draws steps, each as likely as any other.

        Args:
            rows: How many.
            hindsight: The part of them that gets a goal which the episode reached later (HER,
                "future": Andrychowicz et al., Hindsight Experience Replay, 2017).
            goals: Environments of the task, which say what rewards are.
            random: What decides.
            gamma: Discount of a step.
            n_steps: How many steps' rewards count; fewer where the episode ends before.
        """
        step = random.integers(self._ends[-1], size=rows)
        episode = np.searchsorted(self._ends, step, side="right")
        time = step - self._ends[episode] + self.length[episode]
        left = self.length[episode] - time
        # Steps that may count, of shape (rows, n_steps); beyond the end they repeat the last.
        ahead = np.arange(n_steps)
        each = episode[:, None], time[:, None] + np.minimum(ahead, left[:, None] - 1)
        desired = self.desired[episode]
        reward, terminated = self.reward[each], self.terminated[each]
        (changed,) = np.nonzero(random.random(rows) < hindsight)
        if changed.size:
            later = time[changed] + 1 + random.integers(left[changed])
            desired[changed] = self.achieved[episode[changed], later]
            reached = self.achieved[each[0][changed], each[1][changed] + 1]
            both = reached.reshape(-1, desired.shape[1]), desired[changed].repeat(n_steps, 0)
            reward[changed] = goals.compute_reward(*both).reshape(-1, n_steps)
            terminated[changed] = goals.compute_terminated(*both).reshape(-1, n_steps)
        ended = terminated.cumsum(1) > terminated
        counts = (ahead < left[:, None]) & ~ended
        last = counts.sum(1) - 1
        powers = np.float32(gamma) ** np.arange(n_steps + 1, dtype=np.float32)
        goes_on = ~terminated[np.arange(rows), last]
        return Transitions(
            self.observation[episode, time],
            self.achieved[episode, time],
            desired,
            self.action[episode, time],
            self.label[episode, time],
            (reward * counts * powers[:-1]).sum(1),
            self.observation[episode, time + last + 1],
            self.achieved[episode, time + last + 1],
            powers[last + 1] * goes_on,
        )

    def state(self) -> dict[str, Any]:
        """All of it, for a checkpoint."""
        rows = len(self)
        return {"count": self.count} | {name: getattr(self, name)[:rows] for name in self.NAMES}

    def go_on(self, state: dict[str, Any]) -> None:
        """Has what :meth:`state` gave."""
        self.count = state["count"]
        for name in self.NAMES:
            getattr(self, name)[: len(self)] = state[name]
        self._ends = self.length[: len(self)].cumsum()


def play(
    envs: TrocarVectorEnv,
    act: Act,
    seeds: Sequence[int],
    *,
    begin: Callable[[Any], Any] = lambda observation: observation,
    meanwhile: Callable[[int], None] = lambda _: None,
) -> Episodes:
    """Plays an episode in each environment.

    Args:
        envs: Environments with autoreset ``disabled``; made with ``expert=True``, they also say
            what the expert would have done in each state.
        act: What acts.
        seeds: Of the episodes, one for each environment.
        begin: May put environments elsewhere after they were reset, as by
            :meth:`~trocar.TrocarVectorEnv.restore`: from the observations to those there.
        meanwhile: Called with the number of each step while the server simulates it.
    """
    played = Episodes(envs.task_spec, envs.num_envs)
    played.seed[:], played.count = seeds, envs.num_envs
    observation, infos = envs.reset(seed=list(seeds))
    observation = begin(observation)
    running = np.arange(envs.num_envs)
    seen = Seen(running, _arrays(observation), infos)
    played.observation[:, 0], played.achieved[:, 0], played.desired[:] = seen.arrays
    for time in itertools.count():
        action = act(seen)
        played.action[running, time] = action
        played.label[running, time] = seen.infos.get("expert_action", action)
        envs.send(action, running)
        meanwhile(time)
        observation, reward, terminated, truncated, infos = envs.recv()
        arrays = _arrays(observation)
        played.observation[running, time + 1], played.achieved[running, time + 1] = arrays[:2]
        played.reward[running, time], played.success[running, time] = reward, infos["is_success"]
        played.terminated[running, time] = terminated
        played.length[running] += 1
        goes_on = ~(terminated | truncated)
        running = running[goes_on]
        if not running.size:
            break
        left = [rows[goes_on] for rows in arrays]
        infos = {key: rows[goes_on] for key, rows in infos.items()}
        seen = Seen(running, (left[0], left[1], left[2]), infos)
    played._ends = played.length.cumsum()
    return played


def _arrays(seen: Any) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    if isinstance(seen, dict):
        return seen["observation"], seen["achieved_goal"], seen["desired_goal"]
    nothing = np.zeros((len(seen), 0), np.float32)
    return seen, nothing, nothing
