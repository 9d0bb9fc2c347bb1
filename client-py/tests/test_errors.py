"""Bad input gets an error that names the field, the value and what is allowed, and does no harm."""

from __future__ import annotations

import pickle
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from test_env import constant, make, same
from test_vector import make_vec

import trocar
from trocar import errors


def refused(error: type[Exception], *parts: str) -> Any:
    """Expects an error of that type whose message has all of these parts."""
    return pytest.raises(error, match="".join(f"(?=.*(?:{part}))" for part in parts))


def test_unknown_task(server: str) -> None:
    with refused(errors.UnknownTask, "task", "NeedleReech", "NeedleReach-v0", "EcmReach-v0"):
        trocar.TrocarEnv("NeedleReech-v0", server=server)


def test_unknown_option(task: str, server: str) -> None:
    for make_any in (make, make_vec):
        with refused(ValueError, "options.rewards", "dense", "reward", "action"):
            make_any(task, server, rewards="dense")


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        ("shaped", "shaped"),
        (1.5, "1.5"),
        (np.float32(2), "2"),
        (True, "true"),
        ([1, 2], "1.0, 2.0"),
        (np.array([1.0, 2.0]), "1.0, 2.0"),
        (("a", "b"), "a.*b"),
        ({"x": 1.0, "y": [1, 2]}, "x.*1.0.*y.*2.0"),
        (object, "object"),
        (None, "None"),
    ],
)
def test_option_with_a_value_that_is_not_allowed(value: Any, shown: str, server: str) -> None:
    with refused(errors.InvalidOption, r"options\.reward", shown) as caught:
        make("NeedleReach-v0", server, reward=value)
    assert caught.value.field == "options.reward"
    assert caught.value.allowed


@pytest.mark.parametrize("num_envs", [0, -3, 5000, 2**40])
def test_zero_or_too_many_environments(num_envs: int, server: str) -> None:
    with refused(errors.InvalidEnvCount, "envs", str(num_envs), "4096"):
        make_vec("NeedleReach-v0", server, num_envs)


def test_wrong_actions_change_nothing(task: str, server: str) -> None:
    env, untouched = make(task, server), make(task, server)
    env.reset(seed=0)
    untouched.reset(seed=0)
    good = constant(env, 0.3)
    shapes: list[tuple[Any, str]] = [
        (good[1:], rf"\({good.size - 1},\)"),
        (np.tile(good, (2, 1)), rf"\(2, {good.size}\)"),
        (np.float32(0), r"\(\)"),
        ("left", "left"),
        ([[1.0], [2.0, 3.0]], "3.0"),
        (None, "None"),
    ]
    for bad, shown in shapes:
        with refused(errors.InvalidAction, "action", shown):
            env.step(bad)
    for number in (np.nan, np.inf, -np.inf, 1e300):
        bad = np.array(good, np.float64)
        bad[-1] = number
        with refused(errors.InvalidAction, "action", "nan|NaN|inf", "finite"):
            env.step(bad)
    assert same(env.step(good)[0], untouched.step(good)[0])
    env.close()
    untouched.close()


def test_a_wrong_row_among_many_changes_nothing(task: str, server: str) -> None:
    envs, untouched = make_vec(task, server, 8), make_vec(task, server, 8)
    envs.reset(seed=0)
    untouched.reset(seed=0)
    good = constant(envs, 0.3)
    bad = good.copy()
    bad[6, 1 % good.shape[1]] = np.nan
    with refused(errors.InvalidAction, "action", "NaN|nan", "finite"):
        envs.step(bad)
    with refused(errors.InvalidAction, "action", rf"\(7, {good.shape[1]}\)"):
        envs.step(good[:7])
    assert same(envs.step(good)[0], untouched.step(good)[0])
    envs.close()
    untouched.close()


def test_step_before_reset_and_after_the_end(task: str, server: str) -> None:
    env = make(task, server)
    action = env.action_space.sample()
    with pytest.raises(gym.error.ResetNeeded) as caught:
        env.step(action)
    assert isinstance(caught.value, trocar.TrocarError)
    env.reset(seed=0)
    while not any(env.step(action)[2:4]):
        pass
    with pytest.raises(gym.error.ResetNeeded):
        env.step(action)
    env.reset()
    env.step(action)
    env.close()


def test_wrong_seeds(server: str) -> None:
    env = make("EcmReach-v0", server)
    envs = make_vec("EcmReach-v0", server, 2)
    wrong: list[Any] = [-1, -(2**70), 0.5, "a"]
    for seed in wrong:
        with refused(ValueError, "seed", str(seed)):
            env.reset(seed=seed)
    wrong = [-1, [1], [1, -2], [1, 0.5], [[1, 2], [3, 4]], [1, [2, 3]]]
    for seed in wrong:
        with refused(ValueError, "seed"):
            envs.reset(seed=seed)
    env.close()
    envs.close()


