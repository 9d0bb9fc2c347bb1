"""A task that Trocar does not have, served by an example program."""

from __future__ import annotations

import json
import os
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from conftest import eventually
from gymnasium.utils.env_checker import check_env
from test_snapshots import go_on

import trocar
from trocar.errors import NoServer, UnknownTask
from trocar.registration import schedule

PROGRAM = Path(trocar.binary()).resolve().parent / "examples" / "own_task"

pytestmark = pytest.mark.skipif(
    not PROGRAM.exists(), reason="cargo build -p trocar-server --example own_task makes it"
)


@pytest.fixture(scope="module")
def own() -> Iterator[str]:
    """The name of a server that offers ``PushCube-v0``."""
    name = f"own-{os.getpid()}"
    program = subprocess.Popen([PROGRAM, name], stderr=subprocess.DEVNULL)
    try:
        eventually(lambda: program.poll() is not None or runs(name))
        yield name
    finally:
        program.send_signal(signal.SIGINT)
        assert program.wait() == 0


def runs(server: str) -> bool:
    try:
        trocar.status(server)
    except NoServer:
        return False
    return True


def test_a_server_says_which_tasks_it_has(own: str) -> None:
    ids = trocar.register_all(server=own)
    assert "trocar/PushCube-v0" in ids
    assert "trocar/NeedleReach-v0" in ids
    # It is made where it was found, and nowhere else.
    env = gym.make("trocar/PushCube-v0", reward="dense")
    assert env.spec is not None
    assert env.spec.max_episode_steps == 50
    check_env(env.unwrapped, skip_render_check=True)
    env.close()
    with pytest.raises(UnknownTask, match="PushCube"), trocar.Server(threads=1) as other:
        gym.make("trocar/PushCube-v0", server=other.name)


def test_it_is_a_task_like_others(own: str) -> None:
    envs = trocar.TrocarVectorEnv("PushCube-v0", 8, server=own, expert=True)
    assert envs.task_spec.summary.startswith("Push a cube")
    _, infos = envs.reset(seed=0)
    for _ in range(envs.task_spec.max_steps):
        *_, infos = envs.step(infos["expert_action"])
    assert infos["is_success"].all()
    envs.reset(seed=1)
    go_on(envs, 12)
    snapshot = envs.snapshot()
    after = go_on(envs)
    envs.restore(trocar.Snapshot.from_bytes(snapshot.to_bytes()))
    assert go_on(envs) == after
    envs.close()


def test_it_can_be_registered_without_a_server(own: str) -> None:
    name = trocar.register("PushCube-v0", max_steps=50)
    env = gym.make(name, server=own)
    observation, _ = env.reset(seed=3)
    assert np.allclose(observation["observation"][-3:], observation["achieved_goal"])
    env.close()


def test_commands_know_it_under_its_server(own: str, tmp_path: Path) -> None:
    """Commands list, draw and refuse tasks as those of the server."""

    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        command = [trocar.binary(), *arguments, "--server", own]
        return subprocess.run(command, capture_output=True, text=True, check=False)

    rows = [json.loads(line) for line in run("tasks", "--json").stdout.splitlines()]
    assert [row["max_steps"] for row in rows if row["id"] == "PushCube-v0"] == [50]
    assert "reward" in run("tasks", "PushCube-v0").stdout
    assert "did you mean" in run("tasks", "PushCub").stderr
    for name, more in (("push.png", ()), ("push.gif", ("--seconds", "1"))):
        path = tmp_path / name
        flags = ("--task", "PushCube-v0", "--size", "64x48", "--moments", "3", "--out", str(path))
        done = run("render", *flags, *more)
        assert done.returncode == 0, done.stderr
        assert path.stat().st_size > 500
    # The cards of policies, and what else depends on the number of steps, know it too.
    trocar.register_all(server=own)
    assert schedule("PushCube-v0") == (50, 5.0)
    with pytest.raises(UnknownTask, match="did you mean 'PushCube-v0'"):
        schedule("PushCubes-v0")
