"""Random actions in many environments at once: ``python random_policy.py --help``."""

from __future__ import annotations

import argparse
import time

import gymnasium as gym

import trocar


def main() -> None:
    """Steps environments for a while, then says how they did."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--task", default="NeedleReach-v0", choices=trocar.registration.TASKS)
    parser.add_argument("--server", help="name of a running server (default: a private one)")
    parser.add_argument("--envs", type=int, default=16)
    parser.add_argument("--steps", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()

    envs = gym.make_vec(
        f"trocar/{arguments.task}", num_envs=arguments.envs, server=arguments.server
    )
    envs.reset(seed=arguments.seed)
    envs.action_space.seed(arguments.seed)
    successes = episodes = 0
    start = time.perf_counter()
    for _ in range(arguments.steps):
        _, _, terminated, truncated, infos = envs.step(envs.action_space.sample())
        ended = terminated | truncated
        episodes += int(ended.sum())
        successes += int(infos["is_success"][ended].sum())
    seconds = time.perf_counter() - start
    envs.close()

    steps = arguments.envs * arguments.steps
    print(f"{arguments.task}: {episodes} episodes, {successes} successes")
    print(f"{steps} steps in {seconds:.2f} s: {steps / seconds:.0f} steps/s")


if __name__ == "__main__":
    main()
