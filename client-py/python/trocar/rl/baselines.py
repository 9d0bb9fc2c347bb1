"""Stable-Baselines3's algorithms as learners of a run."""

from __future__ import annotations

import pickle
import random
import sys
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3 import HerReplayBuffer
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.noise import NormalActionNoise
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

import trocar
from trocar.rl import demonstrations
from trocar.rl.algorithms import AveragedPolicy, GoalDDPG, NormalisedDDPG, NormalisedPPO
from trocar.rl.config import Config
from trocar.rl.curriculum import CurriculumVecEnv
from trocar.rl.episodes import Episodes
from trocar.rl.features import Inputs
from trocar.rl.learner import Live, Row
from trocar.rl.normalise import Normalised
from trocar.sb3 import TrocarVecEnv, make_vec

CLASSES: dict[str, type[BaseAlgorithm]] = {
    "ddpg": NormalisedDDPG,
    "her": GoalDDPG,
    "her-demo": GoalDDPG,
    "ppo": NormalisedPPO,
}
"""What trains each algorithm."""

SEEDS_APART = 10_000
"""Between the seeds of the environments of two runs: their episodes are not the same."""


class Baseline:
    """A model of Stable-Baselines3 and its environments.

    Attributes:
        envs: Where it collects experience.
        model: The model.
    """

    def __init__(
        self, config: Config, demos: Episodes | None, seed: int, *, server: str | None = None
    ) -> None:
        """Untrained; ``seed`` is of networks, exploration and environments."""
        self.config, self.demos = config, demos
        self.envs = make_vec(config.task_id, config.envs, server=server, **config.options)
        if demos is not None and config.curriculum:
            self.envs = CurriculumVecEnv(self.envs.envs, demos, config)
        self.model = make_model(config, self.envs, seed)
        self._ready()
        if config.algo == "her-demo":
            assert demos is not None
            assert isinstance(self.model, GoalDDPG)
            self.model.learn_from(demonstrations.buffer(demos, config, self.envs))

    def _ready(self) -> None:
        # What it logs is read after each epoch instead.
        self.model.set_logger(Logger(None, []))

    @property
    def acting(self) -> BaseAlgorithm:
        """What is scored, and saved as a policy."""
        return self.model

    def begin(self, live: Live) -> None:
        """Nothing comes before the first epoch."""

    def learn(self, live: Live) -> None:
        """Learns for one epoch."""
        steps = self.config.epoch_steps
        told = _Told(live, steps)
        self.model.learn(steps, told, reset_num_timesteps=False, log_interval=sys.maxsize)

    def row(self) -> Row:
        """Steps and updates so far, and losses of the epoch's last training."""
        told: dict[str, Any] = self.model.logger.name_to_value
        row: Row = {"steps": self.model.num_timesteps, "updates": self.model._n_updates}
        # PPO has other names for the same.
        losses = {"actor_loss": "policy_gradient_loss", "critic_loss": "value_loss"}
        for name in ("actor_loss", "critic_loss", "clone_loss", "passed"):
            for source in (name, losses.get(name)):
                if f"train/{source}" in told:
                    row[name] = float(told[f"train/{source}"])
        if isinstance(self.envs, CurriculumVecEnv):
            row["level"] = self.envs.curriculum.level
        return row

    def save_policy(self, path: Path) -> None:
        """Writes :attr:`acting`."""
        self.model.save(path)

    def save(self, folder: Path) -> None:
        """Writes networks, optimisers, experience, randomness and environments."""
        model, envs = self.model, self.envs
        model.save(folder / "model.zip")
        if isinstance(model, OffPolicyAlgorithm):
            with (folder / "replay.pkl").open("wb") as file:
                pickle.dump(model.replay_buffer, file, protocol=5)
        state = {
            "last_obs": model._last_obs,
            "last_episode_starts": model._last_episode_starts,
            "envs": envs.envs.snapshot().to_bytes(),
            "curriculum": envs.progress() if isinstance(envs, CurriculumVecEnv) else None,
            "python": random.getstate(),
            "numpy": np.random.get_state(),
            "torch": torch.get_rng_state(),
            "actions": model.action_space.np_random,
        }
        with (folder / "model.pkl").open("wb") as file:
            pickle.dump(state, file, protocol=5)

    def restore(self, folder: Path) -> None:
        """Goes on where another was when it was saved."""
        envs = self.envs
        with (folder / "model.pkl").open("rb") as file:
            state: dict[str, Any] = pickle.load(file)
        model = CLASSES[self.config.algo].load(folder / "model.zip", env=envs, device="cpu")
        if isinstance(model, OffPolicyAlgorithm):
            with (folder / "replay.pkl").open("rb") as file:
                model.replay_buffer = pickle.load(file)
            if isinstance(model.replay_buffer, HerReplayBuffer):
                model.replay_buffer.set_env(envs)
        if isinstance(model, GoalDDPG) and isinstance(self.model, GoalDDPG):
            model.demos = self.model.demos
        envs.reset()
        envs.envs.restore(trocar.Snapshot.from_bytes(state["envs"]))
        if isinstance(envs, CurriculumVecEnv):
            envs.go_on(state["curriculum"])
        model._last_obs = state["last_obs"]
        model._last_episode_starts = state["last_episode_starts"]
        model.action_space._np_random = state["actions"]
        self.model = model
        self._ready()
        random.setstate(state["python"])
        np.random.set_state(state["numpy"])
        torch.set_rng_state(state["torch"])

    def close(self) -> None:
        """Ends its environments."""
        self.envs.close()


