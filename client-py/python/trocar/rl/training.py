"""Training runs: epochs, evaluations, checkpoints, logs."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from torch.utils.tensorboard import SummaryWriter

import trocar
from trocar._trocar import Client
from trocar.rl import demonstrations
from trocar.rl.baselines import Baseline
from trocar.rl.config import BASELINES, Config
from trocar.rl.curves import plot_run
from trocar.rl.episodes import Episodes
from trocar.rl.evaluation import SEED, Score, score
from trocar.rl.imitation import Cloning, Dagger
from trocar.rl.learner import Learner, Row
from trocar.rl.runs import Run
from trocar.rl.td3 import Td3Demo
from trocar.sb3 import TrocarVecEnv, make_vec

Say = Callable[[str], None]


def train(
    config: Config,
    seed: int,
    *,
    out: str | os.PathLike[str] = "runs",
    resume: bool = False,
    demos: str | os.PathLike[str] | None = None,
    server: str | None = None,
    threads: int = 1,
    view: bool = False,
    trust: bool = False,
    say: Say = lambda line: print(line, file=sys.stderr, flush=True),
) -> Run:
    """Trains, and writes everything to ``out/TASK/ALGO/seed-SEED``.

    With one thread, the same configuration and seed give the same curve, interrupted or not.

    Args:
        config: What is trained.
        seed: Of networks, exploration and environments.
        out: Folder of runs.
        resume: Whether to go on with a run that is there already.
        demos: Folder of a Minari data set to learn from; the server's expert if ``None``.
        server: Name of the server; one of its own if ``None``.
        threads: Of PyTorch; small networks need no more than one.
        view: Whether to say where the server's live viewer shows it, which is then started.
        trust: True to resume a checkpoint of Stable-Baselines3, whose files can run any code.
        say: Takes lines for people.

    Raises:
        ValueError: A run is there already, the demonstrations are not for this, or the checkpoint
            is not trusted.
    """
    run = Run(Path(out) / config.task / config.algo / f"seed-{seed}", trust)
    run.check(config, resume)
    torch.set_num_threads(threads)
    with _served(server) as (name, server_pid):
        if view:
            say(f"Watch it at http://{Client.connect(name).viewer()}")
        clock = _Clock(server_pid)
        shown = None
        if config.demos and demos is not None:
            shown = demonstrations.recorded(Path(demos), config, name)
        elif config.demos:
            shown = demonstrations.expert(config, name)
        learner = make_learner(config, shown, seed, server=name)
        evaluation = make_vec(config.task_id, config.eval_episodes, server=name, **config.options)
        try:
            # Options and demonstrations are valid by now, so a refused run leaves no folder.
            run.begin(config, resume)
            _epochs(run, learner, evaluation, clock, say)
        finally:
            learner.close()
            evaluation.close()
    plot_run(run, run.path / "curve.png")
    return replace(run, trust=True)  # this process wrote the files


def make_learner(
    config: Config, demos: Episodes | None, seed: int, *, server: str | None = None
) -> Learner:
    """The untrained learner of a configuration.

    Args:
        config: What is trained.
        demos: Demonstrations, where the algorithm learns from any.
        seed: Of networks, exploration and environments.
        server: Name of the server.
    """
    if config.algo in BASELINES:
        return Baseline(config, demos, seed, server=server)
    if config.algo.startswith("td3"):
        return Td3Demo(config, demos, seed, server=server)
    assert demos is not None
    cloning = Dagger if config.algo == "dagger" else Cloning
    return cloning(config, demos, seed, server=server)


def _epochs(run: Run, learner: Learner, evaluation: TrocarVecEnv, clock: _Clock, say: Say) -> None:
    """Trains the epochs that are left; each ends with an evaluation and a checkpoint."""
    config = run.config
    rows = run.restore(learner) if run.has_checkpoint else []
    clock.go_on(rows)
    best = max((_worth(row) for row in rows), default=(-1.0, -np.inf))
    purge_step = int(rows[-1]["steps"]) + 1 if rows else 0
    writer = SummaryWriter(str(run.path / "tensorboard"), purge_step=purge_step)
    while len(rows) <= config.epochs and not _is_enough(config, rows):
        epoch = len(rows)
        live = _Live(config, epoch, clock)
        (learner.learn if epoch else learner.begin)(live)
        result = score(learner.acting, evaluation, SEED)
        row = _row(epoch, config, result, learner, clock)
        rows.append(row)
        learner.save_policy(run.path / "last.zip")
        if _worth(row) >= best:
            best = _worth(row)
            learner.save_policy(run.path / "best.zip")
        if epoch:
            run.save(learner, rows)
        _note(run, rows, writer)
        live.clear()
        say(
            f"{live.where}  success {row['success']:6.1%}  return {row['mean_return']:8.2f}  "
            f"{clock.wall():6.0f} s{live.left(1.0)}"
        )
    writer.close()


def _worth(row: Row) -> tuple[float, float]:
    """What makes a policy better than another."""
    return row["success"], row["mean_return"]


def _is_enough(config: Config, rows: list[Row]) -> bool:
    return bool(rows) and 0.0 < config.enough <= rows[-1]["success"]


def _row(epoch: int, config: Config, result: Score, learner: Learner, clock: _Clock) -> Row:
    return {
        "epoch": epoch,
        "episodes": epoch * config.epoch_episodes,
        "success": result.success_rate,
        "success_ever": result.successes_ever / result.episodes,
        "mean_return": result.mean_return,
        "mean_length": result.mean_length,
        **learner.row(),
        **clock.times(),
    }


def _note(run: Run, rows: list[Row], writer: SummaryWriter) -> None:
    """Writes the curve, and its last row for TensorBoard."""
    run.write_rows(rows)
    for name, value in rows[-1].items():
        if name not in ("epoch", "steps"):
            writer.add_scalar(name, value, int(rows[-1]["steps"]))
    writer.flush()


class _Live:
    """A line on the terminal that says how far an epoch is, where a user sees it."""

    def __init__(self, config: Config, epoch: int, clock: _Clock) -> None:
        self.where = f"{config.task} {config.algo}  epoch {epoch:3} of {config.epochs}"
        self._epoch, self._epochs, self._clock = epoch, config.epochs, clock
        self._begun = clock.wall()
        self._seen = sys.stderr.isatty()

    def __call__(self, done: float) -> None:
        if self._seen:
            told = f"\r{self.where}  {done:4.0%}  {self._clock.wall():6.0f} s"
            print(f"{told}{self.left(done)}", end="", file=sys.stderr, flush=True)

    def left(self, done: float) -> str:
        """Time until the end if later epochs take as long as this one; empty during epoch 0."""
        later = self._epochs - self._epoch
        took = self._clock.wall() - self._begun
        if not done or not self._epoch:
            return ""
        return f", {took * (1 - done + later) / done:6.0f} s left"

    def clear(self) -> None:
        """Removes it."""
        if self._seen:
            print("\r\033[K", end="", file=sys.stderr, flush=True)


class _Clock:
    """Times of a run, with those that it had taken before it was interrupted."""

    def __init__(self, server_pid: int) -> None:
        self._server_pid = server_pid
        self._start = self._now()

    def go_on(self, rows: list[Row]) -> None:
        """Adds the times of a curve that goes on."""
        for name in self._start if rows else ():
            self._start[name] -= rows[-1][name]

    def times(self) -> Row:
        """Seconds since the start: of the wall's clock, and of processors."""
        return {name: time - self._start[name] for name, time in self._now().items()}

    def wall(self) -> float:
        """Seconds since the start."""
        return self.times()["wall_s"]

    def _now(self) -> Row:
        return {
            "wall_s": time.monotonic(),
            "trainer_cpu_s": time.process_time(),
            "server_cpu_s": cpu_seconds(self._server_pid),
        }


def cpu_seconds(pid: int) -> float:
    """What a process has used of the processors so far, s; 0 where it cannot be seen."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@contextmanager
def _served(name: str | None) -> Iterator[tuple[str, int]]:
    """Name and process of a server: of one that runs, or of one for as long as the block lasts."""
    if name is not None:
        yield name, Client.connect(name).pid
        return
    with trocar.Server() as server:
        assert server.pid is not None
        yield server.name, server.pid
