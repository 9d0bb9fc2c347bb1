"""Demonstrations as a Minari data set."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

import gymnasium as gym
import h5py  # noqa: F401 - Minari asks for it only when it writes
import numpy as np
from minari.data_collector import EpisodeBuffer
from minari.dataset.minari_storage import MinariStorage

import trocar
from trocar._goal import action_space, observation_space
from trocar._trocar import TaskSpec
from trocar.demos._episodes import Episode
from trocar.registration import NAMESPACE

if TYPE_CHECKING:
    from trocar.demos._record import Recipe

BY = ("scripted expert", "driver, a person")
"""Whose episodes they are."""


def write(folder: Path, recipe: Recipe, task: TaskSpec, episodes: Iterator[Episode]) -> None:
    """Writes episodes to ``folder``, in the place of a data set of Minari's.

    Infos of a step are ``is_success`` and ``expert_stage``, with a first row for the reset. The
    metadata hold the recipe under ``trocar``, and the names of the stages.
    """
    spec = gym.spec(f"{NAMESPACE}/{recipe.task}")
    spec.kwargs = {**spec.kwargs, **recipe.options}
    data = (folder / "data").absolute()  # Minari joins a relative one to itself
    data.mkdir(parents=True)
    storage = MinariStorage.new(
        data,
        observation_space=observation_space(task),
        action_space=action_space(task),
        env_spec=spec,
        data_format="hdf5",
    )
    name = folder.name.removesuffix(".whole")
    kept = "all episodes" if recipe.keeps_failures else "successful episodes only"
    storage.update_metadata(
        {
            "dataset_id": f"{NAMESPACE}/{recipe.task}/{name}",
            "algorithm_name": BY[recipe.by_hand],
            "author": {"Trocar"},
            "description": f"{recipe.task}, by its {BY[recipe.by_hand]}, {kept}",
            "minari_version": version("minari"),
            "requirements": [f"trocar=={trocar.__version__}"],
            "trocar": json.dumps({**asdict(recipe), "stages": trocar.STAGES}),
        }
    )
    storage.update_episodes(_buffer(episode) for episode in episodes)


def _buffer(episode: Episode) -> EpisodeBuffer:
    observations: object = episode.observation
    if episode.achieved_goal.shape[1]:
        names = ("observation", "achieved_goal", "desired_goal")
        observations = {name: getattr(episode, name) for name in names}
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
