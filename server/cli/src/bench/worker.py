"""The Python client of ``trocar bench``: a line of JSON asks for a measurement, one answers."""

import json
import sys
import time
from collections.abc import Callable
from typing import Any


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
    for seed in range(0, job["beginnings"], job["envs"]):
        reset(seed)
    end = time.perf_counter() + job["seconds"] * job["warm_up"]
    while time.perf_counter() < end:
        step()
    reset(0)
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


Made = tuple[Callable[[], None], Callable[[int], None], int, Callable[[], None]]


def random_actions(job: dict[str, Any], shape: tuple[int, ...] | None) -> Any:
    """The actions that the others take: (rounds, *shape); ``None`` where the expert acts."""
    import numpy as np

    if job["actions"] is None:
        return None
    return np.fromfile(job["actions"], np.float32).reshape(-1, *(shape or ()))


def single(job: dict[str, Any], server: str) -> Made:
    """One environment, as most programs have it: without the time limit's wrapper."""
    import trocar

    env = trocar.TrocarEnv(job["task"], server=server, expert=job["expert"], **job["options"])
    pool = random_actions(job, env.action_space.shape)
    count = 0

    def step() -> None:
        nonlocal count
        action = env.expert_action() if pool is None else pool[count % len(pool)]
        count += 1
        _, _, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            env.reset()

    def reset(seed: int) -> None:
        nonlocal count
        count = 0
        env.reset(seed=seed)

    return step, reset, env.task_spec.max_steps, env.close


def vector(job: dict[str, Any], server: str) -> Made:
    """Many environments, which begin new episodes in the same step."""
    import trocar

    envs = trocar.TrocarVectorEnv(
        job["task"],
        job["envs"],
        server=server,
        autoreset_mode="same_step",
        expert=job["expert"],
        **job["options"],
    )
    pool = random_actions(job, envs.action_space.shape)
    count = 0
    infos: dict[str, Any] = {}

    def step() -> None:
        nonlocal count, infos
        actions = infos["expert_action"] if pool is None else pool[count % len(pool)]
        count += 1
        *_, infos = envs.step(actions)

    def reset(seed: int) -> None:
        nonlocal count, infos
        count = 0
        _, infos = envs.reset(seed=seed)

    return step, reset, envs.task_spec.max_steps, envs.close


def say(**what: Any) -> None:
    """Prints a line of JSON."""
    print(json.dumps(what), flush=True)


if __name__ == "__main__":
    main()
