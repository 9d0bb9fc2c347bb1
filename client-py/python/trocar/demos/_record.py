"""Recording: the expert or a person acts, what succeeded is kept, an interruption survived."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import shutil
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import trocar
from trocar._connection import SERVER
from trocar._extras import missing_extra
from trocar._goal import check_seed
from trocar._trocar import TaskSpec
from trocar.demos._by_hand import demonstrate
from trocar.demos._episodes import Episode, load, run, save
from trocar.dvrk.env import LiveEnv
from trocar.errors import InvalidRequest, refuse
from trocar.registration import TASKS, register
from trocar.vector import TrocarVectorEnv

FORMATS = ("minari", "lerobot")
"""What demonstrations can be written as."""

RECIPE = "recipe.json"

LONGER = 10
"""How many times as long as the task's episodes a person's may be."""


@dataclass(frozen=True)
class Recipe:
    """All that decides what a recording holds."""

    task: str
    """Id without namespace, e.g. ``NeedlePick-v0``."""
    options: dict[str, Any]
    """The task's options, where they are not the defaults."""
    seed: int
    """Episode k has the seed ``seed + k``."""
    episodes: int
    """How many episodes are run."""
    keeps_failures: bool
    """Whether those are kept that do not succeed."""
    by_hand: bool
    """Whether a person drives, instead of the expert."""
    version: str
    """The version of Trocar."""

    def to_json(self) -> str:
        """As text, from which its dictionary can be read."""
        return json.dumps(asdict(self), indent=2, sort_keys=True)


@dataclass(frozen=True)
class Recording:
    """What :func:`record` wrote."""

    task: str
    """Id without namespace."""
    episodes: int
    """Episodes that were run."""
    kept: int
    """Those that were written."""
    path: str
    """The data set's folder."""


def dataset_path(out: str | os.PathLike[str], task: str, name: str = "expert-v0") -> Path:
    """Where the data set ``trocar/TASK/NAME`` lies in the folder ``out``."""
    return Path(out) / "trocar" / task / name