class _Told(BaseCallback):
    """Says which part of an epoch is done."""

    def __init__(self, live: Live, steps: int) -> None:
        super().__init__()
        self._live, self._steps = live, steps

    def _on_training_start(self) -> None:
        self._first = self.num_timesteps

    def _on_step(self) -> bool:
        self._live((self.num_timesteps - self._first) / self._steps)
        return True


def load_policy(algo: str, path: Path) -> BaseAlgorithm:
    """A model that acts; it gets no experience, and so needs no memory or environments for it."""
    without: dict[str, Any] = {
        "buffer_size": 1,
        "replay_buffer_class": None,
        "replay_buffer_kwargs": {},
    }
    return CLASSES[algo].load(path, device="cpu", custom_objects=without)


def make_model(config: Config, envs: TrocarVecEnv, seed: int) -> BaseAlgorithm:
    """The untrained model of a configuration."""
    extractor = {
        "inputs": Inputs.of(envs.envs.task_spec, config.words),
        "eps": config.norm_eps,
        "clip": config.norm_clip,
    }
    policy_kwargs: dict[str, Any] = {
        "features_extractor_class": Normalised,
        "features_extractor_kwargs": extractor,
        "net_arch": list(config.hidden),
        "share_features_extractor": True,
    }
    has_goals = envs.envs.task_spec.goal is not None
    latest = "MultiInputPolicy" if has_goals else "MlpPolicy"
    common: dict[str, Any] = {
        "policy": AveragedPolicy if config.averaged else latest,
        "env": envs,
        "learning_rate": config.learning_rate,
        "gamma": config.gamma,
        "batch_size": config.batch_size,
        "policy_kwargs": policy_kwargs,
        "seed": seed,
        "device": "cpu",
    }
    if config.algo == "ppo":
        model: BaseAlgorithm = NormalisedPPO(
            n_steps=config.train_every,
            n_epochs=config.passes,
            gae_lambda=config.gae_lambda,
            clip_range=config.clip_range,
            **common,
        )
    else:
        actions = len(envs.envs.task_spec.action)
        common |= {
            # No more than the run has; Stable-Baselines3 takes memory for all of it.
            "buffer_size": min(config.buffer_size, config.epochs * config.epoch_steps),
            "learning_starts": config.learning_starts,
            "train_freq": config.train_every,
            "gradient_steps": config.updates,
            "tau": config.tau,
            "action_noise": NormalActionNoise(np.zeros(actions), np.full(actions, config.noise)),
        }
        if config.algo == "ddpg":
            model = NormalisedDDPG(**common)
        else:
            model = GoalDDPG(
                replay_buffer_class=HerReplayBuffer,
                replay_buffer_kwargs={
                    "n_sampled_goal": config.goals,
                    "goal_selection_strategy": "future",
                },
                random_actions=config.random_actions,
                action_l2=config.action_l2,
                demo_batch=config.demo_batch,
                policy_weight=config.policy_weight,
                clone_weight=config.clone_weight,
                q_filter=config.q_filter,
                **common,
            )
    envs.seed(SEEDS_APART * (seed + 1))
    return model
