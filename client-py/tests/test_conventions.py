"""What other libraries probe before they use an environment."""

from __future__ import annotations

import copy
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from conftest import Interrupted
from test_env import constant, make, same
from test_vector import actions_of, make_vec

import trocar
from trocar import errors
from trocar.registration import TASKS


def shape_of(infos: dict[str, Any]) -> dict[str, Any]:
    """What a recorder allocates for infos: keys, types and shapes."""
    return {
        name: shape_of(value)
        if isinstance(value, dict)
        else (type(value), np.asarray(value).dtype, np.shape(value))
        for name, value in infos.items()
    }


@pytest.mark.parametrize("expert", [False, True])
def test_infos_of_resets_and_steps_have_one_shape(task: str, expert: bool, server: str) -> None:
    env = gym.make(f"trocar/{task}", server=server, expert=expert)
    expected = shape_of(env.reset(seed=0)[1])
    assert {"is_success", "episode_seed"} <= expected.keys()
    assert ("expert_action" in expected) == ("expert_stage" in expected) == expert
    for _ in range(TASKS[task]):
        *_, terminated, truncated, info = env.step(env.action_space.sample())
        assert shape_of(info) == expected
        assert info["episode_seed"] == 0
        if terminated or truncated:
            break
    assert shape_of(env.reset()[1]) == expected
    env.close()


@pytest.mark.parametrize("mode", ["next_step", "same_step", "disabled"])
@pytest.mark.parametrize("expert", [False, True])
def test_infos_of_vectors_have_one_shape(mode: str, expert: bool, server: str) -> None:
    envs = make_vec("EcmReach-v0", server, 3, autoreset_mode=mode, expert=expert)
    expected = shape_of(envs.reset(seed=0)[1])
    assert set(expected) >= {"is_success", "_is_success", "simulation_failed", "episode_index"}
    for step in range(55):
        *_, truncations, infos = envs.step(actions_of(envs, step))
        for name in ("final_obs", "final_info"):
            assert (name in infos) == (mode == "same_step" and bool(truncations.all()))
            infos.pop(name, None)
            infos.pop(f"_{name}", None)
        assert shape_of(infos) == expected
        assert all(infos[name].all() for name in infos if name.startswith("_"))
        if mode == "disabled" and truncations.all():
            break
    assert (
        shape_of(envs.reset(options={"reset_mask": np.array([True, False, True])})[1]) == expected
    )
    envs.reset()
    envs.send(actions_of(envs, 0)[:2], [0, 2])
    assert shape_of(envs.recv()[4]).keys() == expected.keys() | {"env_id"}
    envs.close()


def test_infos_of_the_last_step_are_those_of_the_episode_that_ended(server: str) -> None:
    envs = make_vec("EcmReach-v0", server, 2, autoreset_mode="same_step", expert=True)
    _, infos = envs.reset(seed=5)
    for _ in range(TASKS["EcmReach-v0"]):
        *_, infos = envs.step(infos["expert_action"])
    assert infos["episode_index"].tolist() == [1, 1]
    last = infos["final_info"]
    assert last["episode_index"].tolist() == [0, 0]
    assert last["episode_seed"].tolist() == [5, 6]
    assert last["is_success"].all()
    envs.close()


@pytest.mark.parametrize("value", [1, None, object(), np.zeros(2, complex), {"a": "b"}])
def test_unknown_keywords(value: Any, server: str) -> None:
    for make_any in (gym.make, gym.make_vec, trocar.TrocarEnv):
        name = "NeedleReach-v0" if make_any is trocar.TrocarEnv else "trocar/NeedleReach-v0"
        with pytest.raises(TypeError, match="unexpected keyword argument 'frameskip'") as caught:
            make_any(name, server=server, frameskip=value)
        assert isinstance(caught.value, errors.UnknownOption)
        assert isinstance(caught.value, ValueError)
        assert '"reward"' in str(caught.value)  # what there is


def test_known_keywords_with_wrong_values_are_no_unknown_ones(server: str) -> None:
    for value in (None, object(), 3):
        with pytest.raises(errors.InvalidOption, match=r"options\.reward = ") as caught:
            make("NeedleReach-v0", server, reward=value)
        assert not isinstance(caught.value, TypeError)


@pytest.mark.parametrize("steps", [51, 200, -1])
def test_longer_episodes_than_the_tasks_are_refused(steps: int, server: str) -> None:
    ways: list[dict[str, Any]] = [{}, {"vectorization_mode": "sync"}]
    for options in ways:
        with pytest.raises(errors.InvalidOption, match=f"max_episode_steps = {steps}: .*50"):
            gym.make_vec(
                "trocar/NeedleReach-v0", 2, max_episode_steps=steps, server=server, **options
            )
    with pytest.raises(errors.InvalidOption, match=f"max_episode_steps = {steps}: .*50") as caught:
        gym.make("trocar/NeedleReach-v0", max_episode_steps=steps, server=server)
    assert caught.value.field == "max_episode_steps"
    spec = copy.copy(gym.spec("trocar/NeedleReach-v0"))
    spec.max_episode_steps = steps
    with pytest.raises(errors.InvalidOption, match="max_episode_steps"):
        gym.make(spec, server=server)


def test_shorter_and_equal_episodes_are_honoured(server: str) -> None:
    for steps in (1, 7, 100):
        rate = 10 if steps > 50 else 5
        env = gym.make("trocar/NeedleReach-v0", max_episode_steps=steps, rate=rate, server=server)
        assert env.spec is not None
        assert env.spec.max_episode_steps == steps
        env.reset(seed=0)
        action = np.zeros(5, np.float32)
        assert [env.step(action)[3] for _ in range(steps)] == [False] * (steps - 1) + [True]
        env.close()
    envs = gym.make_vec("trocar/NeedleReach-v0", 2, max_episode_steps=50, server=server)
    envs.close()


def test_an_interrupted_step_can_be_followed_by_the_next(
    own_server: trocar.Server, interrupted: Interrupted
) -> None:
    name = own_server.name
    for envs, same_after in (
        (make("NeedleReach-v0", name), make("NeedleReach-v0", name)),
        (make_vec("NeedleReach-v0", name, 3), make_vec("NeedleReach-v0", name, 3)),
    ):
        action = constant(envs, 0.5)
        for each in (envs, same_after):
            each.reset(seed=0)
        interrupted(lambda: envs.step(action))  # noqa: B023
        same_after.step(action)  # it was carried out, and its reply is dropped
        assert same(envs.step(action)[0], same_after.step(action)[0])
        interrupted(lambda: envs.reset(seed=4))  # noqa: B023
        assert same(envs.reset(seed=4)[0], same_after.reset(seed=4)[0])
        for each in (envs, same_after):
            each.close()


def test_an_interrupted_receive_can_be_repeated_or_given_up(
    own_server: trocar.Server, interrupted: Interrupted
) -> None:
    envs, other = (make_vec("NeedleReach-v0", own_server.name, 3) for _ in range(2))
    actions = constant(envs, 0.5)
    for each in (envs, other):
        each.reset(seed=0)

    def send_and_receive() -> None:
        envs.send(actions)
        envs.recv()

    interrupted(send_and_receive)
    assert same(envs.recv()[0], other.step(actions)[0])
    interrupted(send_and_receive)
    other.step(actions)
    envs.drop_replies()
    envs.send(actions)
    assert same(envs.recv()[0], other.step(actions)[0])
    interrupted(send_and_receive)
    other.step(actions)
    envs.drop_replies()
    assert same(envs.step(actions)[0], other.step(actions)[0])
    envs.close()
    other.close()
