"""Vector environments of worker processes, by Stable-Baselines3 and by Gymnasium.

Every worker opens an environment of its own; all share the private server of this program, which
ends with it. One session of many environments is faster: see her_needle_reach.py.

    pip install trocar[sb3]
    python worker_processes.py
"""

from __future__ import annotations

import argparse
from functools import partial

import gymnasium as gym
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import SubprocVecEnv

import trocar

TASK = "trocar/EcmReach-v0"
WORKERS = 4


def main() -> None:
    """Trains a little in SB3's workers, then acts at random in Gymnasium's."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--steps", type=int, default=10_000, help="environment steps to train")
    steps = parser.parse_args().steps

    options = {"reward": "dense", "render_mode": None}
    envs = make_vec_env(TASK, WORKERS, seed=0, env_kwargs=options, vec_env_cls=SubprocVecEnv)
    PPO("MultiInputPolicy", envs, n_steps=256, verbose=1, seed=0).learn(steps)
    print(f"Stable-Baselines3: {len(trocar.status()['sessions'])} sessions of one server")
    envs.close()

    make = partial(gym.make, TASK)
    workers = gym.vector.AsyncVectorEnv([make] * WORKERS)
    workers.reset(seed=0)
    for _ in range(100):
        workers.step(workers.action_space.sample())
    print(f"Gymnasium: {len(trocar.status()['sessions'])} sessions of one server")
    workers.close()


if __name__ == "__main__":
    main()
