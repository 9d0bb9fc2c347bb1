"""One environment: Gymnasium's contract, seeds, copies, views."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from conftest import WITHOUT_GOALS
from gymnasium.utils.env_checker import check_env
from numpy.typing import NDArray

import trocar
from trocar._trocar import Client
from trocar.errors import ResetNeeded
from trocar.registration import RATES, TASKS


def make(task: str, server: str, **options: Any) -> trocar.TrocarEnv:
    env = gym.make(f"trocar/{task}", server=server, **options).unwrapped
    assert isinstance(env, trocar.TrocarEnv)
    return env


def state(observation: Any) -> Any:
    """The state in an observation, which is all of it for a task without goals."""
    return observation["observation"] if isinstance(observation, dict) else observation


def constant(env: trocar.TrocarEnv | trocar.TrocarVectorEnv, value: float) -> NDArray[np.float32]:
    """The same number in every element of an action."""
    assert env.action_space.shape is not None
    return np.full(env.action_space.shape, value, np.float32)


def same(a: Any, b: Any) -> bool:
    """Whether two observations or infos agree bit for bit."""
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    a, b = np.asarray(a), np.asarray(b)
    return bool(a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes())


def trajectory(env: trocar.TrocarEnv, steps: int = 60, seed: int = 5) -> list[Any]:
    """Two episodes under random actions."""
    rng = np.random.default_rng(seed)
    taken: list[Any] = [env.reset(seed=seed)]
    for _ in range(steps):
        taken.append(env.step(rng.uniform(-1, 1, len(env.task_spec.action))))
        if taken[-1][2] or taken[-1][3]:
            taken.append(env.reset())
    return taken


@pytest.mark.parametrize("task", TASKS)
def test_gymnasiums_checker_is_content(task: str, server: str) -> None:
    env = make(task, server)
    check_env(env)
    env.close()


def test_every_registered_task_is_known_to_the_server(server: str) -> None:
    assert set(TASKS) == set(Client.connect(server).tasks())


def test_a_connection_tells_what_a_client_may_have(server: str) -> None:
    limits = trocar.connect(server).limits()
    assert limits.pop("session_envs") == Client.connect(server).max_envs
    assert limits == dict.fromkeys(("sessions", "envs", "memory_bytes", "threads"))


def test_the_spec_of_an_environment_has_its_own_episode_length(task: str, server: str) -> None:
    for rate in (10, 20):
        env = gym.make(f"trocar/{task}", server=server, rate=rate)
        vector = gym.make_vec(f"trocar/{task}", num_envs=2, server=server, rate=rate)
        nominal = RATES[task]
        assert env.spec is not None
        for spec in (env.spec, gym.make(env.spec, server=server).spec, vector.spec):
            assert spec is not None
            assert spec.max_episode_steps == TASKS[task] * rate // nominal
        env.close()
        vector.close()


def test_episodes_of_another_rate_are_as_long_in_seconds(server: str) -> None:
    env = gym.make("trocar/NeedleReach-v0", server=server, rate=20)
    env.reset(seed=0)
    action = np.zeros(5, np.float32)
    ends = [env.step(action)[3] for _ in range(200)]
    assert ends == [False] * 199 + [True]
    assert env.unwrapped.metadata["render_fps"] == 20
    env.close()


def test_infos_tell_how_far_tips_go_and_how_hard_jaws_press(server: str) -> None:
    with make("NeedleReach-v0", server) as env:
        assert env.reset(seed=0)[1]["tip_path"] == 0.0
        info = env.step(np.array([0.6, -0.8, 0, 0, 0], np.float32))[-1]
        assert info["tip_path"] == pytest.approx(0.01, rel=1e-6)
        assert info["peak_force"] == 0.0
        assert "tissue_pressure" not in info
    tissue = {"tissue_pressure", "overstretched", "crushed"}
    with make("TissuePoint-v0", server) as env:
        info = env.reset(seed=0)[1]
        assert all(info[key] == 0.0 for key in tissue)
        assert env.step(np.zeros(5, np.float32))[-1].keys() == info.keys()
    envs = trocar.TrocarVectorEnv("TissuePoint-v0", 1, server=server)
    begun = envs.reset(seed=0)[1]
    assert tissue < begun.keys() == envs.step(np.zeros((1, 5), np.float32))[-1].keys()
    envs.close()
    envs = trocar.TrocarVectorEnv("NeedlePick-v0", 4, server=server, expert=True)
    infos = envs.reset(seed=0)[1]
    forces = []
    for _ in range(50):
        infos = envs.step(infos["expert_action"])[-1]
        forces.append(infos["peak_force"])
    assert forces[0].dtype == infos["tip_path"].dtype == np.float64
    # Nothing is touched at first; in the end the needle hangs between fingers of 1 N each.
    assert not forces[0].any()
    assert (np.abs(forces[-1][infos["is_success"]] - 1.0) < 0.3).all()
    envs.close()


def test_success_ends_an_episode_where_that_is_asked_for(server: str) -> None:
    env = make("NeedleReach-v0", server, terminate="success", expert=True)
    obs, info = env.reset(seed=1)
    terminated = False
    while not terminated:
        obs, _, terminated, truncated, info = env.step(info["expert_action"])
        goals = obs["achieved_goal"], obs["desired_goal"]
        assert terminated == info["is_success"] == env.compute_terminated(*goals, info)
        assert not truncated
        assert not env.compute_truncated(*goals, info)
    with pytest.raises(ResetNeeded):
        env.step(info["expert_action"])
    env.close()


def test_time_limit_of_gymnasium_and_server_agree(task: str, server: str) -> None:
    wrapped = gym.make(f"trocar/{task}", server=server, max_episode_steps=TASKS[task])
    bare = make(task, server, expert=True)
    for env in (wrapped, bare):
        env.reset(seed=0)
    for step in range(1, TASKS[task] + 1):
        action = bare.expert_action()
        ends = [env.step(action)[2:4] for env in (wrapped, bare)]
        assert ends == [(False, step == TASKS[task])] * 2
    for env in (wrapped, bare):
        env.close()


def test_spaces_are_finite_and_hold_what_is_returned(task: str, server: str) -> None:
    env = make(task, server)
    space = env.observation_space
    assert isinstance(space, gym.spaces.Box if task in WITHOUT_GOALS else gym.spaces.Dict)
    boxes = space.values() if isinstance(space, gym.spaces.Dict) else [space]
    for box in (env.action_space, *boxes):
        assert isinstance(box, gym.spaces.Box)
        assert np.isfinite(box.low).all()
        assert np.isfinite(box.high).all()
    for values in trajectory(env):
        observation = values[0]
        assert observation in env.observation_space
        arrays = observation.values() if isinstance(observation, dict) else [observation]
        assert all(array.dtype == np.float32 for array in arrays)
    env.close()


def test_same_seed_and_actions_give_the_same_bits(task: str, server: str) -> None:
    first, second = make(task, server), make(task, server)
    for a, b in zip(trajectory(first), trajectory(second), strict=True):
        assert all(same(x, y) for x, y in zip(a, b, strict=True))
    first.close()
    second.close()


def test_reset_without_seed_goes_on_to_the_next_episode(task: str, server: str) -> None:
    env = make(task, server)
    infos = [env.reset(seed=9)[1], env.reset()[1], env.reset()[1], env.reset(seed=9)[1]]
    assert [(info["episode_seed"], info["episode_index"]) for info in infos] == [
        (9, 0),
        (9, 1),
        (9, 2),
        (9, 0),
    ]
    first, second = env.reset(seed=9)[0], env.reset()[0]
    assert not same(first, second)
    env.close()


def test_without_any_seed_every_environment_draws_its_own(server: str) -> None:
    envs = [make("EcmReach-v0", server) for _ in range(4)]
    assert len({env.reset()[1]["episode_seed"] for env in envs}) == 4
    for env in envs:
        env.close()


def test_expert_changes_nothing_but_the_info(task: str, server: str) -> None:
    plain, expert = make(task, server), make(task, server, expert=True)
    for a, b in zip(trajectory(plain), trajectory(expert), strict=True):
        assert b[-1].pop("expert_action") in plain.action_space
        assert 0 <= b[-1].pop("expert_stage") < len(trocar.STAGES)
        assert all(same(x, y) for x, y in zip(a, b, strict=True))
    with pytest.raises(ValueError, match="expert=True"):
        plain.expert_action()
    plain.close()
    expert.close()


def test_following_the_expert_succeeds(goal_task: str, server: str) -> None:
    with make(goal_task, server, expert=True) as env:
        env.reset(seed=1)
        info: dict[str, Any] = {}
        for _ in range(TASKS[goal_task]):
            *_, info = env.step(env.expert_action())
        assert info["is_success"] is True


def test_the_expert_keeps_the_target_and_one_that_rests_loses_it(server: str) -> None:
    with make("ActiveTrack-v0", server, expert=True) as env:
        env.reset(seed=1)
        returned, steps, ended = 0.0, 0, False
        while not ended:
            _, reward, terminated, ended, info = env.step(env.expert_action())
            assert isinstance(reward, float)
            assert not terminated
            assert info["is_success"] is False
            returned, steps = returned + reward, steps + 1
        assert steps == TASKS["ActiveTrack-v0"]
        assert 470 < returned < 500
        terminated = truncated = False
        env.reset(seed=1)
        while not (terminated or truncated):
            observation, _, terminated, truncated, _ = env.step(constant(env, 0))
        assert (terminated, truncated) == (True, False)
        assert np.abs(observation[7:9]).max() > 1
        with pytest.raises(gym.error.ResetNeeded):
            env.step(constant(env, 0))


def test_rewards_of_a_task_without_goals_are_the_servers(server: str) -> None:
    with make("ActiveTrack-v0", server) as env:
        for observation, reward, *_ in [v for v in trajectory(env) if len(v) == 5]:
            # The paper's formula over what is observed: image point and misorientation.
            expected = 1 - (np.hypot(*observation[7:9]) + 0.1 * abs(observation[9]))
            assert reward == pytest.approx(expected, abs=1e-6)


def test_observations_are_owned_by_the_caller(task: str, server: str) -> None:
    env = make(task, server)
    first, _ = env.reset(seed=0)
    kept = copy.deepcopy(first)
    env.step(constant(env, 1))
    assert same(first, kept)
    state(first)[:] = 0
    env.close()


def test_views_are_read_only_and_live_for_one_more_step(task: str, server: str) -> None:
    env, copied = make(task, server, copy=False), make(task, server)
    action = constant(env, 0.5)
    view, _ = env.reset(seed=0)
    expected, _ = copied.reset(seed=0)
    for _ in range(20):
        with pytest.raises(ValueError, match="read-only"):
            state(view)[0] = 1
        following, *_ = env.step(action)
        assert same(view, expected)
        view, expected = following, copied.step(action)[0]
    assert not state(view).flags.owndata
    env.close()
    assert same(view, expected)
    copied.close()


def test_holding_on_to_views_is_refused_and_letting_go_helps(server: str) -> None:
    env = make("NeedleReach-v0", server, copy=False)
    held = [env.reset(seed=0)[0]]
    action = np.zeros(5, np.float32)

    def step_on() -> None:
        held.extend(env.step(action)[0] for _ in range(20))

    with pytest.raises(trocar.errors.TooManyHeld, match="held"):
        step_on()
    held.clear()
    env.step(action)
    env.close()


def test_a_copy_opens_a_session_of_its_own(task: str, server: str) -> None:
    env = make(task, server, action="joint")
    expected = trajectory(env)
    for duplicate in (pickle.loads(pickle.dumps(env)), copy.deepcopy(env)):
        assert duplicate.observation_space == env.observation_space
        assert duplicate.task_spec == env.task_spec
        with pytest.raises(gym.error.ResetNeeded):
            duplicate.step(duplicate.action_space.sample())
        for a, b in zip(trajectory(duplicate), expected, strict=True):
            assert all(same(x, y) for x, y in zip(a, b, strict=True))
        duplicate.close()
    env.close()


def test_a_copy_has_the_functions_of_goals(goal_task: str, server: str) -> None:
    env = make(goal_task, server, reward="dense")
    duplicate = pickle.loads(pickle.dumps(env))
    goal = np.zeros(len(env.task_spec.goal or ()), np.float32)
    assert duplicate.compute_reward(goal, goal + 1, {}) == env.compute_reward(goal, goal + 1, {})
    env.close()


def test_closing_twice_is_fine_and_a_closed_environment_says_so(task: str, server: str) -> None:
    env = make(task, server)
    env.reset(seed=0)
    env.close()
    env.close()
    for use in (env.reset, lambda: env.step(env.action_space.sample())):
        with pytest.raises(gym.error.ClosedEnvironmentError):
            use()


def test_environments_of_a_process_share_a_connection(server: str) -> None:
    envs = [make("NeedleReach-v0", server) for _ in range(3)]
    clients = {id(env._connection._client) for env in envs}
    assert len(clients) == 1
    for env in envs:
        env.close()


def test_sessions_end_when_environments_do(own_server: trocar.Server) -> None:
    envs = [make("NeedleReach-v0", own_server.name) for _ in range(3)]
    assert len(own_server.status()["sessions"]) == 3
    envs.pop().close()
    envs.pop()
    assert len(own_server.status()["sessions"]) == 1


def test_unknown_ways_of_rendering_are_refused(server: str) -> None:
    with pytest.raises(ValueError, match="rgb_array"):
        trocar.TrocarEnv("NeedleReach-v0", server=server, render_mode="ansi")
    with pytest.raises(ValueError, match="render_mode"):
        trocar.TrocarEnv("NeedleReach-v0", server=server, render_options={"camera": "overview"})
