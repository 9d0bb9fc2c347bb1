"""Trains DDPG with hindsight experience replay on NeedleReach, from the sparse reward alone.

Eight environments fill one replay buffer. After every 20 episodes the policy is scored on 50
others; the best is saved, and in the end scored on 200 with fresh seeds. It writes OUT.zip (the
policy) and OUT.png (the learning curve).

    pip install trocar[sb3] matplotlib
    python her_needle_reach.py --out her_needle_reach
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import torch
from stable_baselines3 import DDPG, HerReplayBuffer
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.noise import NormalActionNoise

import trocar
from trocar.sb3 import TrocarVecEnv, make_vec

TASK = "trocar/NeedleReach-v0"
STEPS = 50  # of an episode
ROUND = 20 * STEPS  # steps between two scores
EPISODES = 50  # of a score
FINAL_EPISODES = 200
OBSERVATION = ("scaled",)  # metres around 0.05 are too small for networks
SCORE_SEED = 1_000_000  # far from the seeds that training uses
FINAL_SEED = 2_000_000


def success_rate(model: BaseAlgorithm, envs: TrocarVecEnv, seed: int) -> float:
    """Which part of the episodes of ``seed, seed + 1, …`` ends in success, without noise."""
    envs.seed(seed)
    observations = envs.reset()
    for _ in range(STEPS):
        actions, _ = model.predict(observations, deterministic=True)
        observations, _, dones, infos = envs.step(actions)
    assert dones.all()
    return float(np.mean([info["is_success"] for info in infos]))


class Rounds(BaseCallback):
    """Scores the policy after every round, prints a line, and saves the best."""

    def __init__(self, envs: TrocarVecEnv, path: Path) -> None:
        super().__init__()
        self.envs, self.path = envs, path
        self.curve: list[tuple[int, float]] = []
        self.started = time.monotonic()

    def _on_training_start(self) -> None:
        self._score()

    def _on_step(self) -> bool:
        if self.num_timesteps // ROUND > len(self.curve) - 1:
            self._score()
        return True

    def _score(self) -> None:
        success = success_rate(self.model, self.envs, SCORE_SEED)
        if success >= max((best for _, best in self.curve), default=0.0):
            self.model.save(self.path)
        self.curve.append((self.num_timesteps, success))
        print(
            f"{self.num_timesteps:6} of {self.locals['total_timesteps']} steps  "
            f"success {success:6.1%}  {time.monotonic() - self.started:4.0f} s",
            flush=True,
        )


def plot(curve: list[tuple[int, float]], title: str, path: Path) -> None:
    """The learning curve as a picture."""
    mpl.use("Agg")
    figure, axes = plt.subplots(figsize=(6.4, 3.6), dpi=100, layout="constrained")
    axes.plot([steps for steps, _ in curve], [100 * rate for _, rate in curve], marker=".")
    axes.axhline(95, color="grey", linewidth=0.8, linestyle="--")
    axes.set(xlabel="environment steps", ylabel=f"success, % of {EPISODES} episodes", title=title)
    axes.set_ylim(-2, 102)
    axes.grid(alpha=0.3)
    figure.savefig(path)
    plt.close(figure)


def cpu_seconds(pid: int) -> float:
    """What a process has used of the processors so far, s."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def main() -> None:
    """Trains, scores, and says what it took."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--steps", type=int, default=12 * ROUND, help="environment steps")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("her_needle_reach"), help="without suffix")
    arguments = parser.parse_args()
    model_path, picture = (arguments.out.with_suffix(suffix) for suffix in (".zip", ".png"))

    torch.set_num_threads(1)  # the networks are too small for more
    started, started_cpu = time.monotonic(), time.process_time()
    with trocar.Server() as server:
        options: dict[str, Any] = {"server": server.name, "observation": OBSERVATION}
        envs = make_vec(TASK, num_envs=8, **options)
        evaluation = make_vec(TASK, num_envs=EPISODES, **options)
        model = DDPG(
            "MultiInputPolicy",
            envs,
            seed=arguments.seed,
            learning_starts=ROUND,
            train_freq=1,  # that is one step of each environment
            gradient_steps=4,
            batch_size=256,
            gamma=0.95,
            tau=0.02,
            action_noise=NormalActionNoise(np.zeros(5), np.full(5, 0.3)),
            replay_buffer_class=HerReplayBuffer,
            replay_buffer_kwargs={"n_sampled_goal": 4, "goal_selection_strategy": "future"},
            buffer_size=100_000,
            policy_kwargs={"net_arch": [64, 64]},
        )
        rounds = Rounds(evaluation, model_path)
        model.learn(arguments.steps, callback=rounds)
        envs.close()
        evaluation.close()

        final = make_vec(TASK, num_envs=FINAL_EPISODES, **options)
        success = success_rate(DDPG.load(model_path, env=final), final, FINAL_SEED)
        assert server.pid is not None
        simulating, training = cpu_seconds(server.pid), time.process_time() - started_cpu
        final.close()
    wall = time.monotonic() - started

    title = f"NeedleReach, DDPG + HER: {success:.1%} of {FINAL_EPISODES} fresh seeds"
    plot(rounds.curve, title, picture)
    print(f"{title}, {wall:.0f} s")
    print(
        f"CPU: trainer {training:.0f} s, server {simulating:.1f} s "
        f"({simulating / (simulating + training):.0%} of both)"
    )
    print(f"wrote {model_path} and {picture}")


if __name__ == "__main__":
    main()
