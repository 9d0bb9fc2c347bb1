"""Pictures on demand: ``render_mode`` of single and vector environments."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.wrappers import RecordEpisodeStatistics, RenderCollection

import trocar
from trocar.errors import ResetNeeded

SMALL = {"image_size": (24, 32)}


def test_pictures_show_the_present_state(server: str) -> None:
    env: Any = gym.make("trocar/NeedleReach-v0", server=server, render_mode="rgb_array")
    env.reset(seed=2)
    first = env.render()
    assert isinstance(first, np.ndarray)
    assert (first.dtype, first.shape) == (np.uint8, (480, 640, 3))
    assert first.std() > 5.0
    assert (env.render() == first).all()
    env.step(np.ones(5, np.float32))
    assert (env.render() != first).any()
    env.reset(seed=2)
    assert (env.render() == first).all()
    env.close()


@pytest.mark.parametrize(
    ("task", "options", "fps"),
    [
        ("NeedleReach-v0", {}, 5),
        ("NeedleReach-v0", {"rate": 20.0}, 20),
        ("ActiveTrack-v0", {}, 10),
        ("ActiveTrack-v0", {"rate": 60.0}, 60),
    ],
)
def test_recordings_are_as_fast_as_the_simulated_time(
    server: str, task: str, options: dict[str, Any], fps: int
) -> None:
    env = trocar.TrocarEnv(task, server=server, render_mode="rgb_array", **options)
    assert env.metadata["render_fps"] == fps
    env.close()
    envs = trocar.TrocarVectorEnv(task, num_envs=2, server=server, **options)
    assert envs.metadata["render_fps"] == fps
    envs.close()


def test_depth_is_what_observations_of_depth_have(server: str) -> None:
    view: dict[str, Any] = {"image_size": (24, 32), "camera": "overview"}
    env = trocar.TrocarEnv(
        "NeedlePick-v0",
        server=server,
        observation=("depth",),
        render_mode="depth_array",
        render_options=view,
        **view,
    )
    observation, _ = env.reset(seed=1)
    picture = env.render()
    assert picture is not None
    assert (picture.dtype.name, picture.shape) == ("float32", (24, 32))
    # Pictures for people have smooth edges, and everything else the same.
    assert np.median(np.abs(picture - observation["depth"][..., 0])) < 1e-4
    env.close()


def test_rendering_changes_nothing(server: str) -> None:
    def course(mode: str | None) -> list[bytes]:
        options = None if mode is None else SMALL
        env = trocar.TrocarEnv(
            "NeedlePick-v0", server=server, render_mode=mode, render_options=options
        )
        env.reset(seed=7)
        env.action_space.seed(7)
        seen = []
        for _ in range(12):
            observation, *_ = env.step(env.action_space.sample())
            seen.append(observation["observation"].tobytes())
            env.render()
        env.close()
        return seen

    assert course(None) == course("rgb_array") == course("depth_array")


def test_vector_environments_give_a_picture_of_each(server: str) -> None:
    envs: Any = gym.make_vec(
        "trocar/NeedleReach-v0",
        num_envs=3,
        server=server,
        render_mode="rgb_array",
        render_options={**SMALL, "camera": "endoscope"},
    )
    envs.reset(seed=4)
    pictures = envs.render()
    assert isinstance(pictures, tuple)
    assert [picture.shape for picture in pictures] == [(24, 32, 3)] * 3
    assert (pictures[0] != pictures[1]).any()
    single: Any = trocar.TrocarEnv(
        "NeedleReach-v0",
        server=server,
        render_mode="rgb_array",
        render_options={**SMALL, "camera": "endoscope"},
    )
    single.reset(seed=5)
    assert (single.render() == pictures[1]).all()
    assert len(envs.call("render")) == 3
    single.close()
    envs.close()


def test_gymnasiums_wrappers_collect_pictures(server: str) -> None:
    env = gym.make(
        "trocar/EcmReach-v0", server=server, render_mode="rgb_array", render_options=SMALL
    )
    collected = RecordEpisodeStatistics(RenderCollection(env))
    collected.reset(seed=0)
    for _ in range(3):
        collected.step(collected.action_space.sample())
    frames = collected.render()
    assert isinstance(frames, list)
    assert len(frames) == 4
    collected.close()


def test_without_a_mode_nothing_is_drawn_and_without_a_state_it_is_said(server: str) -> None:
    env = trocar.TrocarEnv("NeedleReach-v0", server=server)
    env.reset(seed=0)
    assert env.render() is None
    env.close()
    env = trocar.TrocarEnv("NeedleReach-v0", server=server, render_mode="rgb_array")
    with pytest.raises(ResetNeeded, match="reset"):
        env.render()
    env.close()


def test_views_that_cannot_be_are_refused(server: str) -> None:
    views: list[tuple[dict[str, Any], str]] = [
        ({"image_size": (4, 4)}, "image_size"),
        ({"camera": "kitchen"}, "endoscope"),
        ({"zoom": 2.0}, "zoom"),
    ]
    for wrong, words in views:
        with pytest.raises(ValueError, match=words):
            trocar.TrocarEnv(
                "NeedleReach-v0", server=server, render_mode="rgb_array", render_options=wrong
            )


def test_many_pictures_take_no_more_memory_than_is_counted(own_server: trocar.Server) -> None:
    # As the server names its shared memory: by the FNV-1a hash of its folder's name.
    number = 0x811C9DC5
    for byte in f"trocar.{os.getuid()}.{own_server.name}".encode():
        number = (number ^ byte) * 0x01000193 % 2**32

    def pieces() -> list[int]:
        paths = Path("/dev/shm").glob(f"trocar-{number:08x}.*")
        return [path.stat().st_blocks * 512 for path in paths]

    # A session stays, and with it what a client takes besides.
    other = trocar.TrocarEnv("NeedleReach-v0", server=own_server.name)
    other.reset(seed=0)
    before, counted_before = sum(pieces()), own_server.status()["memory_bytes"]
    env = trocar.TrocarEnv("NeedleReach-v0", server=own_server.name, render_mode="rgb_array")
    env.reset(seed=0)
    counted = own_server.status()["memory_bytes"] - counted_before
    for _ in range(20):
        env.render()
    assert sum(pieces()) - before < counted
    assert max(pieces()) > 480 * 640 * 3
    other.close()
    env.close()
