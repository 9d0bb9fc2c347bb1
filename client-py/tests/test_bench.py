"""The command ``trocar bench`` with its Python client."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import trocar


def test_the_python_client_is_measured_beside_the_others() -> None:
    command = "bench --quick --json --task EcmReach-v0 --envs 1,3 --policy random,oracle"
    done = subprocess.run(
        [trocar.binary(), *command.split(), "--mode", "client_py", "--option", "reward=dense"],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        env={**os.environ, "TROCAR_PYTHON": sys.executable},
    )
    assert done.returncode == 0, done.stderr
    rows = [json.loads(line) for line in done.stdout.splitlines()]
    assert [row["mode"] for row in rows] == ["client_py"] * 4
    assert all(row["steps_per_second"] > 0 for row in rows)
