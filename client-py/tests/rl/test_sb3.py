"""Stable-Baselines3: the environments of a session as its ``VecEnv``."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3 import A2C, DDPG, PPO, SAC, TD3, HerReplayBuffer
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import (
    DummyVecEnv,
    VecEnv,
    VecFrameStack,
    VecMonitor,
    VecNormalize,
)

import trocar
from trocar.dvrk.deploy import load
from trocar.sb3 import TrocarVecEnv, export, make_vec

TASK = "trocar/NeedleReach-v0"
STEPS = 50
EPISODE = ("episode_seed", "episode_index")


@pytest.fixture
def envs(server: str) -> Iterator[TrocarVecEnv]:
    """Three environments."""
    made = make_vec(TASK, num_envs=3, seed=5, server=server)
    yield made
    made.close()


def actions_of(envs: VecEnv, step: int) -> Any:
    shape = (envs.num_envs, *envs.action_space.shape)  # type: ignore[misc]
    return np.random.default_rng(step).uniform(-1, 1, shape).astype(np.float32)


def same(left: Any, right: Any) -> bool:
    """Whether observations have the same bits."""
    if isinstance(left, dict):
        return left.keys() == right.keys() and all(same(left[key], right[key]) for key in left)
    return left.dtype == right.dtype and bool(np.array_equal(left, right))


@pytest.mark.parametrize("task", [TASK, "trocar/EcmReach-v0", "trocar/ActiveTrack-v0"])
def test_it_is_what_sb3_makes_of_single_environments(task: str, server: str) -> None:
    ours = make_vec(task, num_envs=3, seed=5, server=server)
    theirs = DummyVecEnv([lambda: gym.make(task, server=server)] * 3)
    theirs.seed(5)
    assert ours.observation_space == theirs.observation_space
    assert ours.action_space == theirs.action_space
    assert same(ours.reset(), theirs.reset())
    assert ours.reset_infos == theirs.reset_infos
    ends = 0
    for step in range(510):
        actions = actions_of(ours, step)
        observations, rewards, dones, infos = ours.step(actions)
        expected = theirs.step(actions)
        assert same(observations, expected[0])
        assert rewards.dtype == np.float32
        assert (rewards == expected[1]).all()
        assert (dones == expected[2]).all()
        assert ours.reset_infos == theirs.reset_infos
        for done, info, other in zip(dones, infos, expected[3], strict=True):
            assert info.keys() == other.keys()
            names = ("is_success", "simulation_failed", "TimeLimit.truncated", *EPISODE)
            assert all(info[name] == other[name] for name in names)
            assert ("terminal_observation" in info) == done
            if done:
                assert same(info["terminal_observation"], other["terminal_observation"])
        ends += int(dones.sum())
    assert ends >= 3
    ours.close()
    theirs.close()


def test_the_terminal_observation_is_the_last_state_of_the_episode(
    envs: TrocarVecEnv, server: str
) -> None:
    envs.reset()
    single = trocar.TrocarEnv("NeedleReach-v0", server=server)
    single.reset(seed=6)
    for step in range(STEPS):
        actions = actions_of(envs, step)
        observations, _, dones, infos = envs.step(actions)
        state, _, _, truncated, _ = single.step(actions[1])
    assert truncated
    assert dones.all()
    assert all(info["TimeLimit.truncated"] is True for info in infos)
    assert same(infos[1]["terminal_observation"], state)
    begun, info = single.reset()
    assert same({name: rows[1] for name, rows in observations.items()}, begun)  # type: ignore
    assert envs.reset_infos[1] == info
    single.close()


def test_episodes_count_on_from_the_seed(envs: TrocarVecEnv) -> None:
    envs.reset()
    assert [info["episode_seed"] for info in envs.reset_infos] == [5, 6, 7]
    envs.seed(40)
    first = envs.reset()
    assert [info["episode_seed"] for info in envs.reset_infos] == [40, 41, 42]
    for step in range(STEPS):
        envs.step(actions_of(envs, step))
    assert [tuple(info[name] for name in EPISODE) for info in envs.reset_infos] == [
        (40, 1),
        (41, 1),
        (42, 1),
    ]
    envs.reset()
    assert [info["episode_index"] for info in envs.reset_infos] == [2, 2, 2]
    envs.seed(40)
    assert same(envs.reset(), first)


def test_a_step_goes_on_while_the_trainer_works(envs: TrocarVecEnv) -> None:
    first = envs.reset()
    envs.step_async(actions_of(envs, 0))
    stepped, _, _, _ = envs.step_wait()
    with pytest.raises(trocar.errors.NothingInFlight):
        envs.step_wait()
    envs.step_async(actions_of(envs, 1))
    envs.seed(5)
    assert same(envs.reset(), first)  # a step under way is dropped
    assert same(envs.step(actions_of(envs, 0))[0], stepped)


def test_a_step_that_was_not_waited_for_can_be_followed_by_the_next(
    envs: TrocarVecEnv, server: str
) -> None:
    """As after Ctrl-C, wherever between the two calls it came."""
    other = make_vec(TASK, num_envs=3, seed=5, server=server)
    envs.reset()
    other.reset()
    normalized = VecNormalize(VecMonitor(envs), norm_obs=False, norm_reward=False)
    for step in range(STEPS + 5):
        envs.step_async(actions_of(envs, step))
        other.step(actions_of(envs, step))
        got = normalized.step(actions_of(envs, step))
        wanted = other.step(actions_of(envs, step))
        assert same(got[0], wanted[0])
        assert (got[2] == wanted[2]).all()
    other.close()


def test_a_step_that_was_interrupted_can_be_followed_by_the_next(
    own_server: trocar.Server, interrupted: Any
) -> None:
    envs, other = (make_vec(TASK, 3, seed=5, server=own_server.name) for _ in range(2))
    envs.reset()
    other.reset()
    for step in range(3):
        interrupted(lambda: envs.step(actions_of(envs, 7)))
        other.step(actions_of(envs, 7))
        assert same(envs.step(actions_of(envs, step))[0], other.step(actions_of(envs, step))[0])
    envs.close()
    other.close()


def test_infos_of_resets_and_steps_have_one_shape(server: str) -> None:
    for expert in (False, True):
        envs = make_vec(TASK, num_envs=2, seed=3, server=server, expert=expert)
        envs.reset()
        names = envs.reset_infos[0].keys()
        assert ("expert_action" in names) == expert
        for step in range(STEPS + 1):
            *_, dones, infos = envs.step(actions_of(envs, step))
            ends = {"terminal_observation"} if dones[0] else set()
            assert infos[0].keys() == {*names, "TimeLimit.truncated", *ends}
            assert envs.reset_infos[0].keys() == names
        envs.close()


def test_seeds_of_any_size(server: str) -> None:
    envs = make_vec(TASK, num_envs=2, seed=2**63 - 1, server=server)
    first = envs.reset()
    assert envs.reset_infos[0]["episode_seed"] == 2**63 - 1
    assert envs.reset_infos[1]["episode_seed"] == 2598401411181246957
    envs.seed(2**63 - 1)
    assert same(envs.reset(), first)
    envs.close()


def test_methods_of_goals_are_answered_here(envs: TrocarVecEnv) -> None:
    goals = np.random.default_rng(0).uniform(-0.004, 0.004, (2, 64, 3)).astype(np.float32)
    envs.close()  # there is no session to ask any more
    rewards = envs.env_method("compute_reward", goals[0], goals[1], [{}] * 64, indices=[0])
    assert len(rewards) == 1
    distances = np.linalg.norm(goals[0] - goals[1], axis=1)
    assert (rewards[0] == np.where(distances < 0.005, 0, -1)).all()
    assert 0 < (rewards[0] == 0).sum() < 64
    assert len(envs.env_method("compute_success", goals[0], goals[1])) == 3
    with pytest.raises(ValueError, match="compute_reward"):
        envs.env_method("reset")


def test_attributes_are_shared(envs: TrocarVecEnv) -> None:
    assert envs.get_attr("render_mode") == [None] * 3
    assert envs.get_attr("action_space", indices=[1]) == [envs.action_space]
    assert not envs.has_attr("no_such_attribute")
    assert envs.env_is_wrapped(Monitor, indices=0) == [False]
    envs.set_attr("note", "all")
    assert envs.get_attr("note", indices=[2, 0]) == ["all", "all"]
    with pytest.raises(ValueError, match="indices"):
        envs.set_attr("note", "one", indices=[1])
    wrong: list[Any] = [[3], [0.5], "a", [True, False]]
    for indices in wrong:
        with pytest.raises(ValueError, match=r"indices = .*below 3"):
            envs.get_attr("note", indices=indices)
    for indices in (np.int64(1), [1], np.array([1]), (i for i in [1]), -2):
        assert len(envs.get_attr("note", indices=indices)) == 1
    for indices in ([0, 2], np.array([True, False, True]), range(0, 3, 2)):
        assert len(envs.get_attr("note", indices=indices)) == 2
    assert list(envs.get_images()) == [None] * 3


def test_what_is_not_allowed_is_refused(envs: TrocarVecEnv, server: str) -> None:
    with pytest.raises(ValueError, match="autoreset_mode"):
        TrocarVecEnv(trocar.TrocarVectorEnv("NeedleReach-v0", 2, server=server))
    with pytest.raises(ValueError, match="trocar/"):
        make_vec("CartPole-v1", num_envs=2)
    envs.set_options({"reset_mask": [True]})
    with pytest.raises(ValueError, match="no reset options"):
        envs.reset()
    envs.set_options()
    envs.reset()


def test_expert_actions_are_in_the_infos(server: str) -> None:
    envs = make_vec(TASK, num_envs=4, seed=0, server=server, expert=True)
    envs.reset()
    actions = np.array([info["expert_action"] for info in envs.reset_infos])
    for _ in range(STEPS):
        *_, dones, infos = envs.step(actions)
        actions = np.array([info["expert_action"] for info in infos])
    assert dones.all()
    assert all(info["is_success"] is True for info in infos)
    envs.close()


def test_hindsight_rewards_are_those_of_the_server(server: str) -> None:
    envs = make_vec(TASK, num_envs=4, server=server)
    replay = {"n_sampled_goal": 4, "goal_selection_strategy": "future"}
    model = DDPG(
        "MultiInputPolicy",
        envs,
        seed=0,
        learning_starts=400,
        train_freq=1,
        gradient_steps=1,
        buffer_size=4000,
        replay_buffer_class=HerReplayBuffer,
        replay_buffer_kwargs=replay,
        policy_kwargs={"net_arch": [16]},
    )
    model.learn(480)
    buffer = model.replay_buffer
    assert isinstance(buffer, HerReplayBuffer)
    assert buffer.env is envs
    batch = buffer.sample(1000)
    achieved = batch.next_observations["achieved_goal"].numpy()
    desired = batch.next_observations["desired_goal"].numpy()
    rewards = batch.rewards.numpy()[:, 0]
    expected = envs.envs.compute_reward(achieved, desired)
    assert (rewards == expected).all()
    assert 0 < (rewards == 0).sum() < 1000
    # What the buffer stored unchanged got its reward from the server.
    stored = buffer.rewards[: buffer.pos]
    goals = (
        buffer.next_observations[name][: buffer.pos] for name in ("achieved_goal", "desired_goal")
    )
    assert (stored == envs.envs.compute_reward(*goals)).all()
    # Time limits are no ends: values go on behind them.
    assert buffer.dones[STEPS - 1].all()
    assert buffer.timeouts[STEPS - 1].all()
    assert not batch.dones.any()
    envs.close()


def test_sb3s_wrappers_and_evaluation(server: str) -> None:
    envs = VecMonitor(make_vec(TASK, num_envs=4, seed=0, server=server, reward="dense"))
    normalized = VecNormalize(envs, gamma=0.9)
    model = PPO("MultiInputPolicy", normalized, n_steps=64, batch_size=64, seed=0)
    model.learn(512)
    assert len(model.ep_success_buffer) == len(model.ep_info_buffer) == 8  # type: ignore[arg-type]
    assert all(episode["l"] == STEPS for episode in model.ep_info_buffer)  # type: ignore[union-attr]
    normalized.training = normalized.norm_reward = False
    returns, lengths = evaluate_policy(model, normalized, 6, return_episode_rewards=True)
    assert lengths == [STEPS] * 6
    assert all(-0.2 * STEPS < value < 0 for value in returns)  # type: ignore[union-attr]
    normalized.close()


@pytest.mark.filterwarnings("ignore:.*render_mode='rgb_array':UserWarning")
def test_sb3_makes_environments_by_their_ids(server: str) -> None:
    envs = make_vec_env(TASK, 2, seed=5, env_kwargs={"server": server})
    ours = make_vec(TASK, 2, seed=5, server=server)
    assert same(envs.reset(), ours.reset())
    envs.close()
    ours.close()


@pytest.mark.parametrize("task", ["NeedleReach-v0", "ActiveTrack-v0"])
def test_sb3_finds_nothing_wrong_with_single_environments(task: str, server: str) -> None:
    check_env(trocar.TrocarEnv(task, server=server))
    if task == "ActiveTrack-v0":  # SB3 looks for the functions of goals at the wrapper only
        check_env(gym.make(f"trocar/{task}", server=server))
    envs = make_vec(f"trocar/{task}", 2, server=server)
    assert envs.has_attr("compute_reward") == (task == "NeedleReach-v0")
    envs.close()


def assert_acts_as(path: Path, model: Any, envs: VecEnv, observations: Any) -> None:
    """Compares a file's actions with the model's, for unnormalised observations."""
    policy = load(str(path))
    normal = envs.normalize_obs(observations) if isinstance(envs, VecNormalize) else observations
    expected, _ = model.predict(normal, deterministic=True)
    for row in range(envs.num_envs):
        if isinstance(observations, dict):
            one: Any = {key: rows[row] for key, rows in observations.items()}
        else:
            one = observations[row]
        assert policy(one, expected.shape[1]) == pytest.approx(expected[row], abs=1e-4)


@pytest.mark.parametrize("is_normalised", [False, True])
@pytest.mark.parametrize("algorithm", [SAC, TD3, DDPG, PPO, A2C])
def test_an_exported_policy_acts_as_its_model(
    algorithm: Any, is_normalised: bool, server: str, tmp_path: Path
) -> None:
    envs: VecEnv = make_vec(TASK, 2, server=server, tolerance=2.0)
    settings: dict[str, Any] = {"learning_starts": 20}
    if algorithm in (PPO, A2C):
        settings = {"n_steps": 32}
    elif not is_normalised:
        # Hindsight replay draws from whole episodes.
        settings = {"learning_starts": 110, "replay_buffer_class": HerReplayBuffer}
    if is_normalised:
        envs = VecNormalize(VecMonitor(envs))
    settings["policy_kwargs"] = {"net_arch": [16]}
    model = algorithm("MultiInputPolicy", envs, seed=0, **settings)
    model.learn(130)
    weights = {name: array.clone() for name, array in model.policy.state_dict().items()}
    path = export(model, tmp_path / "new" / "policy.onnx")
    assert all((weights[name] == array).all() for name, array in model.policy.state_dict().items())
    policy = load(str(path))
    assert policy.task == "NeedleReach-v0"
    assert policy.options == {"tolerance": 2.0}
    if isinstance(envs, VecNormalize):
        envs.training = False
    envs.reset()
    for step in range(3):
        observations = envs.step(actions_of(envs, step))[0]
        original = envs.get_original_obs() if isinstance(envs, VecNormalize) else observations
        assert_acts_as(path, model, envs, original)
    envs.close()


def test_an_exported_policy_runs_in_the_program(server: str, tmp_path: Path) -> None:
    envs = make_vec_env(TASK, 2, env_kwargs={"server": server, "reward": "dense", "expert": True})
    path = export(A2C("MultiInputPolicy", envs), tmp_path / "policy.onnx")
    envs.close()
    command = [trocar.binary(), "rollout", "--policy", str(path), "--episodes", "2", "--json"]
    said = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "NeedleReach-v0" in said.stdout
    assert load(str(path)).options == {"reward": "dense"}


def test_a_policy_of_a_task_without_goals_is_exported(server: str, tmp_path: Path) -> None:
    envs = make_vec("trocar/ActiveTrack-v0", 2, server=server)
    model = A2C("MlpPolicy", envs)
    path = export(model, tmp_path / "policy.onnx")
    observations = envs.reset()
    assert_acts_as(path, model, envs, observations)
    envs.close()


@pytest.mark.parametrize("is_normalised", [False, True])
def test_scaling_becomes_a_part_of_the_file(
    is_normalised: bool, server: str, tmp_path: Path
) -> None:
    scaled: VecEnv = make_vec(TASK, 2, seed=0, server=server, observation=("scaled", "joints"))
    if is_normalised:
        scaled = VecNormalize(scaled)
        scaled.reset()
    model = SAC("MultiInputPolicy", scaled, seed=0)
    policy = load(str(export(model, tmp_path / "policy.onnx")))
    assert policy.options == {"observation": ["state", "joints"]}
    plain = make_vec(TASK, 2, seed=0, server=server, **policy.options)
    if isinstance(scaled, VecNormalize):
        scaled.training = False
    scaled.seed(0)
    seen, unscaled = scaled.reset(), plain.reset()
    expected, _ = model.predict(seen, deterministic=True)  # type: ignore[arg-type]
    for row in range(2):
        one = {key: rows[row] for key, rows in unscaled.items()}
        assert policy(one, 5) == pytest.approx(expected[row], abs=1e-4)
    scaled.close()
    plain.close()


def test_policies_that_a_file_cannot_have_are_refused(server: str, tmp_path: Path) -> None:
    path = tmp_path / "policy.onnx"
    seen: dict[str, Any] = {"observation": ["state", "rgb"], "image_size": [36, 36]}
    envs = make_vec(TASK, 1, server=server, **seen)
    with pytest.raises(ValueError, match=r"observation = \['rgb'\].*no pictures"):
        export(A2C("MultiInputPolicy", envs), path)
    envs.close()
    stacked = VecFrameStack(make_vec("trocar/ActiveTrack-v0", 1, server=server), 2)
    with pytest.raises(ValueError, match="VecFrameStack"):
        export(A2C("MlpPolicy", stacked), path)
    stacked.close()
    foreign = DummyVecEnv([lambda: gym.make("Pendulum-v1")])
    with pytest.raises(ValueError, match=r"make_vec"):
        export(A2C("MlpPolicy", foreign), path)
    assert not path.exists()


def test_hindsight_replay_over_relative_features_is_refused(server: str) -> None:
    """Relative features contain the goal, which the replay buffer would not replace."""
    envs = make_vec(TASK, num_envs=2, server=server, observation=("relative",))
    model = DDPG(
        "MultiInputPolicy",
        envs,
        learning_starts=100,
        replay_buffer_class=HerReplayBuffer,
        policy_kwargs={"net_arch": [16]},
    )
    with pytest.raises(ValueError, match=r"relative features contain the goal.*trocar\.rl"):
        model.learn(200)
    envs.close()


def test_sb3s_subprocesses_share_one_private_server(script: Any) -> None:
    """In a process tree of its own, so that it has a private server."""
    process = script(SUBPROCESSES, TROCAR_BINARY=trocar.binary())
    out, _ = process.communicate(timeout=120)
    assert process.returncode == 0
    assert out.split() == ["3", "sessions,", "all", "the", "same"]


SUBPROCESSES = """
import numpy as np, trocar
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import SubprocVecEnv
from trocar.sb3 import make_vec

if __name__ == "__main__":
    options = {"vec_env_cls": SubprocVecEnv, "env_kwargs": {"render_mode": None}}
    theirs = make_vec_env("trocar/NeedleReach-v0", 3, seed=5, **options)
    first = theirs.reset()
    sessions = len(trocar.status()["sessions"])
    ours = make_vec("trocar/NeedleReach-v0", 3, seed=5)
    begun = ours.reset()
    assert all((begun[name] == first[name]).all() for name in first)
    for step in range(60):
        actions = np.random.default_rng(step).uniform(-1, 1, (3, 5)).astype(np.float32)
        left, right = theirs.step(actions), ours.step(actions)
        assert all((left[0][name] == right[0][name]).all() for name in first)
        assert (left[1] == right[1]).all() and (left[2] == right[2]).all()
    theirs.close()
    assert len(trocar.status()["sessions"]) == 1
    ours.close()
    print(sessions, "sessions, all the same")
"""