def test_wrong_reset_options(server: str) -> None:
    env = make("EcmReach-v0", server)
    envs = make_vec("EcmReach-v0", server, 2)
    envs.reset(seed=0)
    with refused(ValueError, "options.goal", "expected numbers"):
        env.reset(options={"goal": 1})
    for options in (
        {"goal": 1},
        {"reset_mask": [1, 0]},
        {"reset_mask": np.array([False, False])},
        {"reset_mask": np.array([True])},
    ):
        with refused(ValueError, "options", "expected"):
            envs.reset(options=options)
    env.close()
    envs.close()


@pytest.mark.parametrize("env_ids", [[], [3], [-1], [1, 0], [1, 1], [[0]], [0.5], ["a"]])
def test_wrong_environment_numbers(env_ids: Any, server: str) -> None:
    envs = make_vec("EcmReach-v0", server, 3)
    envs.reset(seed=0)
    actions = np.zeros((len(env_ids), 3), np.float32)
    with refused(errors.InvalidEnvIds, "env_ids", "increasing numbers below 3"):
        envs.send(actions, env_ids)
    envs.close()


def test_environments_under_way_cannot_be_sent_again(server: str) -> None:
    envs = make_vec("EcmReach-v0", server, 3)
    envs.reset(seed=0)
    envs.send(np.zeros((2, 3), np.float32), [0, 1])
    with pytest.raises(errors.InvalidEnvIds, match="env_ids = 1"):
        envs.send(np.zeros((2, 3), np.float32), [1, 2])
    envs.recv()
    envs.step(np.zeros((3, 3), np.float32))
    envs.close()


def test_wrong_arguments_of_vector_environments(server: str) -> None:
    with refused(ValueError, "autoreset_mode", "sometimes", "same_step"):
        make_vec("EcmReach-v0", server, autoreset_mode="sometimes")
    with refused(ValueError, "max_episode_steps", "7", "50"):
        make_vec("EcmReach-v0", server, max_episode_steps=7)
    with refused(ValueError, "render_mode", "ansi"):
        make_vec("EcmReach-v0", server, render_mode="ansi")


def test_no_server_of_that_name() -> None:
    with refused(errors.NoServer, "nobody-is-here", "trocar serve --name nobody-is-here"):
        make("EcmReach-v0", "nobody-is-here")
    with refused(ValueError, "^server = ", "a/b"):
        make("EcmReach-v0", "a/b")


def test_a_name_in_use_is_refused(own_server: trocar.Server) -> None:
    with refused(errors.LaunchError, own_server.name, str(own_server.pid)):
        trocar.Server(name=own_server.name).start()
    assert own_server.status()["sessions"] == []


def test_wrong_server_arguments_are_quoted() -> None:
    with refused(errors.LaunchError, "--threads", "many"):
        trocar.Server(threads="many").start()  # type: ignore[arg-type]


def test_a_missing_program_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TROCAR_BINARY", "/nowhere/trocar")
    with refused(errors.LaunchError, "/nowhere/trocar"):
        trocar.Server().start()


def test_a_full_memory_budget_harms_nobody() -> None:
    with trocar.Server(threads=1, memory="4MiB") as server:
        before = make_vec("EcmReach-v0", server.name, 8)
        before.reset(seed=0)
        with refused(MemoryError, "envs", "4096", "MiB", "--memory"):
            make_vec("EcmReach-v0", server.name, 4096)
        before.step(np.zeros((8, 3), np.float32))
        before.close()


def test_errors_survive_pickling(server: str) -> None:
    with pytest.raises(errors.InvalidOption) as caught:
        make("EcmReach-v0", server, reward="shaped")
    copied = pickle.loads(pickle.dumps(caught.value))
    assert type(copied) is errors.InvalidOption
    assert str(copied) == str(caught.value)
    assert copied.allowed == caught.value.allowed


def test_a_preset_of_domain_gives_rows_and_an_unknown_one_is_refused(server: str) -> None:
    def made(**domain: Any) -> gym.Env[Any, Any]:
        return gym.make("trocar/NeedlePick-v0", server=server, domain=domain)

    preset, without_base, none = (
        made(preset="dvrk"),
        made(preset="dvrk", base_position=(0, 0)),
        made(),
    )
    envs = [preset, without_base, none]
    seen = [env.reset(seed=3)[0]["observation"] for env in envs]
    action = np.full(5, 0.5, np.float32)
    later = [env.step(action)[0]["observation"] for env in envs]
    # Encoders begin at the same place, and lag.
    assert all(same(seen[0], other) for other in seen)
    assert not same(later[0], later[2])
    with refused(errors.InvalidOption, "options.domain.preset", "raven", "dvrk"):
        made(preset="raven")
    with refused(errors.InvalidOption, "options.domain.lag_yaw", "3"):
        made(preset="dvrk", lag_yaw=(0.0, 3.0))
    with refused(errors.InvalidOption, "options.domain", "7"):
        made(preset=7)
    for env in envs:
        env.close()
