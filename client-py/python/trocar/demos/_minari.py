"""Demonstrations as a Minari data set."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from copy import copy
from dataclasses import asdict, fields
from importlib.metadata import version
from inspect import signature
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import h5py  # noqa: F401 - Minari asks for it only when it writes
import numpy as np
from minari.data_collector import EpisodeBuffer
from minari.dataset.minari_storage import MinariStorage

import trocar
from trocar._goal import action_space, observation_space
from trocar._trocar import ImageSpec, TaskSpec
from trocar.demos._episodes import Episode
from trocar.registration import NAMESPACE

if TYPE_CHECKING:
    from trocar.demos._record import Recipe

BY = ("scripted expert", "driver, a person")
"""Whose episodes they are."""


FILE = "main_data.hdf5"
"""Minari's name of the file of episodes."""

GROUP = 16
"""Episodes that are written to the file at a time."""

ROOM = 2**16
"""Disk space of indices in the file, bytes for each episode; 27,000 were measured."""


def write(folder: Path, recipe: Recipe, task: TaskSpec, episodes: Iterator[Episode]) -> None:
    """Writes episodes to ``folder``, in the place of a data set of Minari's.

    Infos of a step are ``is_success`` and ``expert_stage``, with a first row for the reset. The
    metadata hold the recipe under ``trocar``, the names of the stages, and the cameras of pictures.
    Pictures are stored without loss.

    Raises:
        OSError: No space is left for the data set.
    """
    spec = copy(gym.spec(f"{NAMESPACE}/{recipe.task}"))  # the registry keeps its own
    spec.kwargs = {**spec.kwargs, **recipe.options}
    data = (folder / "data").absolute()  # Minari joins a relative one to itself
    data.mkdir(parents=True)
    _reserve(data / "room", ROOM)
    (data / "room").unlink()
    # Minari before 0.5.4 has no such argument, and compresses pictures with loss.
    is_known = "jpeg_encoding" in signature(MinariStorage.new).parameters
    lossless: dict[str, Any] = {"jpeg_encoding": False} if is_known else {}
    storage = MinariStorage.new(
        data,
        observation_space=observation_space(task),
        action_space=action_space(task),
        env_spec=spec,
        data_format="hdf5",
        **lossless,
    )
    name = folder.name.removeprefix(".").removesuffix(".whole")
    kept = "all episodes" if recipe.keeps_failures else "successful episodes only"
    inside = {**asdict(recipe), "stages": trocar.STAGES}
    if task.images is not None:
        inside["images"] = _cameras(task.images)
    storage.update_metadata(
        {
            "dataset_id": f"{NAMESPACE}/{recipe.task}/{name}",
            "algorithm_name": BY[recipe.by_hand],
            "author": {"Trocar"},
            "description": f"{recipe.task}, by its {BY[recipe.by_hand]}, {kept}",
            "minari_version": version("minari"),
            "requirements": [f"trocar=={trocar.__version__}"],
            "trocar": json.dumps(inside),
        }
    )
    storage.update_episodes([])  # makes the file
    with_state = task.images is None or task.images.with_state
    while group := list(islice(episodes, GROUP)):
        # HDF5 pads the last chunk of an array; pictures took 1.2 times their size.
        _reserve(data / FILE, sum(ROOM + 2 * _size(episode) for episode in group))
        storage.update_episodes(_buffer(episode, with_state) for episode in group)


def _reserve(path: Path, size: int) -> None:
    """Allocates disk space behind the end of a file; HDF5 cuts off the unused part when it closes.

    HDF5 ends the process with a segmentation fault if a disk is full while it closes a file.

    Raises:
        OSError: No space is left.
    """
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT, 0o666)
    try:
        os.posix_fallocate(descriptor, os.fstat(descriptor).st_size, size)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path.parents[1])) from None
    finally:
        os.close(descriptor)


def _size(episode: Episode) -> int:
    """Bytes of an episode's arrays."""
    arrays = (getattr(episode, each.name) for each in fields(Episode) if each.name != "pictures")
    return sum(np.asarray(array).nbytes for array in (*arrays, *episode.pictures.values()))


def _cameras(images: ImageSpec) -> dict[str, Any]:
    """Cameras of the pictures, as ``task_spec.images`` describes them."""
    names = (
        *("kinds", "views", "height", "width", "intrinsics"),
        *("camera_from_world", "far", "bodies"),
    )
    return {name: getattr(images, name) for name in names}


def _buffer(episode: Episode, with_state: bool) -> EpisodeBuffer:
    parts: dict[str, Any] = dict(episode.pictures)
    if with_state:
        parts["observation"] = episode.observation
    if episode.achieved_goal.shape[1]:
        parts |= {name: getattr(episode, name) for name in ("achieved_goal", "desired_goal")}
    observations: object = parts["observation"] if parts.keys() == {"observation"} else parts
    return EpisodeBuffer(
        seed=episode.seed,
        observations=observations,
        actions=episode.action,
        rewards=episode.reward.tolist(),
        terminations=episode.terminated.tolist(),
        truncations=episode.truncated.tolist(),
        infos={
            "is_success": np.concatenate(([False], episode.is_success)),
            "expert_stage": episode.stage,
        },
    )