def record(
    task: str,
    *,
    episodes: int = 100,
    out: str | os.PathLike[str] = "demos",
    name: str = "expert-v0",
    format: str = "minari",  # noqa: A002 - as the flag is called
    seed: int = 0,
    keep_failures: bool = False,
    envs: int = 16,
    resume: bool = False,
    server: str | None = None,
    by_hand: Callable[[str], object] | None = None,
    speed: float = 1.0,
    max_steps: int | None = None,
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> Recording:
    """Runs a task's scripted expert, or lets a person drive, and writes the episodes as a data set.

    With ``$MINARI_DATASETS_PATH`` set to ``out``, ``minari.load_dataset("trocar/TASK/NAME")`` reads
    the data set. Finished episodes lie beside the data set until the last one: ``resume`` goes on
    from there.

    Args:
        task: Id without namespace, e.g. ``NeedlePick-v0``.
        episodes: How many episodes are run.
        out: Folder of data sets.
        name: The data set's name, e.g. ``expert-v0``; Minari wants a version at its end.
        format: ``minari`` (HDF5) or ``lerobot`` (version 3.0).
        seed: Episode k has the seed ``seed + k``.
        keep_failures: Whether to keep episodes that do not succeed, too.
        envs: Most environments at a time; it changes no data.
        resume: Whether to go on with an interrupted recording of the same recipe.
        server: Name of the server; ``None`` for ``$TROCAR_SERVER``, else a private one.
        by_hand: Lets a person drive, and is called with the address of the page to do it at. An
            episode begins once they take an arm over there, by key G, and ends with success, when
            they give all arms back, or at the time limit.
        speed: How many times as fast as life the world is that a person drives.
        max_steps: Steps of a person's episode; ``None`` for ten times the task's number.
        progress: Called with the numbers of episodes that were run and kept.
        options: The task's options.

    Raises:
        ValueError: An argument is not allowed, something is there already, or what is there has
            another recipe.
        ModuleNotFoundError: The extra ``trocar[demos]`` is not installed.
    """
    if format not in FORMATS:
        raise refuse(InvalidRequest, "format", format, f"allowed are {list(FORMATS)}")
    if episodes < 1:
        raise refuse(InvalidRequest, "episodes", episodes, "allowed are numbers from 1 on")
    write = _writer(format)
    is_by_hand = by_hand is not None
    recipe = Recipe(task, options, seed, episodes, keep_failures, is_by_hand, trocar.__version__)
    target = dataset_path(out, task, name)
    if target.exists():
        return _finished(target, recipe, resume)
    partial = _hidden(target, "partial")
    if partial.exists() and not resume:
        allowed = "an interrupted recording is there; resume it, or remove it"
        raise refuse(InvalidRequest, "out", str(partial), allowed)

    source: _Expert | _Person
    if by_hand is not None:
        source = _Person(task, server, speed, max_steps, options)
        by_hand(source.env.page)
    else:
        source = _Expert(task, server, min(envs, episodes), options)
    try:
        if format == "lerobot" and source.env.task_spec.images is not None:
            allowed = "LeRobot's data sets have no pictures here; the format minari has"
            value = options.get("observation")
            raise refuse(InvalidRequest, "options.observation", value, allowed)
        # A data set names the environment of a server's own task by its Gymnasium id.
        register(task, server=None if task in TASKS else server or os.environ.get(SERVER))
        partial.mkdir(parents=True, exist_ok=True)
        with _locked(partial):
            if target.exists():  # another process has finished it meanwhile
                return _finished(target, recipe, resume)
            _claim(partial, recipe)
            kept = _collect(source, partial, recipe, progress or _say_nothing)
            recording = Recording(task, episodes, kept, str(target))
            whole = _hidden(target, "whole")
            shutil.rmtree(whole, ignore_errors=True)
            try:
                write(whole, recipe, source.env.task_spec, _episodes(partial))
                (whole / RECIPE).write_text(recipe.to_json())
                (whole / "recording.json").write_text(json.dumps(asdict(recording)))
                whole.rename(target)
            except BaseException:
                shutil.rmtree(whole, ignore_errors=True)
                raise
            shutil.rmtree(partial)
    finally:
        source.env.close()
    return recording


def _hidden(target: Path, kind: str) -> Path:
    """Unfinished folder beside a data set; readers skip names that begin with a dot."""
    return target.with_name(f".{target.name}.{kind}")


@contextlib.contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Locks a folder against other processes; the lock ends with this process, too.

    Raises:
        InvalidRequest: Another process has the lock.
    """
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            allowed = "another process records there"
            raise refuse(InvalidRequest, "out", str(folder), allowed) from None
        yield
    finally:
        os.close(descriptor)


class _Expert:
    """The scripted expert, in many environments at a time."""

    def __init__(self, task: str, server: str | None, envs: int, options: dict[str, Any]) -> None:
        self.count = envs
        self.env = TrocarVectorEnv(
            task, envs, server=server, autoreset_mode="disabled", expert=True, **options
        )

    def run(self, seeds: list[int]) -> list[Episode]:
        """The episodes of :attr:`count` seeds."""
        return run(self.env, seeds)


class _Person:
    """A person at the viewer's page."""

    count = 1

    def __init__(
        self,
        task: str,
        server: str | None,
        speed: float,
        max_steps: int | None,
        options: dict[str, Any],
    ) -> None:
        self.env = LiveEnv(
            task, server=server, speed=speed, intervention=True, max_steps=max_steps, **options
        )
        if max_steps is None:
            self.env.max_steps *= LONGER

    def run(self, seeds: list[int]) -> list[Episode]:
        """The episode of one seed."""
        return [demonstrate(self.env, seed) for seed in seeds]


def _writer(format: str) -> Callable[[Path, Recipe, TaskSpec, Iterator[Episode]], None]:  # noqa: A002
    """What writes a format; an error that names the extra where it is not installed."""
    try:
        if format == "minari":
            from trocar.demos._minari import write
        else:
            from trocar.demos._lerobot import write
    except ImportError as error:
        raise missing_extra(error, "demos", "trocar demos") from error
    return write


def _finished(target: Path, recipe: Recipe, resume: bool) -> Recording:
    """What is there already, if it is what was asked for and ``resume`` is."""
    if not resume:
        allowed = "there is a data set already; choose another --out or --name, or --resume"
        raise refuse(InvalidRequest, "out", str(target), allowed)
    _claim(target, recipe)
    told = json.loads((target / "recording.json").read_text())
    return Recording(**(told | {"path": str(target)}))


def _claim(folder: Path, recipe: Recipe) -> None:
    """Writes the recipe into a folder; raises an error if the folder has another recipe."""
    path = folder / RECIPE
    if not path.exists():
        beside = path.with_suffix(".tmp")
        beside.write_text(recipe.to_json())
        beside.replace(path)
        return
    there, wanted = json.loads(path.read_text()), json.loads(recipe.to_json())
    for field, value in there.items():
        if value != wanted.get(field):
            allowed = f"the recording in {folder} has {value!r}"
            raise refuse(InvalidRequest, field, wanted.get(field), allowed)


def _say_nothing(done: int, kept: int) -> None:
    del done, kept


def _parts(partial: Path) -> list[Path]:
    return sorted(partial.glob("*.npz"))


def _episodes(partial: Path) -> Iterator[Episode]:
    for part in _parts(partial):
        yield from load(part)


def _collect(
    source: _Expert | _Person,
    partial: Path,
    recipe: Recipe,
    progress: Callable[[int, int], None],
) -> int:
    """Runs what was not run yet; how many episodes are kept in all.

    A part is named by the episodes that it is about, so it tells what was run even where nothing of
    it is kept.
    """
    done, kept = 0, 0
    for part in _parts(partial):
        done = int(part.stem.partition("-")[2])
        kept += sum(1 for _ in load(part))
    progress(done, kept)
    while done < recipe.episodes:
        # Environments too many for the rest run episodes that are dropped.
        count = min(source.count, recipe.episodes - done)
        seeds = [check_seed(recipe.seed + done + row) for row in range(source.count)]
        episodes = source.run(seeds)[:count]
        good = [episode for episode in episodes if recipe.keeps_failures or episode.succeeded]
        save(partial / f"{done:08}-{done + count:08}.npz", good)
        done, kept = done + count, kept + len(good)
        progress(done, kept)
    return kept
