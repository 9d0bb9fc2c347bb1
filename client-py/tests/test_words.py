"""Refusals name the argument or variable, its value, what is allowed and what to do."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from test_errors import refused
from test_vector import make_vec

import trocar
from trocar import errors

VARIABLES = ("TROCAR_SERVER", "TROCAR_PRIVATE_SERVER", "TROCAR_LOG")

EMPTY = """
import gymnasium as gym, trocar
env = gym.make("trocar/EcmReach-v0")
env.reset()
print(trocar.status()["name"].partition("-")[0], flush=True)
env.close()
"""


@pytest.mark.parametrize("empty", [*((name,) for name in VARIABLES), VARIABLES])
def test_empty_variables_are_unset(empty: tuple[str, ...], script: Any) -> None:
    process = script(EMPTY, TROCAR_BINARY=trocar.binary(), **dict.fromkeys(empty, ""))
    out, _ = process.communicate(timeout=60)
    assert (process.returncode, out) == (0, "private\n")


def test_a_wrong_variable_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TROCAR_SERVER", "a/b")
    with refused(errors.InvalidOption, r"^\$TROCAR_SERVER = 'a/b': allowed"):
        trocar.TrocarEnv("EcmReach-v0")
    with refused(errors.InvalidOption, "^server = 'b/c': allowed"):
        trocar.TrocarEnv("EcmReach-v0", server="b/c")


def test_a_program_that_is_not_there_is_named_by_its_variable(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("TROCAR_BINARY", "/nowhere/trocar")
    for start in (trocar.Server().start, trocar.binary):
        with refused(errors.LaunchError, r"^\$TROCAR_BINARY = '/nowhere/trocar'", "unset"):
            start()
    monkeypatch.setenv("TROCAR_SERVER", "nobody-is-here")
    with refused(errors.NoServer, "nobody-is-here", "unset TROCAR_SERVER"):
        trocar.TrocarEnv("EcmReach-v0")


def test_rendering_before_the_first_reset(server: str) -> None:
    env = trocar.TrocarEnv("NeedleReach-v0", server=server, render_mode="rgb_array")
    envs = make_vec("NeedleReach-v0", server, 2, render_mode="rgb_array")
    for each in (env, envs):
        with pytest.raises(errors.ResetNeeded, match="never reset; reset it first") as caught:
            each.render()
        assert "snapshot" not in str(caught.value)
        each.reset(seed=0)
        assert each.render() is not None
        each.close()


@pytest.mark.parametrize("name", ["expert", "copy"])
def test_truth_values_are_those_of_python_and_numpy(name: str, server: str) -> None:
    for make in (trocar.TrocarEnv, trocar.TrocarVectorEnv):
        given: dict[str, Any] = {name: np.bool_(True)}
        make("EcmReach-v0", server=server, **given).close()
        for value, shown in ((1, "1, int"), ("yes", "'yes', str"), (None, "None")):
            given[name] = value
            with refused(errors.InvalidOption, f"^{name} = {shown}: allowed are True and False"):
                make("EcmReach-v0", server=server, **given)


def test_arguments_of_wrong_types_are_named(server: str) -> None:
    cases: list[tuple[dict[str, Any], str]] = [
        ({"server": 5}, "server = 5, int"),
        ({"task": 5}, "task = 5, int"),
        ({"reconnect": "yes"}, "reconnect = 'yes', str"),
        ({"reconnect": -1}, "reconnect = -1, int"),
        ({"render_mode": "rgb_array", "render_options": [1]}, r"render_options = \[1\], list"),
        ({"render_mode": "rgb_array", "render_options": {"x": 1}}, "render_options.x"),
        ({"render_mode": "rgb_array", "render_options": {"x": None}}, "render_options.x"),
        ({"num_envs": "4"}, "num_envs = '4', str"),
        ({"num_envs": 2.0}, "num_envs = 2.0, float"),
        ({"num_envs": 0}, "num_envs = 0"),
        ({"num_envs": 5000}, "num_envs = 5000.*4096"),
    ]
    for given, shown in cases:
        with refused(ValueError, f"^{shown}"):
            trocar.TrocarVectorEnv(**{"task": "EcmReach-v0", "server": server, **given})
    env = trocar.TrocarEnv("EcmReach-v0", server=server)
    env.reset(seed=0)
    with refused(errors.InvalidSnapshot, r"^snapshot = b'', bytes: expected a trocar\.Snapshot"):
        env.restore(b"")  # type: ignore[arg-type]
    with refused(ValueError, r"^options = \[1\], list"):
        env.reset(options=[1])  # type: ignore[arg-type]
    env.close()
