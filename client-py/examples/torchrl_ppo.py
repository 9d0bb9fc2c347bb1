"""PPO with TorchRL on the dense reward of EcmReach: 16 environments in one session.

TorchRL resets by itself what has ended, so the environments are made with `disabled` autoreset.

    pip install trocar[torchrl]
    python torchrl_ppo.py
"""

from __future__ import annotations

import argparse

import gymnasium as gym
import torch
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.collectors import Collector
from torchrl.data import (
    Composite,
    LazyTensorStorage,
    ReplayBuffer,
    SamplerWithoutReplacement,
    Unbounded,
)
from torchrl.envs import CatTensors, Compose, GymWrapper, ObservationNorm, TransformedEnv
from torchrl.envs.gym_like import default_info_dict_reader
from torchrl.modules import NormalParamExtractor, ProbabilisticActor, TanhNormal, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

import trocar  # noqa: F401 - registers the ids

ENVS = 16
STEPS = 50  # of an episode
KEYS = ["observation", "achieved_goal", "desired_goal"]


def make_env(task: str, num_envs: int, *, seed: int, server: str | None = None) -> TransformedEnv:
    """The environments of one session as one TorchRL environment of batch size (num_envs,)."""
    envs = gym.make_vec(task, num_envs, server=server, autoreset_mode="disabled", reward="dense")
    env = GymWrapper(envs)
    success = Composite(is_success=Unbounded((num_envs,), dtype=torch.bool), shape=(num_envs,))
    env.set_info_dict_reader(default_info_dict_reader(["is_success"], spec=success))
    env.set_seed(seed)
    # Metres are small and close to each other: the networks see them relative to their bounds.
    bounds = [env.observation_spec[key].space for key in KEYS]
    low = torch.cat([bound.low[0] for bound in bounds])
    high = torch.cat([bound.high[0] for bound in bounds])
    scaled = ObservationNorm(
        (high + low) / 2, (high - low) / 2, in_keys=["state"], standard_normal=True
    )
    return TransformedEnv(
        env, Compose(CatTensors(KEYS, "state", del_keys=False, sort=False), scaled)
    )


def network(inputs: int, outputs: int) -> nn.Sequential:
    """Two hidden layers."""
    return nn.Sequential(
        nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, outputs)
    )


def main() -> None:
    """Trains, and prints returns, how near to the goal episodes end, and successes."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--steps", type=int, default=160_000, help="environment steps")
    steps = parser.parse_args().steps

    torch.manual_seed(0)
    torch.set_num_threads(1)
    env = make_env("trocar/EcmReach-v0", ENVS, seed=0)
    inputs = env.observation_spec["state"].shape[-1]
    actions = env.action_spec.shape[-1]
    actor = ProbabilisticActor(
        TensorDictModule(
            nn.Sequential(network(inputs, 2 * actions), NormalParamExtractor()),
            in_keys=["state"],
            out_keys=["loc", "scale"],
        ),
        in_keys=["loc", "scale"],
        spec=env.action_spec,
        distribution_class=TanhNormal,
        return_log_prob=True,
    )
    critic = ValueOperator(network(inputs, 1), in_keys=["state"])
    advantage = GAE(gamma=0.95, lmbda=0.95, value_network=critic, average_gae=True)
    loss = ClipPPOLoss(actor, critic, clip_epsilon=0.2, entropy_coeff=0.0)
    optimizer = torch.optim.Adam(loss.parameters(), lr=3e-3)

    frames = ENVS * STEPS
    samples = ReplayBuffer(
        storage=LazyTensorStorage(frames), sampler=SamplerWithoutReplacement(), batch_size=200
    )
    collector = Collector(
        env,
        actor,
        frames_per_batch=frames,
        total_frames=steps,
        auto_register_policy_transforms=False,
    )
    for number, batch in enumerate(collector, 1):
        for _ in range(8):
            with torch.no_grad():
                advantage(batch)
            samples.extend(batch.reshape(-1))
            for minibatch in samples:
                losses = loss(minibatch)
                total = losses["loss_objective"] + losses["loss_critic"]
                optimizer.zero_grad()
                total.backward()
                nn.utils.clip_grad_norm_(loss.parameters(), 0.5)
                optimizer.step()
        after = batch["next"]
        print(
            f"{number * frames:7} steps  mean return {after['reward'].sum().item() / ENVS:7.3f}  "
            f"ends {-1000 * after['reward'][:, -1].mean().item():5.1f} mm from the goal  "
            f"success {after['is_success'][:, -1].float().mean():4.0%}",
            flush=True,
        )
    collector.shutdown()


if __name__ == "__main__":
    main()
