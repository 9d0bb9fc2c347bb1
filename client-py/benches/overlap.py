"""What it brings to compute one group's actions while the other is simulated.

    python client-py/benches/overlap.py [--task NeedleReach-v0] [--envs 64] [--pairs 10]

A policy network of NumPy matrices is run as often a step as makes it as slow as the simulation of
its group. Then the same number of steps is done in two ways, in turns:

* blocking: for each half of the environments, compute actions, ``send``, ``recv``;
* overlapped: two groups in flight, so that one is simulated while the other's actions are computed.

With perfect overlap the ratio of the times is 0.5. It takes two free cores: one for the server, one
for this program, which is best told so:

    trocar serve --name overlap --cpus 1 --threads 1
    OPENBLAS_NUM_THREADS=1 taskset -c 0 python client-py/benches/overlap.py --server overlap

Where steps that touch objects take several times as long as others, as in NeedlePick, the halves
are seldom equally long, and the ratio tells less.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import time
from typing import Any

import numpy as np

import trocar


class Trainer:
    """Two groups of environments, and a policy that takes its time."""

    def __init__(self, task: str, envs: int, server: str | None) -> None:
        """Opens the session and finds out how often the network must run to be as slow."""
        self.envs = trocar.TrocarVectorEnv(task, envs, server=server, autoreset_mode="same_step")
        ids = np.arange(envs)
        self.groups = (ids[: envs // 2], ids[envs // 2 :])
        self.dim = self.envs.single_action_space.shape[0]  # type: ignore[index]
        rng = np.random.default_rng(0)
        state, _ = self.envs.reset(seed=0)
        self.seen = [self._flat(state)[group] for group in self.groups]
        width = self.seen[0].shape[1]
        self.layers = [rng.normal(0, 0.3, (width, 64)), rng.normal(0, 0.3, (64, self.dim))]
        self.passes = 1
        for _ in range(50):
            self._blocking(0)
        simulated = 0.0
        for _ in range(100):
            actions = self._infer(0)
            start = time.perf_counter()
            self._simulate(0, actions)
            simulated += time.perf_counter() - start
        start = time.perf_counter()
        for _ in range(100):
            self._infer(0)
        self.passes = max(1, round(simulated / (time.perf_counter() - start)))

    def blocking(self, steps: int) -> None:
        """Steps both groups, one after the other."""
        for _ in range(steps):
            self._blocking(0)
            self._blocking(1)

    def overlapped(self, steps: int) -> None:
        """Steps both groups, each while the other's actions are computed."""
        self.envs.send(self._infer(0), self.groups[0])
        for _ in range(steps - 1):
            for group, other in ((1, 0), (0, 1)):
                self.envs.send(self._infer(group), self.groups[group])
                self._see(other)
        self.envs.send(self._infer(1), self.groups[1])
        self._see(0)
        self._see(1)

    def _blocking(self, group: int) -> None:
        self._simulate(group, self._infer(group))

    def _simulate(self, group: int, actions: Any) -> None:
        self.envs.send(actions, self.groups[group])
        self._see(group)

    def _see(self, group: int) -> None:
        state, *_ = self.envs.recv()
        self.seen[group] = self._flat(state)

    def _infer(self, group: int) -> Any:
        for _ in range(self.passes):
            actions = np.tanh(np.tanh(self.seen[group] @ self.layers[0]) @ self.layers[1])
        return actions.astype(np.float32)

    @staticmethod
    def _flat(state: Any) -> Any:
        if isinstance(state, dict):
            return np.concatenate([state[name] for name in sorted(state)], axis=1)
        return state


def main() -> None:
    """Measures both ways in turns and prints the ratio of their times."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--server", help="name of a server; a private one if none is named")
    parser.add_argument("--task", default="NeedleReach-v0")
    parser.add_argument("--envs", type=int, default=64)
    parser.add_argument("--pairs", type=int, default=10)
    parser.add_argument("--steps", type=int, default=500, help="of each measurement")
    parser.add_argument("--json", action="store_true", help="one JSON object, on stdout")
    arguments = parser.parse_args()
    trainer = Trainer(arguments.task, arguments.envs, arguments.server)
    times: dict[str, list[float]] = {"blocking": [], "overlapped": []}
    for _ in range(arguments.pairs):
        for name, way in (("blocking", trainer.blocking), ("overlapped", trainer.overlapped)):
            start = time.perf_counter()
            way(arguments.steps)
            times[name].append(time.perf_counter() - start)
    trainer.envs.close()
    ratios = sorted(b / a for a, b in zip(times["blocking"], times["overlapped"], strict=True))
    found = {
        "task": arguments.task,
        "envs": arguments.envs,
        "blocking_seconds": statistics.median(times["blocking"]),
        "overlapped_seconds": statistics.median(times["overlapped"]),
        "ratio": statistics.median(ratios),
        "ratio_min": ratios[0],
        "ratio_max": ratios[-1],
    }
    if arguments.json:
        print(json.dumps(found))
    line = "overlapped / blocking time: {ratio:.2f} [{ratio_min:.2f}, {ratio_max:.2f}]"
    print(line.format(**found), file=sys.stderr)


if __name__ == "__main__":
    main()
