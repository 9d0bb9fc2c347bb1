"""Folders of training runs: what is in them, and checkpoints that lose nothing.

config.json             what is trained
curve.csv               a row for each epoch
curve.png               the same as a picture
tensorboard/            the same for TensorBoard
best.zip, last.zip      the policy that was best in evaluations, and the latest
checkpoint/             all that a run needs to go on
evaluations.jsonl       how well its policies do, a line for each time that they were evaluated
"""

from __future__ import annotations

import contextlib
import csv
import io
import json
import os
import pickle
import shutil
import zipfile
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from stable_baselines3.common.base_class import BaseAlgorithm

import trocar
from trocar.errors import InvalidRequest, TrocarError, refuse
from trocar.rl.baselines import load_policy
from trocar.rl.config import OWN, Config
from trocar.rl.learner import Learner, Row
from trocar.rl.networks import Policy

COLUMNS = (
    "epoch",
    "episodes",
    "steps",
    "updates",
    "success",
    "success_ever",
    "mean_return",
    "mean_length",
    "actor_loss",
    "critic_loss",
    "clone_loss",
    "passed",
    "level",
    "wall_s",
    "trainer_cpu_s",
    "server_cpu_s",
)
"""Of ``curve.csv``; losses are means over the epoch, or its last training
(Stable-Baselines3); times are since the start."""


