"""Steps per second of 64 environments: Trocar's session against Gymnasium's AsyncVectorEnv.

`make bench-async` builds what this needs and runs it. Two ways to step the same environments:

* ``async``: ``gymnasium.vector.AsyncVectorEnv(shared_memory=True)``, a worker process for each
  environment. Each worker holds a simulation of its own and calls it directly, through the C
  library ``server/examples/in_process.rs``; no server and no socket are in between.
* ``session``: ``trocar.TrocarVectorEnv``, one session of one server, stepped by one message.

Both use all cores, random actions from one pool, next-step autoreset and the same task options.
They are measured in turns; ratios are medians over the pairs. Beside the wall clock stands the CPU
time of all processes that take part. On a machine with other work, 64 workers get a larger share
of the cores than one server does. Then only steps per CPU second can be compared.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import os
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

import trocar
from trocar import _connection

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


class Rate(NamedTuple):
    """Environment steps per second of wall time, and of CPU time."""

    wall: float
    cpu: float


def cpu_seconds(pids: list[int]) -> float:
    """CPU time of some processes with all of their threads."""
    ticks = 0
    for pid in pids:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        ticks += int(fields[11]) + int(fields[12])
    return ticks / os.sysconf("SC_CLK_TCK")


def measure(
    envs: gym.vector.VectorEnv[Any, Any, Any], pids: list[int], pool: np.ndarray, seconds: float
) -> Rate:
    """Steps for so long; ``pids`` are the processes that take part."""
    rounds, start, cpu = 0, time.perf_counter(), cpu_seconds(pids)
    while (elapsed := time.perf_counter() - start) < seconds:
        for actions in pool:
            envs.step(actions)
        rounds += len(pool)
    steps = rounds * envs.num_envs
    return Rate(steps / elapsed, steps / (cpu_seconds(pids) - cpu))


def compare(task: str, arguments: argparse.Namespace) -> dict[str, Any]:
    """Measures both in turns."""
    session = trocar.TrocarVectorEnv(task, arguments.envs, server=arguments.server)
    spaces = (session.single_action_space, session.single_observation_space)

    def make() -> InProcess:
        return InProcess(arguments.simulation, task, spaces)

    made: list[Callable[[], gym.Env[Any, Any]]] = [make] * arguments.envs
    workers = gym.vector.AsyncVectorEnv(made, shared_memory=True)
    shape = (POOL, *(session.action_space.shape or ()))
    pool = np.random.default_rng(0).uniform(-1, 1, shape).astype(np.float32)
    here, server = os.getpid(), _connection.connect(arguments.server).pid
    both: dict[str, tuple[gym.vector.VectorEnv[Any, Any, Any], list[int]]] = {
        "async": (workers, [here, *(process.pid or 0 for process in workers.processes)]),
        "session": (session, [here, server]),
    }
    rates: dict[str, list[Rate]] = {name: [] for name in both}
    for envs, pids in both.values():
        envs.reset(seed=0)
        measure(envs, pids, pool, arguments.seconds / 4)
    for _ in range(arguments.pairs):
        for name, (envs, pids) in both.items():
            rates[name].append(measure(envs, pids, pool, arguments.seconds))
    workers.close()
    session.close()
    found: dict[str, Any] = {"task": task, "envs": arguments.envs, "pairs": arguments.pairs}
    for clock in Rate._fields:
        ratios = []
        for mine, theirs in zip(rates["session"], rates["async"], strict=True):
            ratios.append(getattr(mine, clock) / getattr(theirs, clock))
        for name, several in rates.items():
            found[f"{name}_{clock}"] = statistics.median(getattr(rate, clock) for rate in several)
        found |= {f"ratio_{clock}": statistics.median(ratios), f"spread_{clock}": sorted(ratios)}
    return found


def main() -> None:
    """Compares and prints a table, or with ``--json`` one object a line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--simulation", required=True, help="libin_process.so, as an absolute path")
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
        for clock in Rate._fields:
            low, *_, high = found[f"spread_{clock}"]
            theirs, mine = found[f"async_{clock}"], found[f"session_{clock}"]
            line = (
                f"{task:<15} {arguments.envs} envs, steps per {clock} second: "
                f"async {theirs:.0f}, session {mine:.0f}, "
                f"ratio {found[f'ratio_{clock}']:.2f} [{low:.2f}, {high:.2f}]"
            )
            print(line, file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
