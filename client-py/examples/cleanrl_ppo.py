"""PPO in one file, in the manner of CleanRL, on the dense reward of EcmReach.

`same_step` autoreset keeps every transition a real one; where an episode was cut short, its last
observation is in `infos["final_obs"]`.

    pip install trocar torch
    python cleanrl_ppo.py
"""

from __future__ import annotations

import argparse
import time

import gymnasium as gym
import numpy as np
import torch
from torch import nn
from torch.distributions import Normal

import trocar  # noqa: F401 - registers the ids

ENVS, STEPS = 16, 50
EPOCHS, MINIBATCHES = 8, 4
GAMMA, LAMBDA, CLIP, LEARNING_RATE = 0.95, 0.95, 0.2, 3e-3


class Agent(nn.Module):
    """A policy, normal around the mean that a network gives, and a value."""

    def __init__(self, inputs: int, actions: int) -> None:
        super().__init__()
        self.mean = self.network(inputs, actions)
        self.log_std = nn.Parameter(torch.full((actions,), -1.0))
        self.critic = self.network(inputs, 1)

    @staticmethod
    def network(inputs: int, outputs: int) -> nn.Sequential:
        """Two hidden layers."""
        return nn.Sequential(
            nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, outputs)
        )

    def policy(self, observations: torch.Tensor) -> Normal:
        """Distributions of actions."""
        return Normal(self.mean(observations), self.log_std.exp())

    def value(self, observations: torch.Tensor) -> torch.Tensor:
        """What is still to be had."""
        return self.critic(observations).squeeze(-1)


def flat(observations: dict[str, np.ndarray], space: gym.spaces.Dict) -> torch.Tensor:
    """Rows relative to the bounds of the space, since metres are small and close to each other."""
    scaled = [
        (observations[key] - (box.high + box.low) / 2) / ((box.high - box.low) / 2)
        for key, box in space.items()
    ]
    return torch.as_tensor(np.concatenate(scaled, axis=1))


def main() -> None:
    """Trains, and prints returns and how near to the goal episodes end."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--steps", type=int, default=160_000, help="environment steps")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()

    torch.manual_seed(arguments.seed)
    torch.set_num_threads(1)
    envs = gym.make_vec(
        "trocar/EcmReach-v0", num_envs=ENVS, autoreset_mode="same_step", reward="dense"
    )
    space = envs.single_observation_space
    agent = Agent(gym.spaces.flatdim(space), gym.spaces.flatdim(envs.single_action_space))
    optimizer = torch.optim.Adam(agent.parameters(), lr=LEARNING_RATE)

    started = time.monotonic()
    observations, _ = envs.reset(seed=arguments.seed)
    state = flat(observations, space)
    for update in range(1, arguments.steps // (ENVS * STEPS) + 1):
        # Act.
        states, actions, log_probs, rewards, values, nexts, ends = ([] for _ in range(7))
        for _ in range(STEPS):
            with torch.no_grad():
                policy, value = agent.policy(state), agent.value(state)
                action = policy.sample()
            observations, reward, terminations, truncations, infos = envs.step(
                action.clamp(-1, 1).numpy()
            )
            done = terminations | truncations
            after = {key: rows.copy() for key, rows in observations.items()}
            for row in np.flatnonzero(done):
                for key in after:
                    after[key][row] = infos["final_obs"][row][key]
            with torch.no_grad():
                following = agent.value(flat(after, space)) * ~torch.as_tensor(terminations)
            states.append(state)
            actions.append(action)
            log_probs.append(policy.log_prob(action).sum(-1))
            rewards.append(torch.as_tensor(reward))
            values.append(value)
            nexts.append(following)
            ends.append(torch.as_tensor(done))
            state = flat(observations, space)

        # Generalised advantages, backwards through time.
        advantages, advantage = [], torch.zeros(ENVS)
        for step in reversed(range(STEPS)):
            error = rewards[step] + GAMMA * nexts[step] - values[step]
            advantage = error + GAMMA * LAMBDA * advantage * ~ends[step]
            advantages.append(advantage)
        advantages = torch.cat(advantages[::-1])
        old_states, old_actions = torch.cat(states), torch.cat(actions)
        old_log_probs, returns = torch.cat(log_probs), advantages + torch.cat(values)

        # Learn.
        for _ in range(EPOCHS):
            for rows in torch.randperm(ENVS * STEPS).chunk(MINIBATCHES):
                log_prob = agent.policy(old_states[rows]).log_prob(old_actions[rows]).sum(-1)
                ratio = (log_prob - old_log_probs[rows]).exp()
                gain = advantages[rows]
                gain = (gain - gain.mean()) / (gain.std() + 1e-8)
                policy_loss = -torch.min(ratio * gain, ratio.clamp(1 - CLIP, 1 + CLIP) * gain)
                value_loss = (agent.value(old_states[rows]) - returns[rows]).square()
                optimizer.zero_grad()
                (policy_loss.mean() + 0.5 * value_loss.mean()).backward()
                nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
                optimizer.step()

        steps = update * ENVS * STEPS
        print(
            f"{steps:7} steps  mean return {torch.stack(rewards).sum().item() / ENVS:7.3f}  "
            f"ends {-1000 * rewards[-1].mean().item():5.1f} mm from the goal  "
            f"{steps / (time.monotonic() - started):6.0f} steps/s",
            flush=True,
        )
    envs.close()


if __name__ == "__main__":
    main()
