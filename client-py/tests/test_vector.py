"""Vector environments, against Gymnasium's own made of single ones."""

from __future__ import annotations

import pickle
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from test_env import same, state

import trocar
from trocar.registration import TAGS, TASKS
from trocar.vector import OUTCOME

MODES = ["next_step", "same_step", "disabled"]


def make_vec(task: str, server: str, num_envs: int = 4, **options: Any) -> trocar.TrocarVectorEnv:
    envs = gym.make_vec(f"trocar/{task}", num_envs=num_envs, server=server, **options)
    assert isinstance(envs, trocar.TrocarVectorEnv)
    return envs


def reference(task: str, server: str, num_envs: int, mode: str) -> SyncVectorEnv:
    """The same out of single environments, by Gymnasium."""
    return SyncVectorEnv(
        [lambda: trocar.TrocarEnv(task, server=server)] * num_envs,
        autoreset_mode=AutoresetMode[mode.upper()],
    )


def rows_of(observations: Any, rows: Any) -> Any:
    """Some rows of all arrays of observations."""
    if isinstance(observations, dict):
        return {name: array[rows] for name, array in observations.items()}
    return observations[rows]


def actions_of(envs: Any, seed: int) -> Any:
    return np.random.default_rng(seed).uniform(-1, 1, envs.action_space.shape).astype(np.float32)


def check_same_infos(infos: dict[str, Any], expected: dict[str, Any]) -> None:
    """Whatever Gymnasium's infos say, ours say; where an episode ended, also how the step did."""
    assert infos.keys() == expected.keys()
    if "final_info" in expected:
        ended, last = expected["_final_info"], expected["final_info"]
        for name in OUTCOME:
            expected[name] = np.where(ended, last[name], expected[name])
    for key, mask in expected.items():
        if not key.startswith("_"):
            continue
        name = key[1:]
        assert same(infos[key], mask), key
        if name == "final_info":
            check_same_infos(infos[name], expected[name])
        elif name == "final_obs":
            assert all(same(infos[name][row], expected[name][row]) for row in np.flatnonzero(mask))
            assert all(infos[name][row] is None for row in np.flatnonzero(~mask))
        else:
            assert same(infos[name][mask], expected[name][mask]), name


def check_same_step(step: Any, expected: Any) -> None:
    assert same(step[0], expected[0])
    assert step[1].dtype == np.float32
    assert (step[1] == expected[1]).all()
    assert same(step[2], expected[2])
    assert same(step[3], expected[3])
    check_same_infos(step[4], expected[4])


@pytest.mark.parametrize("mode", MODES)
def test_a_session_of_many_is_many_sessions_of_one(task: str, mode: str, server: str) -> None:
    envs = make_vec(task, server, 4, autoreset_mode=mode)
    singles = reference(task, server, 4, mode)
    assert envs.observation_space == singles.observation_space
    assert envs.action_space == singles.action_space
    assert envs.single_observation_space == singles.single_observation_space
    assert envs.metadata["autoreset_mode"] is AutoresetMode[mode.upper()]

    def reset(seed: Any, mask: Any) -> None:
        options = [None if mask is None else {"reset_mask": mask.copy()} for _ in range(2)]
        observations, infos = envs.reset(seed=seed, options=options[0])
        expected: Any
        expected, expected_infos = singles.reset(seed=seed, options=options[1])
        assert same(observations, expected)
        check_same_infos(infos, expected_infos)

    reset(7, None)
    for step in range(2 * TASKS[task] + 10):
        actions = actions_of(envs, step)
        values = envs.step(actions)
        check_same_step(values, singles.step(actions))
        ended = values[2] | values[3]
        if mode == "disabled" and ended.any():
            reset(None, ended)
        elif step == 11:
            reset(None, np.array([False, True, False, True]))
        elif step == 23:
            reset([3, None, 5, None], np.array([True, True, False, False]))
    reset([1, 2, 3, 4], None)
    reset([1, None, 3, None], None)
    reset(None, None)
    envs.close()
    singles.close()