@dataclass(frozen=True)
class Run:
    """A run's folder."""

    path: Path
    trust: bool = field(default=False, compare=False)
    """True to load models and checkpoints of Stable-Baselines3, whose files can run any code."""

    @property
    def config(self) -> Config:
        """What is trained.

        Raises:
            ValueError: The folder is not that of a run.
        """
        path = self.path / "config.json"
        if not path.is_file():
            raise refuse(InvalidRequest, "run", str(self.path), "expected the folder of a run")
        with _reading(path):
            text = path.read_text()
            json.loads(text)
        return Config.from_json(text)

    def begin(self, config: Config, resume: bool) -> None:
        """Makes the folder, or checks the run in the folder.

        Raises:
            ValueError: As :meth:`check`.
        """
        self.check(config, resume)
        path = self.path / "config.json"
        if not path.exists():
            self.path.mkdir(parents=True, exist_ok=True)
            _replace(path, config.to_json().encode())

    def check(self, config: Config, resume: bool) -> None:
        """Checks that the configuration can be trained in this folder; writes no file.

        Raises:
            ValueError: The folder has a run that is not to be resumed, or another configuration.
        """
        if not (self.path / "config.json").exists():
            return
        if not resume:
            allowed = (
                "a run is there already: resume it (--resume), or choose another folder (--out)"
            )
            raise refuse(InvalidRequest, "out", str(self.path), allowed)
        if self.has_checkpoint:
            self._check_trust(self._checkpoint, config.algo)
        there = asdict(self.config)
        for name, value in asdict(config).items():
            if there[name] != value:
                allowed = f"the run in {self.path} has {there[name]!r}"
                raise refuse(InvalidRequest, name, value, allowed)

    @property
    def seed(self) -> int:
        """Of networks, exploration and environments."""
        return int(self.path.name.removeprefix("seed-"))

    def evaluations(self) -> list[dict[str, Any]]:
        """How well its policies do, oldest first, as ``python -m trocar.rl evaluate`` prints it."""
        path = self.path / "evaluations.jsonl"
        return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []

    def add_evaluation(self, told: dict[str, Any]) -> None:
        """Adds one to :meth:`evaluations`."""
        with (self.path / "evaluations.jsonl").open("a") as file:
            file.write(json.dumps(told) + "\n")

    def rows(self) -> list[Row]:
        """The curve: a row for each epoch, numbers by :data:`COLUMNS`."""
        path = self.path / "curve.csv"
        if not path.exists():
            return []
        with path.open(newline="") as file:
            return [
                {name: float(text) for name, text in row.items() if text}
                for row in csv.DictReader(file)
            ]

    def write_rows(self, rows: list[Row]) -> None:
        """Writes the curve."""
        text = io.StringIO(newline="")
        writer = csv.DictWriter(text, COLUMNS, restval="", lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
        _replace(self.path / "curve.csv", text.getvalue().encode())

    def policy(self, which: str = "best") -> BaseAlgorithm | Policy:
        """The policy that was ``best`` in evaluations, or the ``last``; it cannot be trained on.

        Raises:
            ValueError: There is none, or its file can run code and is not trusted.
        """
        path = self.path / f"{which}.zip"
        if which not in ("best", "last") or not path.is_file():
            raise refuse(InvalidRequest, "policy", which, f"expected best or last in {self.path}")
        algo = self.config.algo
        self._check_trust(path, algo)
        with _reading(path):
            return Policy.load(path) if algo in OWN else load_policy(algo, path)

    @property
    def has_checkpoint(self) -> bool:
        """Whether there is something to go on from."""
        return self._checkpoint.is_dir()

    @property
    def _checkpoint(self) -> Path:
        # A run that was killed between two renames has only the one before.
        there, before = self.path / "checkpoint", self.path / "checkpoint.before"
        return there if there.is_dir() or not before.is_dir() else before

    def save(self, learner: Learner, rows: list[Row]) -> None:
        """Writes a checkpoint: networks, optimisers, experience, randomness, environments."""
        beside = self.path / "checkpoint.new"
        shutil.rmtree(beside, ignore_errors=True)
        beside.mkdir()
        learner.save(beside)
        told = {"version": trocar.__version__, "rows": rows}
        (beside / "rows.json").write_text(json.dumps(told))
        there, before = self.path / "checkpoint", self.path / "checkpoint.before"
        if there.is_dir():
            shutil.rmtree(before, ignore_errors=True)
            there.rename(before)
        beside.rename(there)
        shutil.rmtree(before, ignore_errors=True)

    def restore(self, learner: Learner) -> list[Row]:
        """Lets a learner go on from the checkpoint; the curve until there.

        Raises:
            ValueError: It is of another version, or its files can run code and are not trusted.
        """
        self._check_trust(self._checkpoint, self.config.algo)
        with _reading(self._checkpoint / "rows.json") as path:
            told = json.loads(path.read_text())
        if told["version"] != trocar.__version__:
            allowed = f"a checkpoint of {told['version']} goes on in that version only"
            raise refuse(InvalidRequest, "version", trocar.__version__, allowed)
        with _reading(self._checkpoint):
            learner.restore(self._checkpoint)
        rows: list[Row] = told["rows"]
        return rows

    def _check_trust(self, path: Path, algo: str) -> None:
        """Checks that a file or folder may be loaded.

        Raises:
            InvalidRequest: Loading can run code, and the run is not trusted.
        """
        if algo not in OWN and not self.trust:
            allowed = (
                f"loading {path} can run any code, as files of Stable-Baselines3 do; if you trust "
                "the file, give --trust (trust=True)"
            )
            raise refuse(InvalidRequest, "trust", False, allowed)


@contextlib.contextmanager
def _reading(path: Path) -> Iterator[Path]:
    """Names a file or folder of a run that cannot be read.

    Raises:
        InvalidRequest: The content is damaged or cut off.
    """
    try:
        yield path
    except TrocarError:
        raise
    except (
        OSError,
        EOFError,
        ValueError,
        KeyError,
        RuntimeError,
        pickle.UnpicklingError,
        zipfile.BadZipFile,
    ) as error:
        words = str(error).splitlines() or [type(error).__name__]
        allowed = f"it is damaged or cut off ({words[0]})"
        raise refuse(InvalidRequest, "run", str(path), allowed) from error


def _replace(path: Path, content: bytes) -> None:
    """Writes a file, which is there only when it is whole."""
    beside = path.with_name(f"{path.name}.new")
    with beside.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    beside.replace(path)
