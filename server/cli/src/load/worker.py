"""A Python client of ``trocar load``; ``worker.rs`` is its twin, and says what the reports mean.

Environments of even seeds follow the scripted expert, those of odd seeds draw their actions. What
they show is summed up in a checksum that the parent compares with its own.
"""

import argparse
import contextlib
import ctypes
import json
import os
import signal
import threading
import time
import zlib
from collections import Counter
from typing import Any

import numpy as np

import trocar

INTERVAL = 0.2
"""How often it reports, s."""

PATIENCE = 60.0
"""How long it looks for a server that is being restarted, s."""

PAUSE = 0.01
"""How often it looks, s."""

PR_SET_PDEATHSIG = 1
"""From Linux's ``prctl.h``."""

LOST = (trocar.errors.ServerLost, trocar.errors.NoServer)

told_to_end = threading.Event()


class Work:
    """What a client has at hand while it works."""

    def __init__(self, args: argparse.Namespace) -> None:
        """Nothing is open yet."""
        self.args = args
        self.session = self.rounds = self.steps = self.checksum = 0
        self.latencies: Counter[int] = Counter()
        self.since = time.perf_counter()
        self.begun = False

    def run(self) -> None:
        """Works in one session after the other until it is told to end."""
        lost = time.perf_counter()
        while True:
            session = self.session
            try:
                return self.work()
            except LOST:
                if self.session > session:
                    self.say()
                    lost = time.perf_counter()
                if not self.args.reconnect or time.perf_counter() - lost > PATIENCE:
                    raise
            if told_to_end.is_set():
                return None
            time.sleep(PAUSE)

    def work(self) -> None:
        """Works in one session."""
        args = self.args
        envs = trocar.TrocarVectorEnv(args.task, args.envs, server=args.server, expert=True)
        with contextlib.closing(envs):
            observations, infos = envs.reset(seed=args.seed)
            self.session += 1
            self.rounds = self.checksum = 0
            nobody = np.zeros(args.envs, np.bool_)
            self.see(observations, np.zeros(args.envs, np.float32), nobody, nobody, infos)
            ended = nobody
            if not self.begun:
                self.begun = True
                self.since = time.perf_counter()
                self.say()
                await_the_word()
            seeds = args.seed + np.arange(args.envs)
            draws = first_draws(seeds, infos["expert_action"].shape[1])
            self.since = time.perf_counter()
            while not told_to_end.is_set():
                draws = draws * np.uint32(1664525) + np.uint32(1013904223)
                drawn = (draws >> np.uint32(8)).astype(np.float32) / np.float32(1 << 23) - 1
                odd = (seeds % 2 == 1)[:, None]
                actions = np.where(odd, drawn, infos["expert_action"]).astype(np.float32)
                sent = time.perf_counter_ns()
                observations, rewards, terminations, truncations, infos = envs.step(actions)
                self.latencies[time.perf_counter_ns() - sent] += 1
                self.rounds += 1
                # Where an episode ended before, the step was the reset that follows it.
                self.steps += int((~ended).sum())
                ended = terminations | truncations
                self.see(observations, rewards, terminations, truncations, infos)
                if time.perf_counter() - self.since > INTERVAL:
                    self.say()

    def see(
        self, observations: Any, rewards: Any, terminations: Any, truncations: Any, infos: Any
    ) -> None:
        """Adds what was shown to the checksum."""
        if isinstance(observations, dict):
            names = ("observation", "achieved_goal", "desired_goal")
            arrays = [observations[name] for name in names]
        else:
            arrays = [observations]
        arrays += [rewards, infos["expert_action"], terminations, truncations]
        for array in arrays:
            self.checksum = zlib.crc32(array.tobytes(), self.checksum)

    def say(self, **more: Any) -> None:
        """Says what there is to say, and counts anew."""
        now = time.perf_counter()
        report = {
            "session": self.session,
            "rounds": self.rounds,
            "steps": self.steps,
            "seconds": now - self.since,
            "latencies": list(self.latencies.items()),
            "checksum": self.checksum if self.session else None,
            **more,
        }
        print(json.dumps(report), flush=True)
        self.steps = 0
        self.latencies.clear()
        self.since = now


def first_draws(seeds: Any, dim: int) -> Any:
    """Where the generators of all numbers of the actions begin: (envs, dim)."""
    return ((seeds[:, None] * 2654435761 + np.arange(dim)) % 2**32).astype(np.uint32)


def await_the_word() -> None:
    """Waits for the first line on stdin; from then on its end is the word to end."""
    if not os.read(0, 64):
        told_to_end.set()
        return

    def listen() -> None:
        while os.read(0, 64):
            pass
        told_to_end.set()

    threading.Thread(target=listen, daemon=True).start()


def main() -> None:
    """Says when it is ready, begins at a line on stdin, and ends with stdin."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--server", required=True, help="the server to connect to")
    parser.add_argument("--task", required=True, help="task id without namespace")
    parser.add_argument("--envs", type=int, required=True, help="how many environments")
    parser.add_argument("--seed", type=int, required=True, help="environment i has seed SEED + i")
    parser.add_argument("--reconnect", action="store_true", help="open another session if need be")
    # Whatever ends the parent, no client stays: not even one that is stopped.
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    work = Work(parser.parse_args())
    try:
        work.run()
    except Exception as error:
        work.say(error=f"{type(error).__name__}: {error}")
    else:
        work.say(done=True)


if __name__ == "__main__":
    main()
