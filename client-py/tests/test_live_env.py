"""A task whose arms take commands of CRTK, as an environment of Gymnasium."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from trocar.dvrk import LiveEnv
from trocar.dvrk.env import between
from trocar.errors import InvalidAction, InvalidOption, ResetNeeded


@pytest.fixture
def reach(server: str) -> Iterator[LiveEnv]:
    """NeedleReach in lock-step."""
    env = LiveEnv("NeedleReach-v0", server=server)
    yield env
    env.close()


def played(server: str, task: str, seed: int, **options: Any) -> tuple[list[Any], list[Any]]:
    """The expert's actions in an episode, and what was observed."""
    env: Any = gym.make(f"trocar/{task}", server=server, expert=True, **options)
    seen, info = env.reset(seed=seed)
    actions, observations, is_over = [], [seen], False
    while not is_over:
        actions.append(info["expert_action"].copy())
        seen, _, terminated, truncated, info = env.step(actions[-1])
        observations.append(seen)
        is_over = terminated or truncated
    env.close()
    return actions, observations


def replay(env: LiveEnv, seed: int, actions: list[Any]) -> tuple[list[Any], list[float], Any]:
    """What is observed of the same actions here, their rewards, and the last info."""
    seen, info = env.reset(seed=seed)
    assert not info["is_intervention"]
    observations, rewards = [seen], []
    for index, action in enumerate(actions):
        seen, reward, terminated, truncated, info = env.step(action)
        observations.append(seen)
        rewards.append(reward)
        assert np.array_equal(info["action"], np.clip(action, -1.0, 1.0))
        assert not info["is_intervention"]
        assert (terminated, truncated) == (False, index + 1 == len(actions))
    return observations, rewards, info


@pytest.mark.parametrize("task", ["NeedleReach-v0", "MisOrient-v0", "NeedleRegrasp-v0"])
def test_arms_go_where_the_same_actions_bring_them_elsewhere(server: str, task: str) -> None:
    """Within what a robot's kinematics and the moment of homing leave."""
    actions, expected = played(server, task, 11)
    env = LiveEnv(task, server=server)
    # Before jaws meet anything, which gives way by a hair more or less.
    count = 6
    env.max_steps = count
    observed, _, _ = replay(env, 11, actions[:count])
    env.close()
    for step, (one, other) in enumerate(zip(observed, expected, strict=False)):
        assert one["observation"].shape == other["observation"].shape
        assert np.array_equal(one["desired_goal"], other["desired_goal"])
        assert np.abs(one["observation"][:3] - other["observation"][:3]).max() < 2e-4, step


@pytest.mark.grasp
@pytest.mark.parametrize("seed", range(3))
def test_a_needle_is_lifted_by_the_actions_that_lift_it_elsewhere(server: str, seed: int) -> None:
    actions, _ = played(server, "NeedlePick-v0", seed)
    env = LiveEnv("NeedlePick-v0", server=server)
    _, rewards, info = replay(env, seed, actions)
    assert info["is_success"]
    assert rewards[-1] == 0.0
    env.close()


def test_an_episode_has_the_same_bits_whatever_came_before(reach: LiveEnv, server: str) -> None:
    actions = [np.array([0.3, -0.2, 0.1, 0.5, -1.0], np.float32)] * 5
    reach.max_steps = len(actions)
    first, *_ = replay(reach, 3, actions)
    replay(reach, 4, actions)
    again, *_ = replay(reach, 3, actions)
    other = LiveEnv("NeedleReach-v0", server=server, max_steps=len(actions))
    fresh, *_ = replay(other, 3, actions)
    other.close()
    for one, two, three in zip(first, again, fresh, strict=True):
        for name, array in one.items():
            assert array.tobytes() == two[name].tobytes() == three[name].tobytes()


def test_gymnasiums_checker_is_content(server: str) -> None:
    env = LiveEnv("NeedleReach-v0", server=server, render_mode="rgb_array")
    check_env(env, skip_render_check=True, skip_close_check=True)
    picture = env.render()
    assert picture is not None
    assert picture.shape == (480, 640, 3)
    env.close()
    env.close()


