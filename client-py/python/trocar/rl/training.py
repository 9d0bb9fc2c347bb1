"""Training runs: epochs, evaluations, checkpoints, logs."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3 import HerReplayBuffer
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.noise import NormalActionNoise
from torch.utils.tensorboard import SummaryWriter

import trocar
from trocar._trocar import Client
from trocar.rl import demonstrations
from trocar.rl.algorithms import AveragedPolicy, GoalDDPG, NormalisedDDPG, NormalisedPPO
from trocar.rl.config import Config
from trocar.rl.curriculum import CurriculumVecEnv
from trocar.rl.curves import plot_run
from trocar.rl.evaluation import SEED, Score, score
from trocar.rl.normalise import Normalised
from trocar.rl.runs import Run
from trocar.sb3 import TrocarVecEnv, make_vec

SEEDS_APART = 10_000
"""Between the seeds of the environments of two runs: their episodes are not the same."""

Row = dict[str, float]


def train(
    config: Config,
    seed: int,
    *,
    out: str | os.PathLike[str] = "runs",
    resume: bool = False,
    demos: str | os.PathLike[str] | None = None,
    server: str | None = None,
    threads: int = 1,
    say: Callable[[str], None] = lambda line: print(line, file=sys.stderr, flush=True),
) -> Run:
    """Trains, and writes everything to ``out/TASK/ALGO/seed-SEED``.

    With one thread, the same configuration and seed give the same curve, interrupted or not.

    Args:
        config: What is trained.
        seed: Of networks, exploration and environments.
        out: Folder of runs.
        resume: Whether to go on with a run that is there already.
        demos: Folder of a Minari data set to learn from; recorded in ``out/demos`` if ``None``.
        server: Name of the server; one of its own if ``None``.
        threads: Of PyTorch; small networks need no more than one.
        say: Takes lines for people.

    Raises:
        ValueError: A run is there already, or the demonstrations are not for this.
    """
    run = Run(Path(out) / config.task / config.algo / f"seed-{seed}")
    run.begin(config, resume)
    torch.set_num_threads(threads)
    with _served(server) as (name, server_pid):
        shown = None
        if config.demos:
            folder = demos or demonstrations.made(config, Path(out) / "demos", name)
            shown = demonstrations.opened(Path(folder), config)
        envs = make_vec(config.task_id, config.envs, server=name, **config.task_options)
        evaluation = make_vec(
            config.task_id, config.eval_episodes, server=name, **config.task_options
        )
        try:
            if shown is not None and config.curriculum:
                envs = CurriculumVecEnv(envs.envs, shown, config)
            if run.has_checkpoint:
                model, rows = run.restore(envs)
            else:
                model, rows = make_model(config, envs, seed), []
            model.set_logger(Logger(None, []))
            if isinstance(model, GoalDDPG) and shown is not None:
                _learn_from(model, demonstrations.buffer(shown, config, envs), not rows)
            _epochs(run, config, model, envs, evaluation, rows, server_pid, say)
        finally:
            envs.close()
            evaluation.close()
    plot_run(run, run.path / "curve.png")
    return run


def make_model(config: Config, envs: TrocarVecEnv, seed: int) -> BaseAlgorithm:
    """The untrained model of a configuration."""
    extractor = {"inputs": config.inputs, "eps": config.norm_eps, "clip": config.norm_clip}
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


def _learn_from(model: GoalDDPG, demos: HerReplayBuffer, is_new: bool) -> None:
    """Gives a model its demonstrations; in one that goes on, they were counted already."""
    if is_new:
        model.learn_from(demos)
    else:
        model.demos = demos


def _epochs(
    run: Run,
    config: Config,
    model: BaseAlgorithm,
    envs: TrocarVecEnv,
    evaluation: TrocarVecEnv,
    rows: list[Row],
    server_pid: int,
    say: Callable[[str], None],
) -> None:
    """Trains the epochs that are left; each ends with an evaluation and a checkpoint."""
    clock = _Clock(server_pid, rows[-1] if rows else {})
    best = max((_worth(row) for row in rows), default=(-1.0, -np.inf))
    writer = SummaryWriter(str(run.path / "tensorboard"), purge_step=model.num_timesteps + 1)
    if not rows:
        rows.append(_row(0, config, model, score(model, evaluation, SEED), clock))
        _note(run, rows, writer)
    for epoch in range(len(rows), config.epochs + 1):
        # What it logs is read after each epoch instead.
        model.learn(config.epoch_steps, reset_num_timesteps=False, log_interval=sys.maxsize)
        row = _row(epoch, config, model, score(model, evaluation, SEED), clock)
        rows.append(row)
        model.save(run.path / "last.zip")
        if _worth(row) >= best:
            best = _worth(row)
            model.save(run.path / "best.zip")
        run.save(model, envs, rows)
        _note(run, rows, writer)
        left = (clock.wall() / epoch) * (config.epochs - epoch)
        say(
            f"{config.task} {config.algo}  epoch {epoch:3} of {config.epochs}  "
            f"success {row['success']:6.1%}  return {row['mean_return']:8.2f}  "
            f"{clock.wall():6.0f} s, {left:6.0f} s left"
        )
    writer.close()


def _worth(row: Row) -> tuple[float, float]:
    """What makes a policy better than another."""
    return row["success"], row["mean_return"]


def _row(epoch: int, config: Config, model: BaseAlgorithm, result: Score, clock: _Clock) -> Row:
    told: dict[str, Any] = model.logger.name_to_value
    # PPO has other names for the same.
    losses = {"actor_loss": "policy_gradient_loss", "critic_loss": "value_loss"}
    row: Row = {
        "epoch": epoch,
        "episodes": epoch * config.epoch_episodes,
        "steps": model.num_timesteps,
        "updates": model._n_updates,
        "success": result.success_rate,
        "success_ever": result.successes_ever / result.episodes,
        "mean_return": result.mean_return,
        "mean_length": result.mean_length,
        **clock.times(),
    }
    if isinstance(model.env, CurriculumVecEnv):
        row["level"] = model.env.level
    for name in ("actor_loss", "critic_loss", "clone_loss", "passed"):
        for source in (name, losses.get(name)):
            if f"train/{source}" in told:
                row[name] = float(told[f"train/{source}"])
    return row


def _note(run: Run, rows: list[Row], writer: SummaryWriter) -> None:
    """Writes the curve, and its last row for TensorBoard."""
    run.write_rows(rows)
    for name, value in rows[-1].items():
        if name not in ("epoch", "steps"):
            writer.add_scalar(name, value, int(rows[-1]["steps"]))
    writer.flush()


class _Clock:
    """Times of a run, with those that it had taken before it was interrupted."""

    def __init__(self, server_pid: int, before: Row) -> None:
        self._server_pid = server_pid
        now = self._now()
        self._start = {name: now[name] - before.get(name, 0.0) for name in now}

    def times(self) -> Row:
        """Seconds since the start: of the wall's clock, and of processors."""
        return {name: time - self._start[name] for name, time in self._now().items()}

    def wall(self) -> float:
        """Seconds since the start."""
        return self.times()["wall_s"]

    def _now(self) -> Row:
        return {
            "wall_s": time.monotonic(),
            "trainer_cpu_s": time.process_time(),
            "server_cpu_s": cpu_seconds(self._server_pid),
        }


def cpu_seconds(pid: int) -> float:
    """What a process has used of the processors so far, s; 0 where it cannot be seen."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@contextmanager
def _served(name: str | None) -> Iterator[tuple[str, int]]:
    """Name and process of a server: of one that runs, or of one for as long as the block lasts."""
    if name is not None:
        yield name, Client.connect(name).pid
        return
    with trocar.Server() as server:
        assert server.pid is not None
        yield server.name, server.pid
