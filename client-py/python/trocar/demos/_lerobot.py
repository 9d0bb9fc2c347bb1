"""Demonstrations in LeRobot's format, version 3.0.

Source: the format's description and reader in lerobot 0.4. A frame is a step: what was seen before
it, the action, and what came of it (``next.…``); its subtask is the expert's stage.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

import trocar
from trocar._trocar import Element, TaskSpec
from trocar.demos._episodes import Episode
from trocar.registration import TAGS

if TYPE_CHECKING:
    from trocar.demos._record import Recipe

DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
EPISODES = "meta/episodes/chunk-000/file-000.parquet"
FILE_MEGABYTES = 100
"""What the format recommends for a file; some hundred episodes are less than one."""


def write(folder: Path, recipe: Recipe, task: TaskSpec, episodes: Iterator[Episode]) -> None:
    """Writes episodes to ``folder``, in the place of a data set of LeRobot's."""
    fps = round(1 / task.seconds_per_step)
    features = _features(task.observation, task.goal or [], task.action)
    columns: dict[str, list[NDArray[Any]]] = {name: [] for name in features}
    rows: list[dict[str, Any]] = []
    begin = 0
    for number, episode in enumerate(episodes):
        frames = _frames(episode, number, begin, fps, features)
        for name, values in frames.items():
            columns[name].append(values)
        rows.append(
            {
                "episode_index": number,
                "tasks": [task.summary],
                "length": len(episode),
                "seed": episode.seed,
                "data/chunk_index": 0,
                "data/file_index": 0,
                "dataset_from_index": begin,
                "dataset_to_index": begin + len(episode),
                "meta/episodes/chunk_index": 0,
                "meta/episodes/file_index": 0,
                **{
                    f"stats/{name}/{statistic}": value
                    for name, values in frames.items()
                    for statistic, value in _statistics(values).items()
                },
            }
        )
        begin += len(episode)
    whole = {
        name: np.concatenate(parts) if parts else np.zeros((0, *features[name]["shape"]))
        for name, parts in columns.items()
    }
    _write(folder / DATA.format(chunk_index=0, file_index=0), _table(whole, features))
    _write(folder / EPISODES, pa.Table.from_pylist(rows))
    _write(folder / "meta/tasks.parquet", _indexed("task", [task.summary]))
    _write(folder / "meta/subtasks.parquet", _indexed("subtask", list(trocar.STAGES)))
    info = {
        "codebase_version": "v3.0",
        "robot_type": "dvrk_ecm" if "camera" in TAGS.get(task.id, ()) else "dvrk_psm",
        "total_episodes": len(rows),
        "total_frames": begin,
        "total_tasks": 1,
        "chunks_size": 1000,
        "data_files_size_in_mb": FILE_MEGABYTES,
        "video_files_size_in_mb": FILE_MEGABYTES,
        "fps": fps,
        "splits": {"train": f"0:{len(rows)}"},
        "data_path": DATA,
        "video_path": None,
        "features": features,
        "trocar": asdict(recipe),
    }
    (folder / "meta/info.json").write_text(json.dumps(info, indent=2))
    stats = {name: _statistics(values) for name, values in whole.items() if len(values)}
    (folder / "meta/stats.json").write_text(json.dumps(stats, indent=2))


def _features(
    observation: list[Element], goal: list[Element], action: list[Element]
) -> dict[str, dict[str, Any]]:
    """The columns of frames: their types, shapes and the names of elements."""

    def vector(elements: list[Element]) -> dict[str, Any]:
        names = [element.name for element in elements]
        return {"dtype": "float32", "shape": [len(elements)], "names": names}

    def scalar(dtype: str) -> dict[str, Any]:
        return {"dtype": dtype, "shape": [1], "names": None}

    goals = {f"observation.{name}": vector(goal) for name in ("achieved_goal", "desired_goal")}
    return {
        "observation.state": vector(observation),
        **(goals if goal else {}),
        "action": vector(action),
        "next.reward": scalar("float32"),
        "next.success": scalar("bool"),
        "next.done": scalar("bool"),
        "subtask_index": scalar("int64"),
        "timestamp": scalar("float32"),
        **{
            name: scalar("int64")
            for name in ("frame_index", "episode_index", "index", "task_index")
        },
    }


def _frames(
    episode: Episode, number: int, begin: int, fps: int, features: dict[str, dict[str, Any]]
) -> dict[str, NDArray[Any]]:
    """The columns of one episode."""
    steps = np.arange(len(episode))
    frames: dict[str, NDArray[Any]] = {
        "observation.state": episode.observation[:-1],
        "observation.achieved_goal": episode.achieved_goal[:-1],
        "observation.desired_goal": episode.desired_goal[:-1],
        "action": episode.action,
        "next.reward": episode.reward,
        "next.success": episode.is_success,
        "next.done": episode.terminated | episode.truncated,
        "subtask_index": episode.stage[:-1].astype(np.int64),
        "timestamp": (steps / fps).astype(np.float32),
        "frame_index": steps,
        "episode_index": np.full_like(steps, number),
        "index": begin + steps,
        "task_index": np.zeros_like(steps),
    }
    return {name: frames[name] for name in features}


def _statistics(values: NDArray[Any]) -> dict[str, list[Any]]:
    """Least, greatest, mean, standard deviation and count of each element, as lists."""
    rows = values.reshape(len(values), -1).astype(np.float64)
    return {
        "min": rows.min(axis=0).tolist(),
        "max": rows.max(axis=0).tolist(),
        "mean": rows.mean(axis=0).tolist(),
        "std": rows.std(axis=0).tolist(),
        "count": [len(rows)],
    }


def _table(columns: dict[str, NDArray[Any]], features: dict[str, dict[str, Any]]) -> pa.Table:
    def column(name: str, values: NDArray[Any]) -> pa.Array:
        kind = pa.from_numpy_dtype(np.dtype(features[name]["dtype"]))
        if values.ndim == 1:
            return pa.array(values, kind)
        flat = pa.array(values.reshape(-1), kind)
        return pa.FixedSizeListArray.from_arrays(flat, values.shape[1])

    return pa.table({name: column(name, values) for name, values in columns.items()})


def _indexed(name: str, words: list[str]) -> pa.Table:
    """A table of numbers by word, which pandas reads with the words as its index."""
    number = f"{name}_index"
    table = pa.table({number: pa.array(range(len(words)), pa.int64()), name: words})
    column = {"pandas_type": "int64", "numpy_type": "int64", "metadata": None}
    text = {"pandas_type": "unicode", "numpy_type": "object", "metadata": None}
    pandas = {
        "index_columns": [name],
        "column_indexes": [],
        "columns": [
            {"name": number, "field_name": number, **column},
            {"name": name, "field_name": name, **text},
        ],
        "pandas_version": "2.0.0",
    }
    return table.replace_schema_metadata({"pandas": json.dumps(pandas)})


def _write(path: Path, table: pa.Table) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(table, path, compression="snappy")
