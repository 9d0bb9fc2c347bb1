"""Environments that survive the loss of their server: where they go on, and with which bits."""

from __future__ import annotations

import os
import pickle
import signal
from collections.abc import Iterator

import gymnasium as gym
import numpy as np
import pytest

import trocar
from trocar.errors import InvalidOption, NoServer, Reconnected, ServerLost

TASK = "trocar/NeedleReach-v0"


@pytest.fixture
def server() -> Iterator[trocar.Server]:
    with trocar.Server(threads=2) as server:
        yield server


def restart(server: trocar.Server) -> None:
    """Kills the server and starts it again under its name."""
    assert server.pid is not None
    os.kill(server.pid, signal.SIGKILL)
    server.stop()
    server.start()


def actions(shape: tuple[int, ...]) -> np.ndarray:
    return np.random.default_rng(1).uniform(-1, 1, shape).astype(np.float32)


def test_one_environment_goes_on_from_its_checkpoint(server: trocar.Server) -> None:
    env = gym.make(TASK, server=server.name, reconnect=True)
    plain: trocar.TrocarEnv = env.unwrapped  # type: ignore[assignment]
    env.reset(seed=3)
    script = actions((20, 5))
    for action in script[:5]:
        env.step(action)
    plain.checkpoint()
    followed = [plain.step(action)[0] for action in script[5:]]
    for _ in range(2):
        restart(server)
        with pytest.raises(Reconnected, match="not carried out") as caught:
            plain.step(script[0])
        told = caught.value
        assert told.resumed == "snapshot"
        assert told.info is not None
        assert (told.info["episode_seed"], told.info["episode_index"]) == (3, 0)
        assert isinstance(told.__cause__, ServerLost)
        for action, before in zip(script[5:], followed, strict=True):
            again = plain.step(action)[0]
            for key, value in before.items():
                np.testing.assert_array_equal(again[key], value)
    env.close()


def test_many_environments_begin_anew_with_their_seeds(server: trocar.Server) -> None:
    envs = gym.make_vec(TASK, num_envs=3, server=server.name, reconnect=30.0)
    first, _ = envs.reset(seed=7)
    script = actions((4, 3, 5))
    followed = [envs.step(action)[0] for action in script]
    restart(server)
    with pytest.raises(Reconnected) as caught:
        envs.step(script[0])
    told = caught.value
    assert told.resumed == "reset"
    np.testing.assert_array_equal(told.observation["observation"], first["observation"])
    assert told.info is not None
    np.testing.assert_array_equal(told.info["episode_seed"], [7, 8, 9])
    for action, before in zip(script, followed, strict=True):
        again = envs.step(action)[0]
        np.testing.assert_array_equal(again["observation"], before["observation"])
    envs.close()


def test_steps_under_way_are_not_done(server: trocar.Server) -> None:
    envs = trocar.TrocarVectorEnv("NeedleReach-v0", 4, server=server.name, reconnect=True)
    envs.reset(seed=0)
    envs.checkpoint()
    envs.send(actions((2, 5)), [0, 1])
    restart(server)

    def recv_and_step() -> None:
        # The reply may have come before the server was killed.
        envs.recv()
        envs.step(actions((4, 5)))

    with pytest.raises(Reconnected) as caught:
        recv_and_step()
    assert caught.value.resumed == "snapshot"
    envs.step(actions((4, 5)))
    envs.close()


def test_without_a_seed_the_same_episodes_begin_anew(server: trocar.Server) -> None:
    env = trocar.TrocarEnv("NeedleReach-v0", server=server.name, reconnect=True)
    first, _ = env.reset()
    restart(server)
    with pytest.raises(Reconnected) as caught:
        env.reset()
    np.testing.assert_array_equal(caught.value.observation["observation"], first["observation"])
    env.close()


def test_a_private_server_is_started_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("TROCAR_SERVER", raising=False)
    env = trocar.TrocarEnv("NeedleReach-v0", reconnect=True)
    env.reset(seed=2)
    os.kill(trocar.status()["pid"], signal.SIGKILL)
    with pytest.raises(Reconnected) as caught:
        env.step(np.zeros(5))
    assert caught.value.resumed == "reset"
    env.step(np.zeros(5))
    env.close()


def test_nobody_waits_for_ever_and_copies_keep_what_was_asked_for() -> None:
    with trocar.Server() as server:
        env = trocar.TrocarEnv("NeedleReach-v0", server=server.name, reconnect=0.05)
        env.reset(seed=2)
        env.checkpoint()
        copy = pickle.loads(pickle.dumps(env))
        copy.reset(seed=2)
    with pytest.raises((NoServer, ServerLost)) as caught:
        env.step(np.zeros(5))
    assert not isinstance(caught.value, Reconnected)
    with trocar.Server(server.name):
        env.reset(seed=2)
        with pytest.raises(Reconnected) as caught:
            copy.step(np.zeros(5))
        assert caught.value.resumed == "snapshot"
        env.close()
        copy.close()


def test_reconnect_is_a_time() -> None:
    for wrong in (-1.0, float("nan")):
        with pytest.raises(InvalidOption, match="reconnect"):
            trocar.TrocarEnv("NeedleReach-v0", reconnect=wrong)
