"""StaticTrack from the endoscope's pictures, by the policy runner, over ROS 2."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from conftest import IS_SOAK, Start
from std_msgs.msg import Float64MultiArray

HERE = Path(__file__).parent
PACKAGE = HERE.parents[1] / "client-py/python"

RUNNER = (
    "-m trocar.dvrk.deploy StaticTrack --robot installed --home --poses pictures "
    "--pictures endoscope:pictures --stale 2 --json"
)

SEEDS = range(50 if IS_SOAK else 2)

IMAGE, ANGLE = 0.03, 0.1
"""How far off the target may be in the end: in halves of the picture's height, and in rad."""


def tracked(start: Start, seed: int) -> tuple[dict[str, Any], list[float]]:
    """Plays an episode; what the runner told of it, and where the target is in the end."""
    ros = start(
        "--task", "StaticTrack-v0", "--homing", "in_place", "--images", "30", "--seed", str(seed)
    )
    goals: list[list[float]] = []

    def heard(message: Any) -> None:
        with ros.changed:
            goals.append(list(message.data))
            ros.changed.notify_all()

    ros.node.create_subscription(Float64MultiArray, "task/achieved_goal", heard, 10)
    done = subprocess.run(
        [sys.executable, HERE / "run_script.py", *RUNNER.split()],
        env=os.environ
        | {"ROS_DOMAIN_ID": str(ros.context.get_domain_id())}
        | {"PYTHONPATH": f"{HERE}:{PACKAGE}:{os.environ['TROCAR_SITE']}"},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    count = len(goals)
    assert ros.until(lambda: len(goals) > count + 2, 10)
    start.stop(ros)
    return json.loads(done.stdout), goals[-1]


def test_the_runner_centres_a_target_that_it_sees_in_pictures(
    start: Start, record_property: pytest.RecordProperty
) -> None:
    ends = [tracked(start, seed) for seed in SEEDS]
    centred = [max(abs(x), abs(y)) < IMAGE and abs(angle) < ANGLE for _, (x, y, angle) in ends]
    far = [max(abs(x), abs(y)) for _, (x, y, _) in ends]
    figure = (
        f"StaticTrack from pictures over ROS 2: {sum(centred)} of {len(ends)} centred, "
        f"at most {max(far):.3f} off"
    )
    record_property("figure", figure)
    assert sum(centred) >= 0.9 * len(ends), (figure, ends)
