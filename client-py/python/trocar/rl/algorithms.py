"""DDPG and PPO of Stable-Baselines3 with normalised inputs; DDPG for goals and demonstrations."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import DDPG, PPO, HerReplayBuffer
from stable_baselines3.common.noise import ActionNoise
from stable_baselines3.common.type_aliases import DictReplayBufferSamples, PyTorchObs
from stable_baselines3.common.utils import polyak_update
from stable_baselines3.td3.policies import Actor, TD3Policy
from torch.nn.functional import mse_loss

from trocar.rl.normalise import Normalised


class NormalisedPPO(PPO):
    """PPO whose inputs are relative to what was seen until the last training."""

    def train(self) -> None:
        """Trains on what was collected, then lets it count in the statistics."""
        super().train()
        extractor = self.policy.features_extractor
        assert isinstance(extractor, Normalised)
        rows = self.rollout_buffer.observations
        # Before training, the buffer was flattened to (rows, …).
        extractor.see(rows)
        extractor.refresh()


class AveragedPolicy(TD3Policy):
    """A policy of which the target actor acts."""

    @property
    def acting(self) -> Actor:
        """The actor that acts."""
        return self.actor_target

    def _predict(self, observation: PyTorchObs, deterministic: bool = False) -> torch.Tensor:  # noqa: ARG002
        action: torch.Tensor = self.acting(observation)
        return action


class NormalisedDDPG(DDPG):
    """DDPG whose inputs are relative to what was seen so far."""

    @property
    def normalised(self) -> Normalised:
        """What the networks see; actor and critic have it in common."""
        extractor = self.actor.features_extractor
        assert isinstance(extractor, Normalised)
        assert self.critic.features_extractor is extractor
        return extractor

    def _store_transition(self, *arguments: Any, **named: Any) -> None:
        assert self._last_obs is not None
        self.normalised.see(self._last_obs)
        super()._store_transition(*arguments, **named)

    def train(self, gradient_steps: int, batch_size: int = 100) -> None:
        """Lets what was seen count in the statistics, then trains."""
        self.normalised.refresh()
        super().train(gradient_steps, batch_size)


class Losses(NamedTuple):
    """Of one batch; 0-dimensional tensors."""

    policy: torch.Tensor
    """What the actor minimises."""
    clone: torch.Tensor
    """Sum of squared differences from the demonstrated actions that pass the filter."""
    passed: torch.Tensor
    """Part of the demonstrated actions that do."""


class GoalDDPG(NormalisedDDPG):
    """DDPG for sparse goals, with or without demonstrations.

    As OpenAI baselines have it, and so the paper and the original: targets are clipped to returns
    that are possible, large actions cost, a part of actions is random while exploring, and target
    networks move once after each training.

    With demonstrations, a part of each batch is theirs, and the actor also imitates them where the
    critic rates the demonstrated action above its own (behaviour cloning with a Q-filter). Source:
    Nair et al., Overcoming Exploration in Reinforcement Learning with Demonstrations, ICRA 2018.
    """

    def __init__(
        self,
        *arguments: Any,
        random_actions: float = 0.0,
        action_l2: float = 0.0,
        demo_batch: int = 0,
        policy_weight: float = 1.0,
        clone_weight: float = 0.0,
        q_filter: bool = True,
        **named: Any,
    ) -> None:
        """Takes DDPG's arguments, and those of :class:`~trocar.rl.config.Config` of these names."""
        self.random_actions = random_actions
        self.action_l2 = action_l2
        self.demo_batch = demo_batch
        self.policy_weight = policy_weight
        self.clone_weight = clone_weight
        self.q_filter = q_filter
        self.demos: HerReplayBuffer | None = None
        super().__init__(*arguments, **named)

    def learn_from(self, demos: HerReplayBuffer) -> None:
        """Gives it demonstrations; they count in the statistics of inputs, too."""
        self.demos = demos
        rows = np.arange(demos.size())
        self.normalised.see({key: seen[rows, 0] for key, seen in demos.observations.items()})

    def train(self, gradient_steps: int, batch_size: int = 100) -> None:
        """Makes gradient steps, then moves the target networks.

        Args:
            gradient_steps: How many.
            batch_size: Transitions in each, demonstrations included.
        """
        self.policy.set_training_mode(True)
        self._update_learning_rate([self.actor.optimizer, self.critic.optimizer])
        self.normalised.refresh()
        self._copy_statistics()
        noted: dict[str, list[float]] = {}
        for _ in range(gradient_steps):
            self._n_updates += 1
            batch = self.sample(batch_size)
            critic_loss = self.critic_loss(batch)
            self.critic.optimizer.zero_grad()
            critic_loss.backward()  # type: ignore[no-untyped-call]
            self.critic.optimizer.step()
            losses = self.actor_losses(batch)
            self.actor.optimizer.zero_grad()
            # The critic's own gradients would be computed for nothing.
            losses.policy.backward(inputs=list(self.actor.parameters()))  # type: ignore[no-untyped-call]
            self.actor.optimizer.step()
            values = {"critic_loss": critic_loss, "actor_loss": losses.policy}
            if self.demos is not None:
                values |= {"clone_loss": losses.clone, "passed": losses.passed}
            for name, value in values.items():
                noted.setdefault(name, []).append(value.item())
        polyak_update(self.critic.parameters(), self.critic_target.parameters(), self.tau)
        polyak_update(self.actor.parameters(), self.actor_target.parameters(), self.tau)
        for name, numbers in noted.items():
            self.logger.record(f"train/{name}", float(np.mean(numbers)))

    def sample(self, batch_size: int) -> DictReplayBufferSamples:
        """A batch whose last :attr:`demo_batch` rows are demonstrations, if there are any."""
        assert isinstance(self.replay_buffer, HerReplayBuffer)
        if self.demos is None:
            return self.replay_buffer.sample(batch_size)
        own = self.replay_buffer.sample(batch_size - self.demo_batch)
        theirs = self.demos.sample(self.demo_batch)
        return DictReplayBufferSamples(
            observations=_joined(own.observations, theirs.observations),
            actions=torch.cat([own.actions, theirs.actions]),
            next_observations=_joined(own.next_observations, theirs.next_observations),
            dones=torch.cat([own.dones, theirs.dones]),
            rewards=torch.cat([own.rewards, theirs.rewards]),
        )

    def critic_loss(self, batch: DictReplayBufferSamples) -> torch.Tensor:
        """Mean squared difference from the one-step target, which is a return that is possible."""
        with torch.no_grad():
            action = self.actor_target(batch.next_observations)
            (value,) = self.critic_target(batch.next_observations, action)
            target = batch.rewards + (1 - batch.dones) * self.gamma * value
            target = target.clamp(-1 / (1 - self.gamma), 0.0)
        (value,) = self.critic(batch.observations, batch.actions)
        return mse_loss(value, target)

    def actor_losses(self, batch: DictReplayBufferSamples) -> Losses:
        """DDPG's loss of the policy with the cost of actions, and that of cloning."""
        action = self.actor(batch.observations)
        (value,) = self.critic(batch.observations, action)
        own = -value.mean() + self.action_l2 * action.square().mean()
        nothing = torch.zeros(())
        if self.demos is None:
            return Losses(own, nothing, nothing)
        count = self.demo_batch
        shown = batch.actions[-count:]
        passes = torch.ones(count, dtype=torch.bool)
        if self.q_filter:
            seen = {key: rows[-count:] for key, rows in batch.observations.items()}
            with torch.no_grad():
                (shown_value,) = self.critic(seen, shown)
            passes = (shown_value > value.detach()[-count:])[:, 0]
        off = (action[-count:] - shown)[passes]
        clone = off.square().sum()
        loss = self.policy_weight * own + self.clone_weight * clone
        return Losses(loss, clone.detach(), passes.float().mean())

    def _sample_action(
        self, learning_starts: int, action_noise: ActionNoise | None = None, n_envs: int = 1
    ) -> tuple[NDArray[Any], NDArray[Any]]:
        _, stored = super()._sample_action(learning_starts, action_noise, n_envs)
        random = np.random.uniform(-1, 1, stored.shape).astype(stored.dtype)
        chosen = np.random.uniform(size=(n_envs, 1)) < self.random_actions
        stored = np.where(chosen, random, stored)
        return self.policy.unscale_action(stored), stored

    def _copy_statistics(self) -> None:
        """Lets target networks see what the others see."""
        polyak_update(self.critic_batch_norm_stats, self.critic_batch_norm_stats_target, 1.0)
        polyak_update(self.actor_batch_norm_stats, self.actor_batch_norm_stats_target, 1.0)

    def _excluded_save_params(self) -> list[str]:
        return [*super()._excluded_save_params(), "demos"]


def _joined(
    own: dict[str, torch.Tensor], theirs: dict[str, torch.Tensor]
) -> dict[str, torch.Tensor]:
    """The rows of both, by key."""
    return {key: torch.cat([rows, theirs[key]]) for key, rows in own.items()}
