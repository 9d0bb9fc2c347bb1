"""Cloning demonstrations; and DAgger, where the expert labels the states of the policy."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from trocar.rl.config import Config
from trocar.rl.episodes import Episodes
from trocar.rl.features import BatchInputs
from trocar.rl.learner import Live, Own
from trocar.rl.networks import Policy

ROWS = 65_536
"""Whose features are computed in one call."""


def labelled(episodes: Episodes, features: BatchInputs) -> tuple[torch.Tensor, torch.Tensor]:
    """Features of every state in which a policy acted, and what the expert would have done."""
    episode, time = episodes.every_step()
    parts = [
        features(
            episodes.observation[episode[rows], time[rows]],
            episodes.achieved[episode[rows], time[rows]],
            episodes.desired[episode[rows]],
        )
        for rows in np.split(np.arange(len(time)), range(ROWS, len(time), ROWS))
    ]
    return torch.cat(parts), torch.from_numpy(episodes.label[episode, time])


def clone(
    policy: Policy,
    shown: tuple[torch.Tensor, torch.Tensor],
    config: Config,
    random: np.random.Generator,
    live: Live,
) -> list[float]:
    """Trains a policy to do as it was shown; the loss (mean absolute difference) of each update.

    The learning rate falls to nothing, so that the last updates average over many batches.
    """
    features, actions = shown
    optimizer = torch.optim.Adam(policy.parameters(), config.clone_rate, fused=True)
    losses = []
    for update in range(config.clone_updates):
        done = update / config.clone_updates
        optimizer.param_groups[0]["lr"] = config.clone_rate * (1 - done)
        rows = torch.from_numpy(random.integers(len(features), size=config.batch_size))
        loss = (policy(features[rows]) - actions[rows]).abs().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
        if update % 100 == 0:
            live(done)
    return losses


class Cloning(Own):
    """Behaviour cloning: the policy learns what demonstrations do, and acts nowhere."""

    def __init__(
        self,
        config: Config,
        demos: Episodes,
        seed: int,
        *,
        server: str | None = None,
        expert: bool = False,
    ) -> None:
        """As :class:`Own`; demonstrations are needed."""
        super().__init__(config, demos, seed, server=server, expert=expert)
        self.shown = labelled(demos, self.features)

    def begin(self, live: Live) -> None:
        """Learns the demonstrations."""
        self.policy.normal.fit(self.shown[0], self.config.norm_eps)
        self._clone(live)

    def learn(self, live: Live) -> None:
        """There is nothing else to learn."""

    def _clone(self, live: Live) -> None:
        losses = clone(self.policy, self.shown, self.config, self.random, live)
        self.updates += len(losses)
        self.note(clone_loss=float(np.mean(losses[-100:])))


class Dagger(Cloning):
    """DAgger: the policy acts, the expert says what it would have done, and that is cloned too.

    Source: Ross, Gordon and Bagnell, A Reduction of Imitation Learning and Structured Prediction to
    No-Regret Online Learning, AISTATS 2011.
    """

    def __init__(
        self, config: Config, demos: Episodes, seed: int, *, server: str | None = None
    ) -> None:
        """As :class:`Own`; demonstrations are needed."""
        super().__init__(config, demos, seed, server=server, expert=True)

    def learn(self, live: Live) -> None:
        """Plays the episodes of an epoch, and clones the expert in all states so far."""
        rounds = self.config.epoch_episodes // self.config.envs
        for number in range(rounds):
            played = self.play(lambda seen: self.policy.act(*seen.arrays))
            parts = zip(self.shown, labelled(played, self.features), strict=True)
            features, actions = map(torch.cat, parts)
            self.shown = features, actions
            live((number + 1) / (2 * rounds))
        self._clone(lambda done: live((1 + done) / 2))

    def state(self) -> dict[str, Any]:
        """All that decides how it goes on."""
        return super().state() | {"shown": self.shown}

    def go_on(self, state: dict[str, Any]) -> None:
        """Goes on from what :meth:`state` gave."""
        super().go_on(state)
        self.shown = state["shown"]
