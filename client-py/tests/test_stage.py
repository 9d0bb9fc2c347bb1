"""Measured stages of the tests: exit status, output and figures."""

import os
import subprocess
from pathlib import Path

STAGE = Path(__file__).resolve().parents[2] / "tests" / "stage"


def test_a_stage_keeps_output_and_status_and_adds_a_row(tmp_path: Path) -> None:
    times = tmp_path / "times"
    environment = {**os.environ, "STAGE_TIMES": str(times)}

    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [str(STAGE), *arguments], env=environment, capture_output=True, text=True, check=False
        )

    busy = "s=$SECONDS; while ((SECONDS < s + 2)); do :; done; echo done; echo words >&2; exit 3"
    done = run("busy", "bash", "-c", busy)
    assert (done.returncode, done.stdout, done.stderr) == (3, "done\n", "words\n")
    assert run("idle", "sleep", "0.2").returncode == 0
    rows = [line.split("\t") for line in times.read_text().splitlines()]
    assert [name for name, *_ in rows] == ["busy", "idle"]
    assert float(rows[0][2]) > 0.2 > float(rows[1][2])
    table = run("--table").stdout.splitlines()
    assert [line.split()[0] for line in table] == ["stage", "busy", "idle", "all"]


def test_a_stage_without_a_file_of_times_runs_its_command_only(tmp_path: Path) -> None:
    environment = {**os.environ, "STAGE_TIMES": ""}
    command = [str(STAGE), "words", "echo", "done"]
    done = subprocess.run(
        command, env=environment, cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert done.stdout == "done\n"
    assert not list(tmp_path.iterdir())
