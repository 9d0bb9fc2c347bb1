"""The program as a user meets it: exit codes, and that another driver is named."""

from __future__ import annotations

import subprocess

from conftest import BINARY, Start
from crtk_client import Arm


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [BINARY, "--domain", "100", *arguments],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


def test_exit_codes_tell_what_was_wrong() -> None:
    assert run("--server", "there-is-none").returncode == 3
    wrong = run("--task", "NeedlePick-v9")
    assert wrong.returncode == 2
    assert "NeedlePick-v9" in wrong.stderr
    assert run("--speed", "0").returncode == 2
    assert run("--rate", "1000").returncode == 2
    assert run("--interface", "nowhere").returncode == 2
    assert "Examples:" in run("--help").stdout


def test_a_world_at_another_pace_and_homed_in_place(start: Start) -> None:
    ros = start("--task", "NeedleReach-v0", "--speed", "4", "--homing", "in_place")
    arm = Arm(ros, "PSM1")
    arm.check_connections()
    before = arm.read("measured_js").position
    assert arm.enable(10)
    assert arm.home(10)
    assert arm.fresh("measured_js").position == before