def test_an_arm_without_an_action_holds(reach: LiveEnv) -> None:
    """And so is what was done: nothing, at the jaw that there is."""
    reach.reset(seed=0)
    before = reach.live.joints("PSM1")[0]
    *_, info = reach.step(None)
    assert np.array_equal(reach.live.joints("PSM1")[0], before)
    assert np.abs(info["action"][:4]).max() < 1e-6
    assert not reach.is_driven_by_person()


def test_what_cannot_be_is_refused(reach: LiveEnv, server: str) -> None:
    with pytest.raises(ResetNeeded):
        reach.step(np.zeros(5, np.float32))
    reach.reset(seed=0)
    for wrong in (np.zeros(4), np.full(5, np.nan), "five"):
        with pytest.raises(InvalidAction, match="action"):
            reach.step(wrong)
    for task, settings, field in (
        ("NeedleReach-v0", {"intervention": True}, "speed"),
        ("EcmReach-v0", {"intervention": True, "speed": 1.0}, "intervention"),
        ("NeedleReach-v0", {"max_steps": 0}, "max_steps"),
        ("NeedlePick-v0", {"grasp": "weld"}, "grasp"),
        ("NeedleReach-v0", {"render_mode": "human"}, "render_mode"),
    ):
        with pytest.raises(InvalidOption, match=field):
            LiveEnv(task, server=server, **settings)
    assert "token=" in reach.page


def test_questions_of_a_task_are_answered_or_refused(server: str) -> None:
    """The action between two set-points is the one that leads from one to the other."""
    env = LiveEnv("NeedlePick-v0", server=server)
    env.reset(seed=5)
    action = [0.4, -0.3, 0.2, 0.6, 1.0]
    here, _ = env.live.pose("PSM1", "setpoint_cp")
    there, why = env.live.ask("PSM1", "task/set_point", action)
    assert not why
    found, why = env.live.ask("PSM1", "task/action", [*here, 0.0], there)
    assert not why
    assert found == pytest.approx(action, abs=1e-5)
    for arm, question, numbers, more, words in (
        ("PSM1", "task/set_point", action[:4], [], "4 numbers, expected 5"),
        ("PSM1", "task/set_point", [float("nan")] * 5, [], "finite"),
        ("ECM", "task/set_point", action, [], "no action"),
        ("PSM1", "task/action", here, there, "7 numbers"),
        ("PSM1", "task/action", [*here, 0.0], [0.0] * 8, "quaternion"),
        ("ECM", "task/action", [*here, 0.0], there, "PSM"),
    ):
        answer, why = env.live.ask(arm, question, numbers, more)
        assert answer == []
        assert words in why
    env.close()


def test_set_points_go_smoothly_and_turn_evenly() -> None:
    start = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.5]
    end = [0.01, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0]
    assert between(start, end, 0.0) == pytest.approx(start)
    half = between(start, end, 0.5)
    assert half[:3] == pytest.approx([0.005, 0.0, 0.0])
    assert abs(half[5]) == pytest.approx(abs(half[6])) == pytest.approx(np.sqrt(0.5))
    assert half[7] == pytest.approx(0.25)
    assert between([0.0] * 4, [1.0] * 4, 0.5) == pytest.approx([0.5] * 4)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("goal", [0.55, 0.0, 0.73]),
        ("tip", [0.56, 0.01, 0.72]),
        ("objects", {"needle": [0.5, 0.0, 0.68]}),
        ("gaol", 1),
    ],
)
def test_reset_options_are_refused_by_name(reach: LiveEnv, name: str, value: Any) -> None:
    reach.reset(seed=1)
    with pytest.raises(ValueError, match=rf"options\.{name} = .*no reset options"):
        reach.reset(seed=2, options={name: value})
    reach.step(np.zeros(reach.action_space.shape, np.float32))
    reach.reset(seed=1, options={})
    reach.reset(seed=1, options={"goal": None})


@pytest.mark.parametrize("kind", ["rgb", "depth", "mask"])
def test_pictures_in_observations_are_refused(server: str, kind: str) -> None:
    with pytest.raises(ValueError, match=r"options\.observation = .*no pictures"):
        LiveEnv("NeedleReach-v0", server=server, observation=["state", kind])
