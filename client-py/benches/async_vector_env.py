"""Steps per second of 64 environments: Trocar's session against Gymnasium's AsyncVectorEnv.

`make bench-async` builds what this needs and runs it. Two ways to step the same environments:

* ``async``: ``gymnasium.vector.AsyncVectorEnv(shared_memory=True)``, a worker process for each
  environment. Each worker holds a simulation of its own and calls it directly, through the C
  library ``server/examples/in_process.rs``; no server and no socket are in between.
* ``session``: ``trocar.TrocarVectorEnv``, one session of one server, stepped by one message.

Both use all cores, random actions from one pool, next-step autoreset and the same task options.
They are measured in turns; the ratio is the median over the pairs.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import statistics
import sys
import time
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np

import trocar

POOL = 64
"""Random actions are drawn before they are needed, for so many steps."""


class Seen(ctypes.Structure):
    """Where the library writes what is seen."""

    _fields_ = [(name, ctypes.c_void_p) for name in ("observation", "achieved", "desired")]


class InProcess(gym.Env[dict[str, np.ndarray], np.ndarray]):
    """One environment of a task, simulated in this process."""

    def __init__(
        self, library: str, task: str, spaces: tuple[gym.Space[Any], gym.Space[Any]]
    ) -> None:
        """Loads the library and makes the environment; spaces are those of the session."""
        self.action_space, self.observation_space = spaces
        self._library = ctypes.CDLL(library)
        self._library.trocar_make.restype = ctypes.c_void_p
        self._library.trocar_step.restype = ctypes.c_bool
        made = self._library.trocar_make(task.encode())
        if made is None:
            raise ValueError(f"no task {task}")
        self._env = ctypes.c_void_p(made)
        dims = (ctypes.c_uint32 * 3)()
        self._library.trocar_dims(self._env, dims)
        _, observation, goal = dims
        names = ("observation", "achieved_goal", "desired_goal")
        self._state = {
            name: np.zeros(dim, np.float32)
            for name, dim in zip(names, (observation, goal, goal), strict=True)
        }
        self._seen = Seen(*(array.ctypes.data for array in self._state.values()))
        self._outcome = np.zeros(4, np.float32)
        self._outcome_pointer = ctypes.c_void_p(self._outcome.ctypes.data)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Begins the first episode of ``seed``, or the next one."""
        super().reset(seed=seed, options=options)
        self._library.trocar_reset(
            self._env, ctypes.c_int64(-1 if seed is None else seed), self._seen
        )
        return self._state, {}

    def step(
        self, action: np.ndarray
    ) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Acts. The arrays are written again by the next step; Gymnasium's worker copies them."""
        pointer = ctypes.c_void_p(action.ctypes.data)
        if not self._library.trocar_step(self._env, pointer, self._seen, self._outcome_pointer):
            raise RuntimeError("the step was refused, or the simulation failed")
        reward, terminated, truncated, success = self._outcome
        info = {"is_success": bool(success)}
        return self._state, float(reward), bool(terminated), bool(truncated), info

    def close(self) -> None:
        """Ends the environment."""
        self._library.trocar_free(self._env)


def rate(envs: gym.vector.VectorEnv[Any, Any, Any], pool: np.ndarray, seconds: float) -> float:
    """Environment steps per second."""
    rounds, start = 0, time.perf_counter()
    while (elapsed := time.perf_counter() - start) < seconds:
        for actions in pool:
            envs.step(actions)
        rounds += len(pool)
    return rounds * envs.num_envs / elapsed


def compare(task: str, arguments: argparse.Namespace) -> dict[str, Any]:
    """Measures both in turns."""
    session = trocar.TrocarVectorEnv(task, arguments.envs, server=arguments.server)
    spaces = (session.single_action_space, session.single_observation_space)

    def make() -> InProcess:
        return InProcess(arguments.library, task, spaces)

    made: list[Callable[[], gym.Env[Any, Any]]] = [make] * arguments.envs
    workers = gym.vector.AsyncVectorEnv(made, shared_memory=True)
    shape = (POOL, *(session.action_space.shape or ()))
    pool = np.random.default_rng(0).uniform(-1, 1, shape).astype(np.float32)
    both = {"async": workers, "session": session}
    rates: dict[str, list[float]] = {name: [] for name in both}
    for envs in both.values():
        envs.reset(seed=0)
        rate(envs, pool, arguments.seconds / 4)
    for _ in range(arguments.pairs):
        for name, envs in both.items():
            rates[name].append(rate(envs, pool, arguments.seconds))
    workers.close()
    session.close()
    ratios = sorted(
        mine / theirs for mine, theirs in zip(rates["session"], rates["async"], strict=True)
    )
    return {
        "task": task,
        "envs": arguments.envs,
        "pairs": arguments.pairs,
        "async_steps_per_second": statistics.median(rates["async"]),
        "session_steps_per_second": statistics.median(rates["session"]),
        "ratio": statistics.median(ratios),
        "ratio_min": ratios[0],
        "ratio_max": ratios[-1],
    }


def main() -> None:
    """Compares and prints a table, or with ``--json`` one object a line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--library", required=True, help="libin_process.so, as an absolute path")
    parser.add_argument("--server", help="name of a server; a private one if none is named")
    parser.add_argument("--task", nargs="+", default=["EcmReach-v0", "NeedlePick-v0"])
    parser.add_argument("--envs", type=int, default=64)
    parser.add_argument("--pairs", type=int, default=10)
    parser.add_argument("--seconds", type=float, default=2.0, help="of each measurement")
    parser.add_argument("--json", action="store_true", help="one JSON object per task, on stdout")
    arguments = parser.parse_args()
    for task in arguments.task:
        found = compare(task, arguments)
        if arguments.json:
            print(json.dumps(found), flush=True)
        line = (
            "{task}, {envs} environments: async {async_steps_per_second:.0f} steps/s, "
            "session {session_steps_per_second:.0f} steps/s, "
            "ratio {ratio:.2f} [{ratio_min:.2f}, {ratio_max:.2f}] over {pairs} pairs"
        )
        print(line.format(**found), file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
