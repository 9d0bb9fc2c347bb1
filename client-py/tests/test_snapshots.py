"""Snapshot, restore and fork: the same bits again, here and elsewhere."""

from __future__ import annotations

import pickle
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from test_env import same
from test_vector import MODES, actions_of, make_vec, rows_of

import trocar
from trocar.errors import (
    Closed,
    InvalidEnvIds,
    InvalidSnapshot,
    ResetNeeded,
    TooManyInFlight,
    UnknownSnapshot,
)


def started(task: str, server: str, steps: int = 5, **options: Any) -> trocar.TrocarEnv:
    env = trocar.TrocarEnv(task, server=server, **options)
    env.reset(seed=3)
    for step in range(steps):
        env.step(actions_of(env, step))
    return env


def go_on(envs: Any, steps: int = 8) -> list[Any]:
    """What the next steps bring, bit for bit."""
    return [bits(envs.step(actions_of(envs, 100 + step))) for step in range(steps)]


def bits(value: Any) -> Any:
    """Something that is equal where every bit is."""
    if value is None:
        return None
    if isinstance(value, dict):
        return {key: bits(part) for key, part in value.items()}
    if isinstance(value, list | tuple) or (isinstance(value, np.ndarray) and value.dtype == object):
        return [bits(part) for part in value]
    array = np.asarray(value)
    return array.dtype, array.shape, array.tobytes()


def test_what_follows_a_restore_is_what_followed_the_snapshot(task: str, server: str) -> None:
    env = started(task, server, expert=True)
    snapshot, expert = env.snapshot(), env.expert_action()
    after = go_on(env)
    observation = env.restore(snapshot)
    assert same(env.expert_action(), expert)
    assert env.observation_space.contains(observation)
    assert go_on(env) == after
    env.close()


def test_a_snapshot_is_bytes_elsewhere(task: str, server: str, own_server: trocar.Server) -> None:
    env = started(task, server)
    snapshot = env.snapshot()
    pickled, data = pickle.dumps(snapshot), snapshot.to_bytes()
    assert len(data) < 4096
    after = go_on(env)
    other = trocar.TrocarEnv(task, server=own_server.name)
    for given in (pickle.loads(pickled), trocar.Snapshot.from_bytes(data), snapshot):
        other.restore(given)  # without a reset
        assert go_on(other) == after
    other.close()
    env.close()
    # What is in the server ends with the session; what became bytes does not.
    again = started(task, server, 0)
    again.restore(snapshot)
    assert go_on(again) == after
    kept = again.snapshot()
    again.close()
    with pytest.raises(UnknownSnapshot, match="ended with its environment"):
        kept.to_bytes()


def test_a_fork_is_a_second_environment(task: str, server: str) -> None:
    env = started(task, server)
    twin = env.fork()
    assert go_on(twin) == go_on(env)
    twin.close()
    go_on(env, 2)
    env.close()


def test_made_environments_have_it_too(server: str) -> None:
    env = gym.make("trocar/EcmReach-v0", server=server)
    env.reset(seed=1)
    for _ in range(3):
        snapshot = env.unwrapped.snapshot()  # type: ignore[attr-defined]
        go_on(env, 30)
        env.unwrapped.restore(snapshot)  # type: ignore[attr-defined]
        for step in range(10):
            assert not env.step(actions_of(env, step))[3]
    env.close()


@pytest.mark.parametrize("mode", MODES[:2])
def test_many_are_restored_together_and_apart(task: str, server: str, mode: str) -> None:
    envs = make_vec(task, server, autoreset_mode=mode, expert=True)
    envs.reset(seed=1)
    for steps in (7, envs.task_spec.max_steps - 5):
        go_on(envs, steps)
        snapshot, expert = envs.snapshot(), envs.expert_action()
        assert len(snapshot) == 4
        after = go_on(envs)
        observations = envs.restore(snapshot)
        assert envs.observation_space.contains(observations)
        assert same(envs.expert_action(), expert)
        assert go_on(envs) == after
    # Half of them: the observations are of all.
    before = envs.snapshot()
    latest = envs.step(actions_of(envs, 0))[0]
    part = envs.restore(before[1:3], [1, 2])
    whole = envs.restore(before)
    assert same(rows_of(part, [0, 3]), rows_of(latest, [0, 3]))
    assert same(rows_of(part, [1, 2]), rows_of(whole, [1, 2]))
    envs.close()


def test_one_goes_on_in_many(task: str, server: str) -> None:
    envs = make_vec(task, server)
    envs.reset(seed=1)
    go_on(envs)
    snapshot = envs.snapshot()
    observations = envs.fork(2)
    assert same(observations, rows_of(observations, [2, 2, 2, 2]))
    again = envs.restore(snapshot[2])
    assert same(again, observations)
    envs.restore(snapshot)
    mixed = envs.fork([3, 3, 0], [0, 1, 3])
    assert same(mixed, envs.restore(snapshot[[3, 3, 2, 0]]))
    assert same(mixed, envs.restore(snapshot[2], [2]))
    envs.close()


def test_what_cannot_be_is_refused_by_name(server: str) -> None:
    envs = make_vec("EcmReach-v0", server)
    with pytest.raises(ResetNeeded, match="never reset"):
        envs.snapshot()
    envs.reset(seed=1)
    snapshot = envs.snapshot()
    with pytest.raises(InvalidEnvIds, match=r"2 environments.*of 4 goes into 4"):
        envs.restore(snapshot, [0, 1])
    with pytest.raises(InvalidEnvIds, match="below 4"):
        envs.restore(snapshot[0], [4])
    with pytest.raises(InvalidEnvIds, match="source"):
        envs.fork(4)
    with pytest.raises(InvalidEnvIds, match="source"):
        envs.fork([0, 1], [0, 1, 2])
    with pytest.raises(IndexError):
        snapshot[4]
    with pytest.raises(IndexError):
        snapshot[4:]
    envs.send(actions_of(envs, 0)[:2], [0, 1])
    with pytest.raises(TooManyInFlight):
        envs.snapshot()
    envs.recv()
    data = snapshot.to_bytes()
    for changed in (b"", data[:-1], b"x" + data[1:], data + data[:9]):
        with pytest.raises(InvalidSnapshot):
            trocar.Snapshot.from_bytes(changed)
    broken = bytearray(data)
    broken[30] ^= 1
    with pytest.raises(InvalidSnapshot, match="checksum"):
        envs.restore(trocar.Snapshot.from_bytes(bytes(broken)))
    other = make_vec("NeedleReach-v0", server)
    with pytest.raises(InvalidSnapshot, match=r"snapshot\.task.*EcmReach-v0.*NeedleReach-v0"):
        other.restore(snapshot)
    dense = make_vec("EcmReach-v0", server, reward="dense")
    with pytest.raises(InvalidSnapshot, match=r"snapshot\.options\.reward") as caught:
        dense.restore(snapshot)
    assert caught.value.field == "snapshot.options.reward"
    go_on(envs)
    for each in (envs, other, dense):
        each.close()
    with pytest.raises(Closed):
        envs.restore(snapshot)


def test_snapshots_that_are_gone_take_no_memory(server: str) -> None:
    env = started("EcmReach-v0", server)
    env.restore(env.snapshot())
    taken = trocar.status(server)["memory_bytes"]
    for _ in range(50):
        env.snapshot()
    assert trocar.status(server)["memory_bytes"] <= taken + 2**20
    env.close()