def test_rows_do_not_depend_on_how_many_there_are(task: str, server: str) -> None:
    row = 5 if "tissue" in TAGS[task] else 40  # steps with tissue take long
    many, one = make_vec(task, server, 8 * row // 5), make_vec(task, server, 1)
    observations, _ = many.reset(seed=0)
    alone, _ = one.reset(seed=row)
    for step in range(TASKS[task] + 5):
        assert same(rows_of(observations, slice(row, row + 1)), alone)
        actions = actions_of(many, step)
        observations, rewards, *_ = many.step(actions)
        alone, reward, *_ = one.step(actions[row : row + 1])
        assert rewards[row] == reward[0]
    many.close()
    one.close()


def test_the_expert_says_what_it_is_about(server: str) -> None:
    envs = make_vec("GauzeRetrieve-v0", server, 3, autoreset_mode="disabled", expert=True)
    single = trocar.TrocarEnv("GauzeRetrieve-v0", server=server, expert=True)
    _, infos = envs.reset(seed=4)
    _, info = single.reset(seed=5)
    seen: list[set[str]] = [set() for _ in range(3)]
    for _ in range(50):
        assert infos["_expert_stage"].all()
        assert info["expert_stage"] == infos["expert_stage"][1]
        for stages, stage in zip(seen, infos["expert_stage"], strict=True):
            stages.add(trocar.STAGES[stage])
        *_, info = single.step(info["expert_action"])
        *_, infos = envs.step(infos["expert_action"])
    assert seen == [{"approach", "pick", "lift", "carry"}] * 3
    envs.close()
    single.close()
    envs = make_vec("GauzeRetrieve-v0", server, 2)
    assert "expert_stage" not in envs.reset(seed=0)[1]
    envs.close()


def test_the_expert_succeeds_on_every_seed(goal_task: str, server: str) -> None:
    count = 3 if "tissue" in TAGS[goal_task] else 40  # steps with tissue take long
    envs = make_vec(goal_task, server, count, autoreset_mode="disabled", expert=True)
    _, infos = envs.reset(seed=0)
    assert (infos["episode_seed"] == np.arange(count)).all()
    for _ in range(TASKS[goal_task]):
        assert same(infos["expert_action"], envs.expert_action())
        *_, truncations, infos = envs.step(infos["expert_action"])
    assert truncations.all()
    assert infos["is_success"].sum() == count
    envs.close()


@pytest.mark.parametrize("mode", MODES)
def test_groups_in_flight_give_the_bits_of_whole_steps(task: str, mode: str, server: str) -> None:
    whole = make_vec(task, server, 6, autoreset_mode=mode, expert=True)
    split = make_vec(task, server, 6, autoreset_mode=mode, expert=True)
    groups = [np.array([0, 3, 4]), np.array([1, 2, 5])]
    start, _ = whole.reset(seed=3)
    assert same(split.reset(seed=3)[0], start)
    for step in range(TASKS[task] - 1 if mode == "disabled" else TASKS[task] + 5):
        # No episode ends early where that would need a reset.
        actions = whole.expert_action() if mode == "disabled" else actions_of(whole, step)
        expected = whole.step(actions)
        order = groups if step % 3 else groups[::-1]
        for group in order:
            split.send(actions[group], group)
        for group in order:
            observations, rewards, terminations, truncations, infos = split.recv()
            assert (infos.pop("env_id") == group).all()
            assert same(observations, rows_of(expected[0], group))
            assert same(rewards, expected[1][group])
            assert same(terminations, expected[2][group])
            assert same(truncations, expected[3][group])
            for name in ("is_success", "_is_success", "expert_action"):
                assert same(infos[name], expected[4][name][group])
        assert same(split.expert_action(), whole.expert_action())
    mask = np.array([True] + [False] * 5)
    assert same(
        split.reset(options={"reset_mask": mask})[0], whole.reset(options={"reset_mask": mask})[0]
    )
    whole.close()
    split.close()


def test_at_most_two_disjoint_groups_are_in_flight(server: str) -> None:
    envs = make_vec("NeedleReach-v0", server, 3)
    envs.reset(seed=0)
    action = np.zeros((1, 5), np.float32)
    with pytest.raises(trocar.errors.NothingInFlight):
        envs.recv()
    envs.send(action, [0])
    envs.send(action, [1])
    with pytest.raises(trocar.errors.TooManyInFlight):
        envs.send(action, [2])
    with pytest.raises(trocar.errors.TooManyInFlight):
        envs.step(np.zeros((3, 5), np.float32))
    envs.recv()
    envs.recv()
    envs.step(np.zeros((3, 5), np.float32))
    envs.send(action, [2])
    # A reset drops what is in flight.
    envs.reset(seed=0)
    envs.step(np.zeros((3, 5), np.float32))
    envs.close()


def test_views_are_read_only_and_live_for_one_more_step(task: str, server: str) -> None:
    envs, copied = make_vec(task, server, copy=False), make_vec(task, server)
    view, _ = envs.reset(seed=0)
    expected, _ = copied.reset(seed=0)
    for step in range(60):
        assert not state(view).flags.writeable
        assert not state(view).flags.owndata
        assert state(view).ctypes.data % 64 == 0
        actions = actions_of(envs, step)
        following = envs.step(actions)[0]
        assert same(view, expected)
        view, expected = following, copied.step(actions)[0]
    envs.close()
    assert same(view, expected)
    copied.close()


def test_observations_are_owned_by_the_caller(task: str, server: str) -> None:
    envs = make_vec(task, server)
    first, _ = envs.reset(seed=0)
    state(first)[:] = 0
    mask = np.array([True, False, False, False])
    second, _ = envs.reset(options={"reset_mask": mask})
    assert state(second)[1:].any()
    envs.close()


def test_a_copy_opens_a_session_of_its_own(task: str, server: str) -> None:
    envs = make_vec(task, server, autoreset_mode="same_step", action="joint")
    start, _ = envs.reset(seed=1)
    duplicate = pickle.loads(pickle.dumps(envs))
    assert duplicate.observation_space == envs.observation_space
    with pytest.raises(gym.error.ResetNeeded):
        duplicate.step(actions_of(envs, 0))
    assert same(duplicate.reset(seed=1)[0], start)
    for step in range(TASKS[task] + 3):
        actions = actions_of(envs, step)
        check_same_step(duplicate.step(actions), envs.step(actions))
    duplicate.close()
    envs.close()


def test_closing_twice_is_fine_and_a_closed_environment_says_so(task: str, server: str) -> None:
    envs = make_vec(task, server)
    envs.reset(seed=0)
    envs.close()
    envs.close()
    assert envs.closed
    for use in (envs.reset, lambda: envs.step(actions_of(envs, 0))):
        with pytest.raises(gym.error.ClosedEnvironmentError):
            use()


def test_attributes_are_those_of_single_environments(server: str) -> None:
    """As Gymnasium's own vector environment gives them."""
    envs = make_vec("EcmReach-v0", server, 3, expert=True)
    singles = SyncVectorEnv([lambda: trocar.TrocarEnv("EcmReach-v0", server=server)] * 3)
    for name in ("action_space", "observation_space", "render_mode"):
        assert envs.get_attr(name) == envs.call(name) == singles.get_attr(name)
    # SyncVectorEnv of Gymnasium 1.2.2 adds its autoreset mode to the metadata of its environments.
    modes = [vector.get_attr("metadata")[2]["render_modes"] for vector in (envs, singles)]
    assert modes[0] == modes[1]
    assert envs.get_attr("task_spec") == (envs.task_spec,) * 3
    for name in ("num_envs", "single_observation_space", "autoreset_mode", "no_such_attribute"):
        for vector in (envs, singles):
            with pytest.raises(AttributeError, match=name):
                vector.get_attr(name)
            with pytest.raises(AttributeError, match=name):
                vector.call(name)
        assert envs.call("has_wrapper_attr", name) == singles.call("has_wrapper_attr", name)
    envs.close()
    singles.close()


def test_methods_give_a_result_for_each_environment(server: str) -> None:
    """As Gymnasium's own vector environment calls them."""
    envs = make_vec("EcmReach-v0", server, 3, expert=True)
    singles = SyncVectorEnv(
        [lambda: trocar.TrocarEnv("EcmReach-v0", server=server, expert=True)] * 3
    )
    goal = np.zeros(3, np.float32)
    assert envs.call("compute_reward", goal, goal) == singles.call("compute_reward", goal, goal)
    for seeds in ({"seed": 5}, {}):
        begun, expected = envs.call("reset", **seeds), singles.call("reset", **seeds)
        assert len(begun) == 3
        for (seen, info), (wanted, wanted_info) in zip(begun, expected, strict=True):
            assert same(seen, wanted)
            assert info.keys() == wanted_info.keys()
            assert all(np.array_equal(info[name], wanted_info[name]) for name in info)
    actions, wanted_actions = envs.call("expert_action"), singles.call("expert_action")
    assert len(actions) == 3
    assert all(map(same, actions, wanted_actions))
    assert [len(each) for each in envs.call("snapshot")] == [1] * 3
    assert envs.call("render") == singles.call("render")
    with pytest.raises(ValueError, match=r"share a session; use TrocarVectorEnv\.step"):
        envs.call("step", np.zeros(3))
    envs.close()
    singles.close()


def test_attributes_are_set_for_each_environment(server: str) -> None:
    """Attributes of the task are shared."""
    envs = make_vec("EcmReach-v0", server, 3)
    envs.set_attr("note", "kept")
    assert envs.get_attr("note") == ("kept",) * 3
    envs.set_attr("note", [1, 2, 3])
    assert envs.get_attr("note") == envs.call("note") == (1, 2, 3)
    assert not hasattr(envs, "note")
    with pytest.raises(ValueError, match=r"note = .*each of 3"):
        envs.set_attr("note", [1, 1])
    envs.set_attr("render_mode", [None] * 3)
    with pytest.raises(ValueError, match=r"render_mode = .*share"):
        envs.set_attr("render_mode", [None, None, "rgb_array"])
    assert pickle.loads(pickle.dumps(envs)).get_attr("note") == (1, 2, 3)
    envs.close()


def test_gymnasiums_vector_wrappers_work(task: str, server: str) -> None:
    envs = gym.wrappers.vector.RecordEpisodeStatistics(make_vec(task, server, expert=True))
    _, infos = envs.reset(seed=0)
    for _ in range(TASKS[task]):
        *_, infos = envs.step(infos["expert_action"])
    assert (infos["episode"]["l"] == TASKS[task]).all()
    envs.close()
