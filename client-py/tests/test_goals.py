"""Rewards as pure functions of goals."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from conftest import WITHOUT_GOALS
from test_env import make
from test_vector import make_vec

import trocar

METHODS = ("compute_reward", "compute_success", "compute_terminated", "compute_truncated")


@pytest.fixture(params=["sparse", "dense"])
def env(request: pytest.FixtureRequest, goal_task: str, server: str) -> trocar.TrocarEnv:
    return trocar.TrocarEnv(goal_task, server=server, reward=request.param, expert=True)


def test_computed_rewards_are_those_of_the_steps(env: trocar.TrocarEnv) -> None:
    env.reset(seed=2)
    observations, rewards, successes = [], [], []
    truncated = False
    while not truncated:
        observation, reward, terminated, truncated, info = env.step(env.expert_action())
        assert not terminated
        observations.append(observation)
        rewards.append(reward)
        successes.append(info["is_success"])
        pair = observation["achieved_goal"], observation["desired_goal"]
        assert env.compute_reward(*pair, info) == reward
        assert env.compute_success(*pair) == info["is_success"]
        assert not env.compute_terminated(*pair, info)
        assert not env.compute_truncated(*pair, {})
    assert any(successes)
    achieved = np.array([observation["achieved_goal"] for observation in observations])
    desired = np.array([observation["desired_goal"] for observation in observations])
    expected = np.array(rewards, np.float32)
    batches: list[Any] = [[{}] * len(rewards), {}, np.array([{}] * len(rewards))]
    for infos in batches:
        computed = env.compute_reward(achieved, desired, infos)
        assert computed.dtype == np.float32
        assert computed.tobytes() == expected.tobytes()
    wide = env.compute_reward(achieved.astype(np.float64), desired.astype(np.float64), {})
    assert wide.tobytes() == expected.tobytes()
    strided = env.compute_reward(achieved[::2], desired[::2], {})
    assert strided.tobytes() == expected[::2].tobytes()
    env.close()


def test_batches_keep_their_shape(env: trocar.TrocarEnv) -> None:
    dim = len(env.task_spec.goal or ())
    goals = np.zeros((4, 6, dim), np.float32)
    assert env.compute_reward(goals, goals, {}).shape == (4, 6)
    assert env.compute_success(goals, goals).all()
    assert env.compute_terminated(goals, goals, {}).dtype == np.bool_
    assert env.compute_truncated(goals, goals, {}).shape == (4, 6)
    assert env.compute_reward(goals[:0], goals[:0], {}).shape == (0, 6)
    assert np.ndim(env.compute_reward(goals[0, 0], goals[0, 0], {})) == 0
    assert env.compute_reward(goals[0, 0].tolist(), goals[0, 0].tolist(), {}) == 0
    env.close()


@pytest.mark.parametrize("task", WITHOUT_GOALS)
def test_a_task_without_goals_has_no_functions_of_them(task: str, server: str) -> None:
    single, envs = make(task, server), make_vec(task, server, 2)
    assert single.task_spec.goal is None
    assert single.task_spec.reward == "state"
    wrapped = gym.wrappers.TimeLimit(gym.make(f"trocar/{task}", server=server), 3)
    wrapped_envs = gym.wrappers.vector.RecordEpisodeStatistics(make_vec(task, server, 2))
    for name in METHODS:
        for env in (single, envs, wrapped, wrapped.unwrapped, wrapped_envs, wrapped_envs.unwrapped):
            assert not hasattr(env, name)
        assert not wrapped.has_wrapper_attr(name)
        with pytest.raises(AttributeError, match=f"{task}.*{name}"):
            envs.get_attr(name)
        with pytest.raises(AttributeError, match=f"{task}.*{name}"):
            envs.call(name, np.zeros(3), np.zeros(3))
    for each in (single, envs, wrapped, wrapped_envs):
        each.close()


def test_tasks_with_goals_have_functions_of_them(goal_task: str, server: str) -> None:
    single, envs = make(goal_task, server), make_vec(goal_task, server, 2)
    for name in METHODS:
        assert callable(getattr(single, name))
        assert envs.get_attr(name) == (getattr(envs, name),) * 2
        assert getattr(trocar.TrocarEnv, name).__doc__
    assert gym.make(f"trocar/{goal_task}", server=server).has_wrapper_attr("compute_reward")
    single.close()
    envs.close()


def test_wrong_shapes_are_refused(env: trocar.TrocarEnv) -> None:
    dim = len(env.task_spec.goal or ())
    goal = np.zeros((2, dim), np.float32)
    for achieved, desired, field in (
        (goal[:, 1:], goal[:, 1:], "achieved_goal"),
        (goal, goal[:1], "desired_goal"),
        (np.float32(1), goal, "achieved_goal"),
        ("near", goal, "achieved_goal"),
    ):
        with pytest.raises(ValueError, match=field):
            env.compute_reward(achieved, desired, {})
    env.close()


def test_rewards_of_replaced_goals_are_refused_beside_relative_features(server: str) -> None:
    env = make("NeedleReach-v0", server, observation=("relative",))
    observation, _ = env.reset(seed=0)
    goals = observation["achieved_goal"], observation["desired_goal"]
    assert env.compute_reward(*goals, {}) == -1.0
    # As hindsight replay of Stable-Baselines3 asks, also for one transition.
    with pytest.raises(ValueError, match=r"options\.observation.*trocar\.features"):
        env.compute_reward(goals[0][None], goals[0][None], [{}])
    env.close()
