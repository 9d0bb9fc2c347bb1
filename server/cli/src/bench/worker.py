"""The Python client of ``trocar bench``: a line of JSON asks for a measurement, one answers."""

import json
import sys
import time
from collections.abc import Callable
from typing import Any

POOL = 65_536
"""Random actions are drawn before they are needed: so many of single environments, then again."""


def main() -> None:
    """Measures whatever is asked for, until stdin ends."""
    try:
        import trocar  # noqa: F401
    except ImportError as error:
        say(error=str(error))
        return
    say(ready=True)
    for line in sys.stdin:
        measure(json.loads(line), sys.argv[1])


def measure(job: dict[str, Any], server: str) -> None:
    """Makes the environments, warms up, waits for a line, runs whole episodes, tells the steps."""
    one = job["envs"] == 1
    step, reset, max_steps, close = (single if one else vector)(job, server)
    reset()
    end = time.perf_counter() + job["seconds"] * job["warm_up"]
    while time.perf_counter() < end:
        step()
    reset()
    say(ready=True)
    sys.stdin.readline()
    rounds = 0
    end = time.perf_counter() + job["seconds"]
    while True:
        for _ in range(max_steps):
            step()
        rounds += max_steps
        if time.perf_counter() >= end:
            break
    say(steps=rounds * job["envs"])
    close()


Made = tuple[Callable[[], None], Callable[[], None], int, Callable[[], None]]


def single(job: dict[str, Any], server: str) -> Made:
    """One environment, as most programs have it: without the time limit's wrapper."""
    import numpy as np

    import trocar

    env = trocar.TrocarEnv(job["task"], server=server, expert=job["expert"], **job["options"])
    shape = (POOL, *(env.action_space.shape or ()))
    pool = np.random.default_rng(0).uniform(-1, 1, shape).astype(np.float32)
    count = 0

    def step() -> None:
        nonlocal count
        count += 1
        action = env.expert_action() if job["expert"] else pool[count % len(pool)]
        _, _, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            env.reset()

    def reset() -> None:
        env.reset(seed=0)

    return step, reset, env.task_spec.max_steps, env.close


def vector(job: dict[str, Any], server: str) -> Made:
    """Many environments, which begin new episodes in the same step."""
    import numpy as np

    import trocar

    envs = trocar.TrocarVectorEnv(
        job["task"],
        job["envs"],
        server=server,
        autoreset_mode="same_step",
        expert=job["expert"],
        **job["options"],
    )
    shape = (max(64, POOL // job["envs"]), *(envs.action_space.shape or ()))
    pool = np.random.default_rng(0).uniform(-1, 1, shape).astype(np.float32)
    count = 0
    infos: dict[str, Any] = {}

    def step() -> None:
        nonlocal count, infos
        count += 1
        actions = infos["expert_action"] if job["expert"] else pool[count % len(pool)]
        *_, infos = envs.step(actions)

    def reset() -> None:
        nonlocal infos
        _, infos = envs.reset(seed=0)

    return step, reset, envs.task_spec.max_steps, envs.close


def say(**what: Any) -> None:
    """Prints a line of JSON."""
    print(json.dumps(what), flush=True)


if __name__ == "__main__":
    main()
