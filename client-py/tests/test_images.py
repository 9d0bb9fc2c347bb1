"""Pictures as observations: spaces, kinds, cameras, views of shared memory."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import trocar

EVERYTHING = ("state", "rgb", "depth", "mask", "points")
SIZE = (24, 40)


def make(task: str, **options: Any) -> Any:
    return gym.make(f"trocar/{task}", image_size=SIZE, **options)


def test_every_kind_is_in_its_space() -> None:
    env = make("NeedlePick-v0", observation=EVERYTHING)
    observation, _ = env.reset(seed=3)
    assert observation in env.observation_space
    shapes = {name: (array.dtype.name, array.shape) for name, array in observation.items()}
    height, width = SIZE
    assert shapes["rgb"] == ("uint8", (height, width, 3))
    assert shapes["depth"] == ("float32", (height, width, 1))
    assert shapes["mask"] == ("int32", (height, width))
    assert shapes["points"] == ("float32", (height * width, 3))
    assert {"observation", "achieved_goal", "desired_goal"} < shapes.keys()
    observation, *_ = env.step(env.action_space.sample())
    assert observation in env.observation_space
    env.close()


def test_depth_mask_and_points_belong_together() -> None:
    env = make("StaticTrack-v0", observation=("depth", "mask", "points"))
    observation, _ = env.reset(seed=5)
    assert observation.keys() == {"depth", "mask", "points", "achieved_goal", "desired_goal"}
    images = env.unwrapped.task_spec.images
    fx, fy, cx, cy = images.intrinsics
    rows, columns = np.mgrid[0 : SIZE[0], 0 : SIZE[1]]
    depth = observation["depth"][..., 0]
    expected = np.stack([(columns - cx) / fx * depth, (rows - cy) / fy * depth, depth], -1)
    np.testing.assert_allclose(observation["points"], expected.reshape(-1, 3), rtol=1e-5, atol=1e-6)
    assert (depth[observation["mask"] == 0] == images.far).all()
    assert "target" in {images.bodies[body - 1] for body in np.unique(observation["mask"]) if body}
    env.close()


def test_stereo_gives_two_of_each() -> None:
    env = make("PegTransfer-v0", observation=("rgb", "depth"), camera="stereo")
    observation, _ = env.reset(seed=1)
    names = {"rgb_left", "rgb_right", "depth_left", "depth_right"}
    assert observation.keys() == names | {"achieved_goal", "desired_goal"}
    assert (observation["rgb_left"] != observation["rgb_right"]).any()
    assert observation in env.observation_space
    env.close()


def test_a_camera_can_be_placed() -> None:
    eye, target = (0.5, -0.25, 1.0), (0.5, 0.0, 0.7)
    env = make(
        "NeedlePick-v0",
        observation=("mask", "points"),
        camera="placed",
        camera_eye=eye,
        camera_target=target,
        camera_view=40.0,
    )
    observation, _ = env.reset(seed=2)
    images = env.unwrapped.task_spec.images
    (camera_from_world,) = np.array(images.camera_from_world)
    turn, shift = camera_from_world[:, :3], camera_from_world[:, 3]
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(turn @ eye + shift, np.zeros(3), atol=1e-12)
    distance = np.linalg.norm(np.subtract(target, eye))
    np.testing.assert_allclose(turn @ target + shift, [0.0, 0.0, float(distance)], atol=1e-12)
    assert images.intrinsics[1] == pytest.approx(SIZE[0] / 2 / np.tan(np.radians(20)))
    # What lies on the pad lies at one height in the world.
    pad = images.bodies.index("pad") + 1
    on_pad = (observation["points"][observation["mask"].ravel() == pad] - shift) @ turn
    assert len(on_pad) > 20
    assert np.ptp(np.percentile(on_pad[:, 2], (10, 90))) < 1e-3
    env.close()


def test_a_camera_that_moves_has_no_place() -> None:
    for task, places in (("StaticTrack-v0", 0), ("NeedlePick-v0", 2)):
        env = make(task, observation=("rgb",), camera="stereo")
        assert len(env.unwrapped.task_spec.images.camera_from_world) == places
        env.close()


@pytest.mark.parametrize("task", ["StaticTrack-v0", "ActiveTrack-v0"])
def test_a_target_can_be_perceived(task: str) -> None:
    perceived = gym.make(f"trocar/{task}", observation=("perceived",))
    known = gym.make(f"trocar/{task}")
    assert perceived.observation_space == known.observation_space
    (seen, _), (known_of, _) = perceived.reset(seed=4), known.reset(seed=4)
    if isinstance(seen, dict):
        np.testing.assert_array_equal(seen["achieved_goal"], known_of["achieved_goal"])
        seen, known_of = seen["observation"], known_of["observation"]
    assert seen[6] == 1
    assert (seen[7:9] != known_of[7:9]).any()
    np.testing.assert_allclose(seen[7:9], known_of[7:9], atol=0.1)
    np.testing.assert_array_equal(np.delete(seen, [7, 8]), np.delete(known_of, [7, 8]))
    perceived.close()
    known.close()


def test_tasks_without_goals_return_dictionaries_with_pictures() -> None:
    env = make("ActiveTrack-v0", observation=("state", "rgb"))
    observation, _ = env.reset(seed=1)
    assert observation.keys() == {"observation", "rgb"}
    env.close()
    env = make("ActiveTrack-v0", observation=("rgb",))
    observation, _ = env.reset(seed=1)
    assert observation.keys() == {"rgb"}
    assert observation in env.observation_space
    env.close()


def test_gymnasiums_checker_accepts_pictures() -> None:
    env = make("EcmReach-v0", observation=("state", "rgb", "depth", "mask"))
    check_env(env.unwrapped, skip_render_check=True)
    env.close()


def test_vectors_show_what_single_environments_show() -> None:
    options: dict[str, Any] = {"observation": EVERYTHING, "image_size": SIZE}
    envs = gym.make_vec("trocar/NeedleReach-v0", num_envs=3, **options)
    observations, _ = envs.reset(seed=9)
    assert observations in envs.observation_space
    actions = np.tile(np.array([1, 0, 0, 0, 0], np.float32), (3, 1))
    observations, *_ = envs.step(actions)
    assert observations in envs.observation_space
    for index in range(3):
        env = gym.make("trocar/NeedleReach-v0", **options)
        env.reset(seed=9 + index)
        expected, *_ = env.step(actions[index])
        for name, array in expected.items():
            np.testing.assert_array_equal(observations[name][index], array, name)
        env.close()
    envs.close()


def test_the_last_pictures_of_an_episode_are_in_final_obs() -> None:
    envs = gym.make_vec(
        "trocar/EcmReach-v0",
        num_envs=2,
        observation=("state", "rgb"),
        image_size=SIZE,
        autoreset_mode="same_step",
    )
    envs.reset(seed=2)
    for _ in range(50):
        observations, _, _, truncated, infos = envs.step(np.full((2, 3), 0.2, np.float32))
    assert truncated.all()
    for row in range(2):
        last = infos["final_obs"][row]
        assert last.keys() == observations.keys()
        assert last["rgb"].shape == (*SIZE, 3)
        assert (last["rgb"] != observations["rgb"][row]).any()
    envs.close()


def test_in_a_cavity_the_same_bodies_are_darker() -> None:
    rgb, mask = {}, {}
    for look in ("bench", "cavity"):
        env = make("NeedlePick-v0", observation=("rgb", "mask"), look=look)
        observation, _ = env.reset(seed=1)
        rgb[look], mask[look] = observation["rgb"], observation["mask"]
        env.close()
    assert (mask["bench"] == mask["cavity"]).all()
    assert 0 < rgb["cavity"].mean() < rgb["bench"].mean()


def test_without_a_copy_pictures_lie_in_shared_memory() -> None:
    env = make("NeedleReach-v0", observation=("state", "rgb"), copy=False)
    observation, _ = env.reset(seed=0)
    assert not observation["rgb"].flags.owndata
    assert not observation["rgb"].flags.writeable
    env.close()


@pytest.mark.parametrize(
    "options",
    [
        {"image_size": (12.5, 20)},
        {"image_size": (4, 4)},
        {"camera": "ceiling"},
        {"look": "night"},
        {"camera_eye": (1.0, 1.0), "camera": "placed"},
        {"camera_eye": (1.0, 1.0, 1.0), "camera": "placed", "camera_target": (1.0, 1.0, 1.0)},
        {"camera_view": 180.0, "camera": "placed"},
        {"observation": ("perceived",)},
    ],
)
def test_what_is_not_allowed_is_refused(options: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=next(iter(options))):
        trocar.TrocarEnv("NeedleReach-v0", **{"observation": ("rgb",), **options})
