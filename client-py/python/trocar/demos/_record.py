"""Recording: runs the expert, keeps what succeeded, survives interruption."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import trocar
from trocar._goal import check_seed
from trocar.demos._episodes import Episode, load, run, save
from trocar.errors import InvalidRequest, refuse
from trocar.vector import TrocarVectorEnv

FORMATS = ("minari", "lerobot")
"""What demonstrations can be written as."""

RECIPE = "recipe.json"


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
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> Recording:
    """Runs a task's scripted expert and writes its episodes as a data set.

    With ``$MINARI_DATASETS_PATH`` set to ``out``, ``minari.load_dataset("trocar/TASK/NAME")`` reads
    it. What is done is kept beside it until all is done: ``resume`` goes on from there.

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
    recipe = Recipe(task, options, seed, episodes, keep_failures, trocar.__version__)
    target = dataset_path(out, task, name)
    if target.exists():
        return _finished(target, recipe, resume)
    partial = target.with_name(f"{name}.partial")
    if partial.exists() and not resume:
        allowed = "an interrupted recording is there; resume it, or remove it"
        raise refuse(InvalidRequest, "out", str(partial), allowed)

    session = TrocarVectorEnv(
        task,
        min(envs, episodes),
        server=server,
        autoreset_mode="disabled",
        expert=True,
        **options,
    )
    try:
        partial.mkdir(parents=True, exist_ok=True)
        _claim(partial, recipe)
        kept = _collect(session, partial, recipe, progress or _say_nothing)
        whole = target.with_name(f"{name}.whole")
        shutil.rmtree(whole, ignore_errors=True)
        write(whole, recipe, session, _episodes(partial))
    finally:
        session.close()
    recording = Recording(task, episodes, kept, str(target))
    (whole / RECIPE).write_text(recipe.to_json())
    (whole / "recording.json").write_text(json.dumps(asdict(recording)))
    whole.rename(target)
    shutil.rmtree(partial)
    return recording


def _writer(format: str) -> Callable[[Path, Recipe, TrocarVectorEnv, Iterator[Episode]], None]:  # noqa: A002
    """What writes a format; an error that names the extra where it is not installed."""
    try:
        if format == "minari":
            from trocar.demos._minari import write
        else:
            from trocar.demos._lerobot import write
    except ImportError as error:
        text = f"{error}; demonstrations need the extra: pip install trocar[demos]"
        raise ModuleNotFoundError(text) from error
    return write


def _finished(target: Path, recipe: Recipe, resume: bool) -> Recording:
    """What is there already, if it is what was asked for and ``resume`` is."""
    if not resume:
        raise refuse(InvalidRequest, "out", str(target), "there is a data set already")
    _claim(target, recipe)
    told = json.loads((target / "recording.json").read_text())
    return Recording(**(told | {"path": str(target)}))


def _claim(folder: Path, recipe: Recipe) -> None:
    """Says in a folder what is recorded there; an error where that is something else."""
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
    session: TrocarVectorEnv, partial: Path, recipe: Recipe, progress: Callable[[int, int], None]
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
        count = min(session.num_envs, recipe.episodes - done)
        seeds = [check_seed(recipe.seed + done + row) for row in range(session.num_envs)]
        episodes = run(session, seeds)[:count]
        good = [episode for episode in episodes if recipe.keeps_failures or episode.succeeded]
        save(partial / f"{done:08}-{done + count:08}.npz", good)
        done, kept = done + count, kept + len(good)
        progress(done, kept)
    return kept
