"""The Python client of ``make demo``; ``client.rs`` is its twin.

It says when it is ready, begins at a line on stdin, lets the scripted expert act in many
environments of a server, and reports its counts as JSON lines.
"""

import argparse
import json
import sys
import time

import gymnasium as gym
import numpy as np

import trocar  # noqa: F401 (registers the ids)

INTERVAL = 0.2
"""How often it reports, s."""


def main() -> None:
    """Works for the time that was asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--server", required=True, help="the server to connect to")
    parser.add_argument("--task", required=True, help="task id without namespace")
    parser.add_argument("--envs", type=int, required=True, help="how many environments")
    parser.add_argument("--seed", type=int, required=True, help="environment i has seed SEED + i")
    parser.add_argument("--seconds", type=float, required=True, help="how long to work")
    args = parser.parse_args()

    envs = gym.make_vec(f"trocar/{args.task}", num_envs=args.envs, server=args.server, expert=True)
    _, infos = envs.reset(seed=args.seed)
    report(done=False, seconds=0.0, episodes=0, successes=0, steps=0, latencies=[])
    sys.stdin.readline()

    episodes = successes = steps = 0
    ended = np.zeros(args.envs, np.bool_)
    latencies: list[float] = []
    start = reported = time.perf_counter()
    seconds = 0.0
    # Until the time is over, and at least one episode of each environment.
    while seconds < args.seconds or episodes < args.envs:
        sent = time.perf_counter()
        _, _, terminations, truncations, infos = envs.step(infos["expert_action"])
        now = time.perf_counter()
        latencies.append(now - sent)
        # Where an episode ended before, the step was the reset that follows it.
        steps += int((~ended).sum())
        ended = terminations | truncations
        episodes += int(ended.sum())
        successes += int((infos["is_success"] & ended).sum())
        seconds = now - start
        if now - reported > INTERVAL:
            reported = now
            report(False, seconds, episodes, successes, steps, latencies)
    report(True, seconds, episodes, successes, steps, latencies)
    envs.close()


def report(
    done: bool, seconds: float, episodes: int, successes: int, steps: int, latencies: list[float]
) -> None:
    """Prints the counts since the beginning."""
    p50_us = 1e6 * float(np.median(latencies)) if latencies else 0.0
    progress = {
        "done": done,
        "seconds": seconds,
        "episodes": episodes,
        "successes": successes,
        "steps": steps,
        "p50_us": p50_us,
    }
    print(json.dumps(progress), flush=True)


if __name__ == "__main__":
    main()
