"""What a training run asks of every algorithm, and what Trocar's own algorithms have in common."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch

from trocar.rl.config import Config
from trocar.rl.curriculum import Curriculum
from trocar.rl.episodes import Act, Episodes, play
from trocar.rl.evaluation import Policy as Acting
from trocar.rl.features import BatchInputs, Inputs
from trocar.rl.networks import Policy
from trocar.vector import TrocarVectorEnv

Row = dict[str, float]
"""Of a curve: numbers by the names in :data:`trocar.rl.runs.COLUMNS`."""

Live = Callable[[float], None]
"""Is told which part of an epoch is done."""

FIRST_SEED, LAST_SEED = 10_000_000, 2**31
"""Of the episodes that are learnt from: far from those of scores and demonstrations."""


class Learner(Protocol):
    """An algorithm in the middle of a run."""

    @property
    def acting(self) -> Acting:
        """What is scored, and saved as a policy."""

    def begin(self, live: Live) -> None:
        """Learns what comes before the first epoch, if anything does."""

    def learn(self, live: Live) -> None:
        """Learns for one epoch."""

    def row(self) -> Row:
        """Steps and updates so far, and losses of the latest epoch."""

    def save_policy(self, path: Path) -> None:
        """Writes :attr:`acting`."""

    def save(self, folder: Path) -> None:
        """Writes all that :meth:`restore` needs to go on."""

    def restore(self, folder: Path) -> None:
        """Goes on where another was when it was saved."""

    def close(self) -> None:
        """Ends its environments."""


class Own:
    """What Trocar's own algorithms have in common: environments, demonstrations, a policy.

    Attributes:
        envs: Where episodes are played.
        demos: Episodes of the expert; ``None`` without.
        policy: What is trained.
        random: Decides all that is random, but the first weights.
    """

    def __init__(
        self,
        config: Config,
        demos: Episodes | None,
        seed: int,
        *,
        server: str | None = None,
        expert: bool = False,
    ) -> None:
        """Untrained; ``seed`` is of networks, exploration and episodes."""
        self.config, self.demos = config, demos
        self.envs = TrocarVectorEnv(
            config.task,
            config.envs,
            server=server,
            autoreset_mode="disabled",
            expert=expert,
            **config.options,
        )
        spec = self.envs.task_spec
        self.random = np.random.default_rng(seed)
        torch.manual_seed(seed)
        inputs = Inputs.of(spec, config.words)
        self.policy = Policy(inputs, len(spec.action), config.hidden, config.norm_clip)
        self.features = BatchInputs(spec, config.words)
        self.curriculum = None
        if demos is not None and config.curriculum:
            self.curriculum = Curriculum(self.envs, demos, config, self.random)
        self.steps = self.updates = 0
        self._noted: dict[str, list[float]] = {}

    @property
    def acting(self) -> Policy:
        """What is scored, and saved as a policy."""
        return self.policy

    def seeds(self) -> list[int]:
        """Of the next episodes, one for each environment."""
        seeds = self.random.integers(FIRST_SEED, LAST_SEED, size=self.envs.num_envs)
        return [int(seed) for seed in seeds]

    def play(self, act: Act, meanwhile: Callable[[int], None] = lambda _: None) -> Episodes:
        """Plays an episode in each environment, which begins where the curriculum says.

        Args:
            act: What acts.
            meanwhile: Called with the number of each step while the server simulates it.
        """
        curriculum = self.curriculum
        begun_at: list[int] = []

        def begin(observation: Any) -> Any:
            if curriculum is None:
                return observation
            for env in range(self.envs.num_envs):
                level, state = curriculum.draw()
                begun_at.append(level)
                if state is not None:
                    observation = self.envs.restore(state, [env])
            return observation

        played = play(self.envs, act, self.seeds(), begin=begin, meanwhile=meanwhile)
        self.steps += played.steps
        if curriculum is not None:
            for level, success in zip(begun_at, played.succeeded, strict=True):
                curriculum.count(level, bool(success))
        return played

    def note(self, **values: float) -> None:
        """Notes losses of an update."""
        for name, value in values.items():
            self._noted.setdefault(name, []).append(value)

    def row(self) -> Row:
        """Steps and updates so far, mean losses since the latest row, the curriculum's level."""
        row = {name: float(np.mean(values)) for name, values in self._noted.items()}
        self._noted.clear()
        if self.curriculum is not None:
            row["level"] = self.curriculum.level
        return {"steps": self.steps, "updates": self.updates, **row}

    def save_policy(self, path: Path) -> None:
        """Writes :attr:`acting`."""
        self.acting.save(path)

    def state(self) -> dict[str, Any]:
        """All that decides how it goes on."""
        progress = {
            "steps": self.steps,
            "updates": self.updates,
            "random": self.random.bit_generator.state,
        }
        told = {"progress": progress, "policy": self.policy.state_dict()}
        if self.curriculum is not None:
            told["curriculum"] = self.curriculum.progress()
        return told

    def go_on(self, state: dict[str, Any]) -> None:
        """Goes on from what :meth:`state` gave."""
        self.steps, self.updates = state["progress"]["steps"], state["progress"]["updates"]
        self.random.bit_generator.state = state["progress"]["random"]
        self.policy.load_state_dict(state["policy"])
        if self.curriculum is not None:
            self.curriculum.go_on(state["curriculum"])

    def save(self, folder: Path) -> None:
        """Writes all that :meth:`restore` needs to go on."""
        torch.save(_plain(self.state()), folder / "learner.pt")

    def restore(self, folder: Path) -> None:
        """Goes on where another was when it was saved."""
        self.go_on(torch.load(folder / "learner.pt", weights_only=True))

    def close(self) -> None:
        """Ends its environments."""
        self.envs.close()


def _plain(value: Any) -> Any:
    """A state of tensors, numbers, text, lists and dictionaries: no type that pickle calls."""
    if isinstance(value, Mapping):
        return {key: _plain(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(part) for part in value]
    if isinstance(value, np.ndarray):
        return torch.from_numpy(value)
    return value.item() if isinstance(value, np.generic) else value
