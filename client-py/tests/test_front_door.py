"""``python -m trocar demo``, as a newcomer runs it first: with this Python and no more."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import trocar

SMALL = 'mount -t tmpfs -o size=64m tmpfs /dev/shm && exec "$@"'
"""A shell's command that runs its arguments with as much shared memory as a container has."""


def confined() -> list[str]:
    """What runs a command with 64 MiB of /dev/shm; nothing where this user may not mount."""
    command = ["unshare", "--user", "--map-root-user", "--mount", "sh", "-c", SMALL, "sh"]
    try:
        subprocess.run([*command, "true"], capture_output=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return []
    return command


def module(tmp_path: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Runs ``python -m trocar`` with nothing else on the PATH: no compiler, no other Python."""
    nothing = tmp_path / "nothing"
    nothing.mkdir()
    command = ["env", f"PATH={nothing}", f"TROCAR_BINARY={trocar.binary()}", sys.executable]
    return subprocess.run(
        [*confined(), *command, "-m", "trocar", *arguments],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
        stdin=subprocess.DEVNULL,
        cwd=tmp_path,
        env={name: value for name, value in os.environ.items() if name != "TROCAR_PYTHON"},
    )


def test_the_demonstration_shows_a_robot_and_three_clients(tmp_path: Path) -> None:
    done = module(tmp_path, "demo", "--seconds", "0.2", "--envs", "64", "--json")
    assert done.returncode == 0, done.stderr
    picture = tmp_path / "trocar-demo.gif"
    assert picture.read_bytes().startswith(b"GIF89a")
    assert str(picture) in done.stderr
    assert "http://127.0.0.1:" in done.stderr
    clients = [json.loads(line) for line in done.stdout.splitlines()]
    assert [client["language"] for client in clients] == ["Rust", "Python", "Python"]
    assert [client["success_rate"] for client in clients] == [1.0, 1.0, 1.0]


@pytest.mark.parametrize("out", ["no/such/folder.gif", "picture.mp4"])
def test_a_picture_that_cannot_be_written_ends_it_early(out: str, tmp_path: Path) -> None:
    done = module(tmp_path, "demo", "--out", out)
    assert done.returncode == 1
    assert f"{out} could not be drawn; --out may name another file" in done.stderr
    assert done.stdout == ""


def test_a_program_that_is_none_is_named(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "trocar", "tasks"],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "TROCAR_BINARY": str(tmp_path)},
    )
    assert done.returncode == 1
    assert str(tmp_path) in done.stderr
    assert "$TROCAR_BINARY" in done.stderr
