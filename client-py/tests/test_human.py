"""``render_mode="human"``: the live viewer, in a browser that is none here."""

import logging
import urllib.request
import webbrowser
from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import trocar
from trocar import _window


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The addresses that a browser was told to open."""
    addresses: list[str] = []

    def open_(address: str) -> bool:
        addresses.append(address)
        return True

    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(webbrowser, "open", open_)
    return addresses


@pytest.fixture
def waited(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """How long environments would have waited, s, on a clock that goes only meanwhile."""
    times: list[float] = []
    clock = SimpleNamespace(monotonic=lambda: 1000.0 + sum(times), sleep=times.append)
    monkeypatch.setattr(_window, "time", clock)
    return times


def page(address: str) -> str:
    """What a browser would get from there."""
    with urllib.request.urlopen(address.partition("#")[0], timeout=30) as answer:
        return str(answer.read().decode())


def test_the_viewer_opens_once_and_steps_take_as_long_as_they_simulate(
    server: str, opened: list[str], waited: list[float]
) -> None:
    """One page for all episodes; each step waits for the time that it simulates."""
    env: Any = gym.make("trocar/NeedleReach-v0", server=server, render_mode="human")
    for _ in range(2):
        env.reset(seed=3)
        for _ in range(3):
            env.step(env.action_space.sample())
            assert env.render() is None
    sessions = {session["id"] for session in trocar.status(server)["sessions"]}
    env.close()
    (address,) = opened
    assert "Trocar" in page(address)
    assert int(address.split("session=")[1].split("&")[0]) in sessions
    assert waited == pytest.approx([0.0] + 5 * [0.2])


def test_without_a_display_it_says_where_to_look_and_goes_on(
    server: str,
    opened: list[str],
    waited: list[float],
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    """No browser is opened, nothing waits, bits are the same."""
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"):
        monkeypatch.delenv(name, raising=False)
    envs = [
        trocar.TrocarEnv("NeedleReach-v0", server=server, render_mode=mode)
        for mode in ("human", None)
    ]
    with caplog.at_level(logging.WARNING, "trocar"):
        first, second = (env.reset(seed=1)[0] for env in envs)
    assert opened == []
    assert "Trocar" in page(caplog.records[0].message.split(" at ")[1])
    np.testing.assert_array_equal(first["observation"], second["observation"])
    action = np.full(5, 0.3, np.float32)
    first, second = (env.step(action)[0] for env in envs)
    np.testing.assert_array_equal(first["observation"], second["observation"])
    assert waited == []
    for env in envs:
        env.close()


def test_all_environments_of_a_vector_are_on_one_page(
    server: str, opened: list[str], waited: list[float]
) -> None:
    """Training is watched at its own speed; a session that is opened anew has a page of its own."""
    envs = trocar.TrocarVectorEnv("EcmReach-v0", 3, server=server, render_mode="human")
    envs.reset(seed=0)
    envs.step(np.zeros((3, 3), np.float32))
    envs.reset(seed=0)
    assert envs.render() is None
    envs.close()
    assert len(opened) == 1
    assert waited == []


def test_pictures_have_options_and_the_viewer_has_not(server: str) -> None:
    """What draws nothing is not told how to."""
    with pytest.raises(ValueError, match="render_mode 'rgb_array' or 'depth_array'"):
        trocar.TrocarEnv(
            "EcmReach-v0", server=server, render_mode="human", render_options={"camera": "overview"}
        )
