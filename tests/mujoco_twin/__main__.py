"""``python -m mujoco_twin NeedlePick``: runs a policy or the expert in the twin, row by row."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from typing import Any

from mujoco_twin.robot import TwinRobot
from trocar.dvrk.deploy import Runner, Task, load

EXPERTS = {
    "NeedlePick": "mujoco_twin.expert:needle_pick",
    "GauzeRetrieve": "mujoco_twin.expert:gauze_retrieve",
}
"""The experts of tasks."""

GRASP = ("grasp", "grasp_distance")
"""Options of what holds an object in Trocar."""

ROWS: dict[str, dict[str, Any]] = {
    "clean": {},
    "pose error 1 mm": {"pose_error": 1e-3},
    "friction 0.3": {"friction": 0.3},
    "friction 0.5": {"friction": 0.5},
    "arm errors": {"errors": True},
    "all, friction 0.3": {"errors": True, "pose_error": 1e-3, "friction": 0.3},
    "all, friction 0.5": {"errors": True, "pose_error": 1e-3, "friction": 0.5},
    "all, friction 1": {"errors": True, "pose_error": 1e-3, "friction": 1.0},
}
"""What differs from row to row: arguments of :class:`TwinRobot`."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Prints one JSON object a row."""
    parser = argparse.ArgumentParser(prog="python -m mujoco_twin", description=__doc__)
    parser.add_argument("task", choices=EXPERTS)
    parser.add_argument(
        "--policy", default="expert", help="expert, or a policy as of trocar.dvrk.deploy"
    )
    parser.add_argument("--rows", nargs="+", choices=ROWS, default=list(ROWS), metavar="ROW")
    parser.add_argument("--episodes", type=int, default=50)
    parser.add_argument("--seed", type=int, default=60_000, help="seed of the first episode")
    given = parser.parse_args(arguments)
    task_id = f"{given.task}-v0"
    policy = load(EXPERTS[given.task] if given.policy == "expert" else given.policy)
    # Whatever it was trained with: here only friction holds.
    options = {name: value for name, value in policy.options.items() if name not in GRASP}
    task = Task.open(task_id, **options)
    for row in given.rows:
        robot = TwinRobot(task, **ROWS[row])
        runner = Runner(task, policy, robot, enables=True)
        try:
            seeds = range(given.seed, given.seed + given.episodes)
            episodes = [runner.run(seed) for seed in seeds]
        finally:
            robot.close()
        failed = {each.seed: each.why for each in episodes if each.outcome != "success"}
        line = {
            "task": task_id,
            "policy": given.policy,
            "row": row,
            "episodes": len(episodes),
            "successes": len(episodes) - len(failed),
            "failed": failed,
        }
        print(json.dumps(line), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
