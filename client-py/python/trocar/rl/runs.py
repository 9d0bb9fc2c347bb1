"""Folders of training runs: what is in them, and checkpoints that lose nothing.

config.json             what is trained
curve.csv               a row for each epoch
curve.png               the same as a picture
tensorboard/            the same for TensorBoard
best.zip, last.zip      the policy that was best in evaluations, and the latest
checkpoint/             all that a run needs to go on
"""

from __future__ import annotations

import csv
import io
import os
import pickle
import random
import shutil
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3 import HerReplayBuffer
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

import trocar
from trocar.errors import InvalidRequest, refuse
from trocar.rl.algorithms import GoalDDPG, NormalisedDDPG, NormalisedPPO
from trocar.rl.config import Config
from trocar.rl.curriculum import CurriculumVecEnv
from trocar.sb3 import TrocarVecEnv

CLASSES: dict[str, type[BaseAlgorithm]] = {
    "ddpg": NormalisedDDPG,
    "her": GoalDDPG,
    "her-demo": GoalDDPG,
    "ppo": NormalisedPPO,
}
"""What trains each algorithm."""

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
"""Of ``curve.csv``; losses are means over the epoch's last training, times are since the start."""


@dataclass(frozen=True)
class Run:
    """A run's folder."""

    path: Path

    @property
    def config(self) -> Config:
        """What is trained.

        Raises:
            ValueError: The folder is not that of a run.
        """
        path = self.path / "config.json"
        if not path.is_file():
            raise refuse(InvalidRequest, "run", str(self.path), "expected the folder of a run")
        return Config.from_json(path.read_text())

    def begin(self, config: Config, resume: bool) -> None:
        """Makes the folder, or finds the run that is there.

        Raises:
            ValueError: A run is there and shall not be resumed, or it trains something else.
        """
        path = self.path / "config.json"
        if not path.exists():
            self.path.mkdir(parents=True, exist_ok=True)
            _replace(path, config.to_json().encode())
            return
        if not resume:
            allowed = "a run is there already; resume it, or choose another folder"
            raise refuse(InvalidRequest, "out", str(self.path), allowed)
        there = asdict(self.config)
        for name, value in asdict(config).items():
            if there[name] != value:
                allowed = f"the run in {self.path} has {there[name]!r}"
                raise refuse(InvalidRequest, name, value, allowed)

    def rows(self) -> list[dict[str, float]]:
        """The curve: a row for each epoch, numbers by :data:`COLUMNS`."""
        path = self.path / "curve.csv"
        if not path.exists():
            return []
        with path.open(newline="") as file:
            return [
                {name: float(text) for name, text in row.items() if text}
                for row in csv.DictReader(file)
            ]

    def write_rows(self, rows: list[dict[str, float]]) -> None:
        """Writes the curve."""
        text = io.StringIO(newline="")
        writer = csv.DictWriter(text, COLUMNS, restval="", lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
        _replace(self.path / "curve.csv", text.getvalue().encode())

    def policy(self, which: str = "best") -> BaseAlgorithm:
        """The policy that was ``best`` in evaluations, or the ``last``; it cannot be trained on.

        Raises:
            ValueError: There is none.
        """
        path = self.path / f"{which}.zip"
        if which not in ("best", "last") or not path.is_file():
            raise refuse(InvalidRequest, "policy", which, f"expected best or last in {self.path}")
        # It gets no experience, and so needs neither memory nor environments for it.
        without: dict[str, Any] = {
            "buffer_size": 1,
            "replay_buffer_class": None,
            "replay_buffer_kwargs": {},
        }
        return CLASSES[self.config.algo].load(path, device="cpu", custom_objects=without)

    @property
    def has_checkpoint(self) -> bool:
        """Whether there is something to go on from."""
        return self._checkpoint.is_dir()

    @property
    def _checkpoint(self) -> Path:
        # A run that was killed between two renames has only the one before.
        there, before = self.path / "checkpoint", self.path / "checkpoint.before"
        return there if there.is_dir() or not before.is_dir() else before

    def save(self, model: BaseAlgorithm, envs: TrocarVecEnv, rows: list[dict[str, float]]) -> None:
        """Writes a checkpoint: networks, optimisers, experience, randomness, environments."""
        beside = self.path / "checkpoint.new"
        shutil.rmtree(beside, ignore_errors=True)
        beside.mkdir()
        model.save(beside / "model.zip")
        if isinstance(model, OffPolicyAlgorithm):
            with (beside / "replay.pkl").open("wb") as file:
                pickle.dump(model.replay_buffer, file, protocol=5)
        state = {
            "rows": rows,
            "last_obs": model._last_obs,
            "last_episode_starts": model._last_episode_starts,
            "envs": envs.envs.snapshot().to_bytes(),
            "curriculum": envs.progress() if isinstance(envs, CurriculumVecEnv) else None,
            "version": trocar.__version__,
            "python": random.getstate(),
            "numpy": np.random.get_state(),
            "torch": torch.get_rng_state(),
            "actions": model.action_space.np_random,
        }
        with (beside / "state.pkl").open("wb") as file:
            pickle.dump(state, file, protocol=5)
        there, before = self.path / "checkpoint", self.path / "checkpoint.before"
        if there.is_dir():
            shutil.rmtree(before, ignore_errors=True)
            there.rename(before)
        beside.rename(there)
        shutil.rmtree(before, ignore_errors=True)

    def restore(self, envs: TrocarVecEnv) -> tuple[BaseAlgorithm, list[dict[str, float]]]:
        """The model of the checkpoint, which goes on in ``envs``, and the curve up to there.

        Raises:
            ValueError: It is of another version.
        """
        folder = self._checkpoint
        with (folder / "state.pkl").open("rb") as file:
            state: Mapping[str, Any] = pickle.load(file)
        if state["version"] != trocar.__version__:
            allowed = f"a checkpoint of {state['version']} goes on in that version only"
            raise refuse(InvalidRequest, "version", trocar.__version__, allowed)
        model = CLASSES[self.config.algo].load(folder / "model.zip", env=envs, device="cpu")
        if isinstance(model, OffPolicyAlgorithm):
            with (folder / "replay.pkl").open("rb") as file:
                model.replay_buffer = pickle.load(file)
            if isinstance(model.replay_buffer, HerReplayBuffer):
                model.replay_buffer.set_env(envs)
        envs.reset()
        envs.envs.restore(trocar.Snapshot.from_bytes(state["envs"]))
        if isinstance(envs, CurriculumVecEnv):
            envs.go_on(state["curriculum"])
        model._last_obs = state["last_obs"]
        model._last_episode_starts = state["last_episode_starts"]
        model.action_space._np_random = state["actions"]
        random.setstate(state["python"])
        np.random.set_state(state["numpy"])
        torch.set_rng_state(state["torch"])
        return model, list(state["rows"])


def _replace(path: Path, content: bytes) -> None:
    """Writes a file, which is there only when it is whole."""
    beside = path.with_name(f"{path.name}.new")
    with beside.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    beside.replace(path)
