"""The examples of `client-py/examples/dvrk`, unchanged, over ROS 2."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from conftest import IS_SOAK, Start
from crtk_client import Ros

HERE = Path(__file__).parent
EXAMPLES = HERE.parents[1] / "client-py/examples/dvrk"


def run(ros: Ros, script: str, *arguments: str) -> list[str]:
    """Runs an example; what it printed."""
    domain = str(ros.context.get_domain_id())
    done = subprocess.run(
        [sys.executable, HERE / "run_script.py", EXAMPLES / script, *arguments],
        env=os.environ | {"ROS_DOMAIN_ID": domain},
        capture_output=True,
        text=True,
        timeout=180,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout.splitlines()


def test_a_needle_is_picked_handed_over_and_laid_down(start: Start) -> None:
    """By friction alone, with the commands that a robot has."""
    ros = start("--task", "NeedleRegrasp-v0", "--homing", "in_place", "--frames", "world")
    assert [line.split(" at ")[0] for line in run(ros, "hand_over.py")] == [
        "PSM1 has laid the needle down",
        "PSM2 has the needle",
        "PSM2 has laid the needle down",
    ]


def test_an_arm_moves_and_follows_a_circle(ros: Ros) -> None:
    assert run(ros, "home_and_move.py", "PSM1") == ["PSM1 is at [0.0, 0.0, 0.12, 0.0, 0.0, 0.0]"]
    (said,) = run(ros, "servo_circle.py", "PSM1")
    # Of a circle of 20 mm, in mm. What a script sees is as old as its latest message.
    assert float(said.split()[5]) < (5.0 if IS_SOAK else 20.0), said


def test_an_arm_goes_down_and_comes_back(start: Start) -> None:
    ros = start("--task", "GauzeRetrieve-v0", "--homing", "in_place")
    (said,) = run(ros, "dip_and_lift.py", "PSM1", "0.03")
    assert said.startswith("PSM1 is back within 0."), said
