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
    cells = [(row["mode"], row["policy"], row["envs"], row["clients"]) for row in rows]
    assert cells == [
        ("client_py", policy, envs, 1) for policy in ("random", "oracle") for envs in (1, 3)
    ]
    # Nothing was measured that it could be compared with.
    assert all(row["ratio_to_in_process"] is None for row in rows)
