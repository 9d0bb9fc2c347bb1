"""Resets that say how the episode shall begin."""

from __future__ import annotations

import copy
import warnings
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from numpy.typing import NDArray

import trocar
from trocar import errors

GOAL = [0.55, -0.02, 0.73]
TIP = [0.56, 0.01, 0.72]


def make(task: str, server: str, **options: Any) -> trocar.TrocarEnv:
    return trocar.TrocarEnv(task, server=server, **options)


def make_vec(task: str, server: str, envs: int, **options: Any) -> trocar.TrocarVectorEnv:
    return trocar.TrocarVectorEnv(task, envs, server=server, **options)


def needles(server: str, seeds: range) -> NDArray[np.float64]:
    """Where the needles of these episodes lie: (seeds, 6)."""
    envs = make_vec("NeedlePick-v0", server, len(seeds))
    observation = envs.reset(seed=seeds[0])[0]["observation"]
    envs.close()
    return np.concatenate([observation[:, 7:10], observation[:, 16:19]], 1).astype(np.float64)


def test_an_episode_begins_as_it_is_asked_for_and_comes_again(server: str) -> None:
    (needle,) = needles(server, range(50, 51))
    env = make("NeedlePick-v0", server, expert=True)
    env.reset(seed=3)
    options = {"goal": GOAL, "objects": {"needle": needle}, "tip": np.array(TIP, np.float32)}
    observation, info = env.reset(seed=4, options=options)
    assert (info["episode_seed"], info["episode_index"]) == (4, 0)
    assert np.allclose(observation["desired_goal"], GOAL, atol=1e-6)
    assert np.allclose(observation["observation"][:3], [0.56, 0.01, 0.7302], atol=1e-6)
    assert np.allclose(observation["observation"][7:10], needle[:3], atol=1e-4)
    assert np.allclose(observation["observation"][16:19], needle[3:], atol=1e-2)
    snapshot = env.snapshot().to_bytes()
    again, _ = env.reset(seed=4, options=options)
    assert all((again[name] == observation[name]).all() for name in again)
    other = copy.deepcopy(env)
    rebuilt = other.restore(trocar.Snapshot.from_bytes(snapshot))
    assert all((rebuilt[name] == observation[name]).all() for name in rebuilt)
    success = False
    while not success:
        *_, truncated, info = env.step(env.expert_action())
        success = info["is_success"]
        assert success or not truncated
    # The next episode is as its seed has it.
    assert not np.allclose(env.reset()[0]["desired_goal"], GOAL)
    other.close()
    env.close()


def test_a_vector_takes_one_value_for_all_or_one_for_each(server: str) -> None:
    poses = needles(server, range(60, 63))
    goals = np.array([GOAL]) + np.array([[0], [1], [2]]) / 100
    envs = make_vec("NeedlePick-v0", server, 3)
    observation, infos = envs.reset(
        seed=1, options={"goal": goals.tolist(), "objects": {"needle": poses}, "tip": TIP}
    )
    assert infos["episode_seed"].tolist() == [1, 2, 3]
    assert np.allclose(observation["desired_goal"], goals, atol=1e-6)
    assert np.allclose(observation["observation"][:, 7:10], poses[:, :3], atol=1e-4)
    assert np.allclose(observation["observation"][:, 0], 0.56, atol=1e-6)

    single = make("NeedlePick-v0", server)
    options = {"goal": goals[1], "objects": {"needle": poses[1]}, "tip": TIP}
    alone, _ = single.reset(seed=2, options=options)
    assert all((alone[name] == observation[name][1]).all() for name in alone)
    single.close()

    mask = np.array([True, False, True])
    later, _ = envs.reset(options={"reset_mask": mask, "goal": goals})
    assert np.allclose(later["desired_goal"], goals, atol=1e-6)
    assert (later["observation"][1] == observation["observation"][1]).all()
    assert not (later["observation"][0] == observation["observation"][0]).all()
    envs.close()


def test_what_is_not_allowed_is_refused_by_name(server: str) -> None:
    env = make("NeedlePick-v0", server)
    cases: list[tuple[dict[str, Any], str]] = [
        ({"goal": [9, 9, 9]}, r"options\.goal = .*allowed is x in"),
        ({"goal": 1}, r"options\.goal = 1, int: expected numbers of shape \(n,\)"),
        ({"goal": ["a", "b", "c"]}, r"options\.goal = .*expected numbers"),
        ({"goal": [[1, 2], [3]]}, r"options\.goal = .*expected numbers"),
        ({"goal": [0.55, np.nan, 0.7]}, r"options\.goal = .*finite"),
        ({"objects": GOAL}, r"options\.objects = .*expected poses by name"),
        ({"objects": {"gauze": GOAL}}, r"""options\.objects = "gauze": .*it has \["needle"\]"""),
        ({"objects": {"needle": GOAL}}, r"options\.objects\.needle = .*does not rest there"),
        ({"objects": {"needle": [0.55, 0]}}, r"options\.objects\.needle = 2 numbers: expected 3"),
        ({"tip": [0.7, 0, 0.72]}, r"options\.tip = .*out of reach"),
        ({"tip": [TIP, TIP]}, r"options\.tip = .*expected numbers of shape \(n,\)"),
    ]
    for options, message in cases:
        with pytest.raises(errors.InvalidOption, match=message):
            env.reset(seed=5, options=options)
    env.close()

    envs = make_vec("BiPegTransfer-v0", server, 2)
    both = [[0.52, 0.02, 0.74], [0.52, -0.03, 0.74]]
    observation, _ = envs.reset(seed=0, options={"tip": both})
    assert np.allclose(observation["observation"][:, [7, 8]], [0.52, -0.03], atol=1e-6)
    with pytest.raises(ValueError, match=r"options\.tip = .*shape \(2, n\), or 2 such arrays"):
        envs.reset(options={"tip": both[0]})
    far = [both, [both[0], [0.9, 0, 0.74]]]
    with pytest.raises(ValueError, match=r"options\.tip\[env 1\] = .*out of reach"):
        envs.reset(options={"tip": far})
    envs.close()


def test_unknown_names_are_ignored_with_one_warning(server: str) -> None:
    env = make("EcmReach-v0", server)
    envs = make_vec("EcmReach-v0", server, 2)
    resets: list[Any] = [env, envs]
    for each in resets:
        expected = each.reset(seed=1)[0]
        with pytest.warns(UserWarning, match=r"ignored: \['x', 'y'\]") as caught:
            observation, _ = each.reset(seed=1, options={"y": 1, "x": 2})
        assert len(caught) == 1
        assert all((observation[name] == expected[name]).all() for name in expected)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            each.reset(options={"z": 1})
            each.reset(options={"goal": None})
        each.close()


def test_options_pass_through_gymnasium(server: str) -> None:
    env = gym.make("trocar/EcmReach-v0", server=server)
    observation, _ = env.reset(seed=1, options={"goal": [0.5, 0.02, 0.65]})
    assert np.allclose(observation["desired_goal"], [0.5, 0.02, 0.65], atol=1e-6)
    env.close()
