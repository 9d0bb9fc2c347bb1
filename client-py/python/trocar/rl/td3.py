"""TD3 with hindsight goals and demonstrations, on features: minutes to a policy on one core."""

from __future__ import annotations

import copy
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn.functional import mse_loss

from trocar.rl.config import Config
from trocar.rl.episodes import Episodes, Seen, Transitions
from trocar.rl.imitation import clone, labelled
from trocar.rl.learner import Live, Own
from trocar.rl.networks import Critics, Policy

PAIR = 2
"""How many of the critics rate a batch: the lower value counts."""


class Batch(NamedTuple):
    """Transitions as networks see them; the first :attr:`shown` rows are from demonstrations."""

    features: torch.Tensor
    action: torch.Tensor
    label: torch.Tensor
    reward: torch.Tensor
    next_features: torch.Tensor
    discount: torch.Tensor
    shown: int


class Td3Demo(Own):
    """TD3 from sparse rewards, hindsight goals and, where there are any, demonstrations.

    The policy first clones the demonstrations. Then it improves by the critics' gradient, and goes
    on imitating demonstrated actions where the critics rate them above its own (Q-filter). A part
    of each batch is from demonstrations. Critics are trained alone for some time before the policy
    follows them. Of more than two critics, two are drawn for each batch. A moving average of the
    policy is scored. Batches are learnt from while the server simulates the next step.

    Sources: Fujimoto et al., Addressing Function Approximation Error in Actor-Critic Methods, ICML
    2018; Nair et al., Overcoming Exploration with Demonstrations, ICRA 2018; Ball et al., Efficient
    Online Reinforcement Learning with Offline Data, ICML 2023.

    Attributes:
        replay: What was played.
        growing: The demonstrations, where its own successes become some.
        averaged: The average of the policy, which is scored.
        critics: What rates actions.
    """

    def __init__(
        self, config: Config, demos: Episodes | None, seed: int, *, server: str | None = None
    ) -> None:
        """Untrained."""
        super().__init__(config, demos, seed, server=server)
        if config.algo != "td3-demo":
            self.demos = None
        spec = self.envs.task_spec
        low = -1 / (1 - config.gamma)
        self.bounds = {"sparse": (low, 0.0), "dense": (-np.inf, 0.0)}.get(
            spec.reward, (-np.inf, np.inf)
        )
        played = config.epochs * config.epoch_episodes
        self.growing: Episodes | None = None
        if self.demos is not None and config.own_demos:
            self.growing = Episodes(spec, len(self.demos) + played)
            self.growing.add(self.demos)
            self.demos = self.growing
        room = played + config.learning_starts // spec.max_steps + 1
        self.replay = Episodes(spec, min(room, max(1, config.buffer_size // spec.max_steps)))
        first = 0.3 * low if spec.reward == "sparse" else 0.0
        self.critics = Critics(self.policy, config.hidden, config.critics, first)
        self._copy()
        self._optimise()

    def _copy(self) -> None:
        """Lets targets and average be what is trained now."""
        self.averaged, self.target = copy.deepcopy(self.policy), copy.deepcopy(self.policy)
        self.target_critics = copy.deepcopy(self.critics)
        for network in (self.averaged, self.target, self.target_critics):
            network.requires_grad_(False)

    def _optimise(self) -> None:
        rate = self.config.learning_rate
        self.optimizer = torch.optim.Adam(self.policy.parameters(), rate, fused=True)
        self.critic_optimizer = torch.optim.Adam(self.critics.parameters(), rate, fused=True)

    @property
    def acting(self) -> Policy:
        """The average of the policy."""
        return self.averaged

    def begin(self, live: Live) -> None:
        """Clones the demonstrations and trains critics on them; without any, acts at random."""
        config = self.config
        if self.demos is None:
            while self.steps < config.learning_starts:
                self.replay.add(self.play(self._at_random))
            drawn = self.replay.sample(
                20 * config.batch_size, config.hindsight, self.envs, self.random
            )
            self.policy.normal.fit(self._features(drawn)[0], config.norm_eps)
        else:
            shown = labelled(self.demos, self.features)
            self.policy.normal.fit(shown[0], config.norm_eps)
            losses = clone(self.policy, shown, config, self.random, lambda done: live(done / 2))
            self.note(clone_loss=float(np.mean(losses[-100:])))
        self._copy()
        for update in range(config.critic_updates):
            self.update()
            if update % 100 == 0:
                live(0.5 + 0.5 * update / config.critic_updates)

    def learn(self, live: Live) -> None:
        """Plays the episodes of an epoch, and learns meanwhile."""
        rounds = self.config.epoch_episodes // self.config.envs
        for number in range(rounds):
            # One for the episode of each environment, so that some hardly stray and others do.
            noise = 2 * self.config.noise * self.random.random((self.config.envs, 1))
            act, meanwhile = partial(self._explore, noise), partial(self._train, self.weight())
            played = self.play(act, meanwhile)
            self.replay.add(played)
            if self.growing is not None:
                self.growing.add(played, played.succeeded)
            live((number + 1) / rounds)

    def weight(self) -> float:
        """Of the critics' value for the policy: none while they warm up, then ever more."""
        config = self.config
        since = self.replay.count - config.warm_up
        if since < 0:
            return 0.0
        return config.policy_weight * min(1.0, (since + config.envs) / max(1, config.ramp))

    def _explore(self, noise: NDArray[np.float64], seen: Seen) -> NDArray[np.float32]:
        """The policy's actions with noise; a part of them is random."""
        action = self.policy.act(*seen.arrays)
        noisy = action + noise[seen.envs] * self.random.standard_normal(action.shape)
        chosen = self.random.random((len(action), 1)) < self.config.random_actions
        mixed = np.where(chosen, self._at_random(seen), noisy)
        return mixed.clip(-1.0, 1.0).astype(np.float32)

    def _at_random(self, seen: Seen) -> NDArray[np.float32]:
        shape = len(seen.envs), len(self.envs.task_spec.action)
        return self.random.uniform(-1.0, 1.0, shape).astype(np.float32)

    def _train(self, weight: float, time: int) -> None:
        """Trains after a step of each environment."""
        if time % self.config.train_every == 0:
            for _ in range(self.config.updates):
                self.update(weight)

    def batch(self) -> Batch:
        """Draws a batch: of demonstrations, and of what was played if anything was."""
        config, parts, shown = self.config, [], 0
        if self.demos is not None:
            shown = config.demo_batch if len(self.replay) else config.batch_size
            parts.append(self._sample(self.demos, shown, config.demo_hindsight))
        if shown < config.batch_size:
            rows = config.batch_size - shown
            parts.append(self._sample(self.replay, rows, config.hindsight))
        drawn = Transitions.joined(parts)
        features, next_features = self._features(drawn)
        rest = (drawn.action, drawn.label, drawn.reward, drawn.discount)
        action, label, reward, discount = map(torch.from_numpy, rest)
        return Batch(features, action, label, reward, next_features, discount, shown)

    def _sample(self, episodes: Episodes, rows: int, hindsight: float) -> Transitions:
        config = self.config
        return episodes.sample(
            rows, hindsight, self.envs, self.random, gamma=config.gamma, n_steps=config.n_steps
        )

    def _features(self, drawn: Transitions) -> tuple[torch.Tensor, torch.Tensor]:
        """Before and after each step, computed in one call."""
        both = (
            np.concatenate([drawn.observation, drawn.next_observation]),
            np.concatenate([drawn.achieved, drawn.next_achieved]),
            np.concatenate([drawn.desired, drawn.desired]),
        )
        before, after = self.features(*both).chunk(2)
        return before, after

    def update(self, weight: float = 0.0) -> None:
        """Trains critics on a batch, and every so many times the policy, unless ``weight`` is 0."""
        self.updates += 1
        batch = self.batch()
        pair = self._pair()
        loss, values = self.critic_loss(batch, pair)
        self.critic_optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        self.critic_optimizer.step()
        _follow(self.target_critics, self.critics, self.config.tau)
        self.note(critic_loss=loss.item())
        if weight > 0.0 and self.updates % self.config.policy_every == 0:
            loss, clone_loss, passed = self.policy_loss(batch, values, weight, pair)
            trained = list(self.policy.parameters())
            # The critics' own gradients would be computed for nothing.
            for parameter, slope in zip(trained, torch.autograd.grad(loss, trained), strict=True):
                parameter.grad = slope
            self.optimizer.step()
            _follow(self.target, self.policy, self.config.tau)
            _follow(self.averaged, self.policy, self.config.averaging)
            self.note(actor_loss=loss.item())
            if batch.shown:
                self.note(clone_loss=clone_loss.item(), passed=passed.item())

    def _pair(self) -> list[int]:
        """Which critics rate a batch."""
        count = self.config.critics
        if count == PAIR:
            return [0, 1]
        return [int(critic) for critic in self.random.choice(count, PAIR, replace=False)]

    def critic_loss(self, batch: Batch, pair: list[int]) -> tuple[torch.Tensor, torch.Tensor]:
        """Mean squared difference from targets that are possible returns; and the lower values.

        Args:
            batch: Some transitions.
            pair: The critics that make the targets, and that say the values.
        """
        limit = 2 * self.config.target_noise
        with torch.no_grad():
            action = self.target(batch.next_features)
            noise = self.random.standard_normal(tuple(action.shape), np.float32)
            noise = (self.config.target_noise * noise).clip(-limit, limit)
            action = (action + torch.from_numpy(noise)).clamp(-1, 1)
            value = self.target_critics(batch.next_features, action)[pair].amin(0)
            target = batch.reward + batch.discount * value
            target = target.clamp(*self.bounds)
        values = self.critics(batch.features, batch.action)
        loss = mse_loss(values, target.expand_as(values), reduction="sum") / len(target)
        return loss, values.detach()[pair].amin(0)

    def policy_loss(
        self, batch: Batch, values: torch.Tensor, weight: float, pair: list[int]
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """What the policy minimises, its part from cloning, and what part of that passes.

        Args:
            batch: Some transitions.
            values: Of the actions in it.
            weight: Of the value of its own actions.
            pair: The critics that say it.
        """
        config, shown = self.config, batch.shown
        action = self.policy(batch.features)
        own = self.critics(batch.features, action)[pair].amin(0)
        loss = -weight * own.mean()
        nothing = torch.zeros(())
        if shown == 0:
            return loss, nothing, nothing
        off = (action[:shown] - batch.label[:shown]).abs().mean(1)
        passes = values[:shown] > own.detach()[:shown] if config.q_filter else torch.ones(shown)
        clone_loss = (off * passes).mean()
        return loss + config.clone_weight * clone_loss, clone_loss.detach(), passes.float().mean()

    def _networks(self) -> dict[str, Any]:
        """Whatever has a state, by name."""
        names = ("averaged", "target", "critics", "target_critics", "optimizer", "critic_optimizer")
        return {name: getattr(self, name) for name in names}

    def state(self) -> dict[str, Any]:
        """All that decides how it goes on."""
        networks = {name: network.state_dict() for name, network in self._networks().items()}
        told = {"networks": networks, "replay": self.replay.state()}
        if self.growing is not None:
            told["demos"] = self.growing.state()
        return super().state() | told

    def go_on(self, state: dict[str, Any]) -> None:
        """Goes on from what :meth:`state` gave."""
        super().go_on(state)
        for name, network in self._networks().items():
            network.load_state_dict(state["networks"][name])
        self.replay.go_on(state["replay"])
        if self.growing is not None:
            self.growing.go_on(state["demos"])


def _follow(target: torch.nn.Module, source: torch.nn.Module, part: float) -> None:
    """Moves weights by a part of the way to others."""
    with torch.no_grad():
        torch._foreach_lerp_(list(target.parameters()), list(source.parameters()), part)
