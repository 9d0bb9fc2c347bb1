"""Any non-negative integer is a seed, and copies of an environment keep theirs."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import SyncVectorEnv
from test_env import make, same
from test_vector import actions_of, check_same_infos, make_vec

import trocar

TASK = "EcmReach-v0"

MIXED = {
    2**63: 2598401411181246957,
    2**64 - 1: 8245168133484221968,
    2**64: 313702574736366215,
    2**127 + 5: 147049417268983529,
    2**256: 5974511739358450099,
}
"""As the tests of the protocol, in Rust, have them."""


def test_numbers_of_any_size_are_seeds(server: str) -> None:
    env = make(TASK, server)
    entropy = np.random.SeedSequence(5).spawn(1)[0].generate_state(2, np.uint64)
    numbers = [0, 1, 2**63 - 1, *MIXED, int(entropy[0]) << 64 | int(entropy[1])]
    seen = set()
    for number in numbers:
        first, info = env.reset(seed=number)
        assert info["episode_seed"] == MIXED.get(number, info["episode_seed"])
        assert number >= 2**63 or info["episode_seed"] == number
        assert 0 <= info["episode_seed"] < 2**63
        assert same(env.reset(seed=number)[0], first)
        # The seed that is told begins the same episode.
        again, told = env.reset(seed=info["episode_seed"])
        assert same(again, first)
        assert told == info
        seen.add(first["desired_goal"].tobytes())
    assert len(seen) == len(numbers)
    env.close()


def test_integers_of_any_type_are_seeds(server: str) -> None:
    env, envs = make(TASK, server), make_vec(TASK, server, 2)
    largest = np.uint64(2**64 - 1)
    assert env.reset(seed=largest)[1]["episode_seed"] == MIXED[2**64 - 1]
    for kind in ("i1", "u2", "i4", "u8"):
        seed: Any = np.array(7, kind)
        for each in (seed, seed[()]):
            assert env.reset(seed=each)[1]["episode_seed"] == 7
            assert envs.reset(seed=each)[1]["episode_seed"].tolist() == [7, 8]
    seeds: Any = np.array([2**64 - 1, 3], np.uint64)
    assert envs.reset(seed=seeds)[1]["episode_seed"].tolist() == [MIXED[2**64 - 1], 3]
    env.close()
    envs.close()


@pytest.mark.parametrize("seed", [2**63 - 2, 2**64 - 2, 2**130])
def test_environments_count_on_from_any_seed(seed: int, server: str) -> None:
    envs = make_vec(TASK, server, 4)
    singles = SyncVectorEnv([lambda: trocar.TrocarEnv(TASK, server=server)] * 4)
    observations, infos = envs.reset(seed=seed)
    expected, expected_infos = singles.reset(seed=seed)
    assert same(observations, expected)
    check_same_infos(infos, expected_infos)
    assert len(set(infos["episode_seed"].tolist())) == 4
    known = [MIXED.get(seed + index) for index in range(4)]
    assert all(
        seed in (None, told) for seed, told in zip(known, infos["episode_seed"], strict=True)
    )
    envs.close()
    singles.close()


def copies(env: Any) -> list[Any]:
    return [copy.deepcopy(env), pickle.loads(pickle.dumps(env))]


def test_a_copy_goes_on_as_the_original_does(task: str, server: str) -> None:
    env = gym.make(f"trocar/{task}", server=server)
    env.reset(seed=7)
    env.reset()
    env.step(env.action_space.sample())
    early = copies(env)
    wanted = env.reset()
    assert (wanted[1]["episode_seed"], wanted[1]["episode_index"]) == (7, 2)
    later = copies(copies(env)[0])  # copies of a copy that has no session yet
    following = env.reset()
    for duplicates, expected in ((early, wanted), (later, following)):
        for duplicate in duplicates:
            observation, info = duplicate.reset()
            assert same(observation, expected[0])
            assert info == expected[1]
            assert duplicate.reset()[1]["episode_index"] == info["episode_index"] + 1
            assert duplicate.reset(seed=3)[1]["episode_seed"] == 3
            duplicate.close()
    env.close()


@pytest.mark.parametrize("mode", ["next_step", "same_step"])
def test_a_copy_of_many_goes_on_as_they_do(mode: str, server: str) -> None:
    envs = make_vec(TASK, server, 3, autoreset_mode=mode)
    envs.reset(seed=[4, 9, 2**70])
    mask = np.array([True, False, False])
    for step in range(60):
        if step == 7:
            envs.reset(options={"reset_mask": mask})
        envs.step(actions_of(envs, step))
    duplicates = copies(envs)
    expected, infos = envs.reset()
    assert infos["episode_seed"][:2].tolist() == [4, 9]
    assert infos["episode_index"].tolist() == [3, 2, 2]
    for duplicate in duplicates:
        observations, told = duplicate.reset()
        assert same(observations, expected)
        check_same_infos(told, infos)
        duplicate.close()
    envs.close()


def test_a_copy_without_any_episode_draws_a_seed_of_its_own(server: str) -> None:
    env = make(TASK, server)
    seeds = {each.reset()[1]["episode_seed"] for each in (env, *copies(make(TASK, server)))}
    assert len(seeds) == 3
    env.close()


def test_a_copy_that_was_restored_goes_on_from_there(server: str) -> None:
    env, other = make(TASK, server), make(TASK, server)
    other.reset(seed=21)
    env.reset(seed=7)
    duplicate = copy.deepcopy(env)
    duplicate.restore(other.snapshot())
    assert duplicate.reset()[1]["episode_seed"] == 21
    env.restore(other.snapshot())
    assert copy.deepcopy(env).reset()[1] == env.reset()[1]
    for each in (env, other, duplicate):
        each.close()


def test_a_forked_child_goes_on_as_its_parent_would(script: Any) -> None:
    """In a process tree of its own, since it forks."""
    process = script(FORKED, TROCAR_BINARY=trocar.binary())
    out, _ = process.communicate(timeout=60)
    assert process.returncode == 0
    told = ["7 1", "[7 9] [2 1]"]
    assert out.splitlines() == 2 * told


FORKED = """
import os, sys, numpy as np, trocar
env = trocar.TrocarEnv("EcmReach-v0")
env.reset(seed=7)
envs = trocar.TrocarVectorEnv("EcmReach-v0", 2)
envs.reset(seed=[7, 9])
envs.reset(options={"reset_mask": np.array([True, False])})
child = os.fork()
if child:
    os.waitpid(child, 0)
for each in (env, envs):
    info = each.reset()[1]
    print(info["episode_seed"], info["episode_index"], flush=True)
    each.close()
os._exit(0) if not child else sys.exit()
"""


def test_an_environment_whose_server_was_lost_goes_on(own_server: trocar.Server) -> None:
    env = make(TASK, own_server.name)
    env.reset(seed=7)
    expected = env.reset()
    env.reset(seed=7)
    own_server.stop()
    with pytest.raises(trocar.ServerLost):
        env.step(env.action_space.sample())
    own_server.start()
    observation, info = env.reset()
    assert same(observation, expected[0])
    assert info == expected[1]
    env.close()
