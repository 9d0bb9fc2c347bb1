"""``python -m trocar.dvrk.deploy POLICY``: runs a policy on arms that speak CRTK.

In a live world, over ROS 2, or on a real robot. Exit status: 0 after all episodes, 1 where a run
was stopped, 2 where an argument is not allowed.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import tempfile
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from trocar._assignments import SYNTAX, assignments
from trocar.dvrk.__main__ import speed
from trocar.dvrk.deploy import policy as policies
from trocar.dvrk.deploy import robot as robots
from trocar.dvrk.deploy.board import Board
from trocar.dvrk.deploy.geometry import Pose, numbers
from trocar.dvrk.deploy.limits import Limits
from trocar.dvrk.deploy.observation import Layout
from trocar.dvrk.deploy.paired import difference, played
from trocar.dvrk.deploy.pictures import Colour
from trocar.dvrk.deploy.plot import check_matplotlib, plot
from trocar.dvrk.deploy.runner import Episode, Runner
from trocar.dvrk.deploy.sources import Function, Pictures, Source, Topics
from trocar.dvrk.deploy.task import Task
from trocar.errors import InvalidOption, LaunchError, TrocarError, refuse


def parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m trocar.dvrk.deploy",
        description="Runs a policy on arms that speak CRTK.",
        epilog="docs/deploy.md has the steps from a policy to a robot, and the risks.",
    )
    parser.add_argument(
        "policy",
        help="a task that Trocar has a policy of (NeedlePick), FILE.onnx, or module:function",
    )
    parser.add_argument("--task", help="the task (that of the policy)")
    parser.add_argument(
        "--option",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help=f"an option of the task: {SYNTAX}; those that the policy was trained with are set "
        "already",
    )
    parser.add_argument(
        "--robot",
        default="live",
        help="live: a live world; installed: the packages crtk and dvrk, over ROS 2; or "
        "module:function, which is given the task and returns a Robot (%(default)s)",
    )
    parser.add_argument("--server", help="name of a running server (default: a private one)")
    parser.add_argument(
        "--speed",
        type=speed,
        default=None,
        help="of a live world: times real time, or max: as fast as it goes, in lock-step (max)",
    )
    parser.add_argument(
        "--frame",
        action="append",
        default=[],
        metavar="ARM=X,Y,Z,X,Y,Z,W",
        help="where the reference frame of an arm's poses is in the task's scene: m, quaternion",
    )
    parser.add_argument(
        "--poses",
        default="topics",
        metavar="SOURCE",
        help="where objects are: topics: <object>/measured_cp; pictures: the endoscope's, by "
        "colour; or module:function (%(default)s)",
    )
    parser.add_argument(
        "--pictures",
        metavar="MODULE:FUNCTION",
        help="where pictures come from: a function that returns the left one, the right one, their "
        "stamp, and the camera's Pose in the scene (the live world's)",
    )
    parser.add_argument(
        "--colour",
        action="append",
        default=[],
        metavar="NAME=R,G,B",
        help="the colour of target, or of an object, 0 to 255 (those of Trocar's pictures)",
    )
    parser.add_argument(
        "--board",
        type=Path,
        metavar="FILE",
        help="AprilTags that tell where the camera of --poses pictures is, as "
        "python -m trocar.dvrk.deploy.board writes them",
    )
    parser.add_argument("--goal", type=numbers, metavar="X,Y,Z", help="the goal (a simulator's)")
    parser.add_argument("--episodes", type=int, default=1, help="how many (%(default)s)")
    parser.add_argument("--seeds", type=int, default=0, help="seed of the first (%(default)s)")
    parser.add_argument("--steps", type=int, help="most steps of an episode (the task's)")
    parser.add_argument(
        "--dry-run", action="store_true", help="compute and log actions, command nothing"
    )
    parser.add_argument(
        "--home", action="store_true", help="enable and home the arms first; live worlds always do"
    )
    parser.add_argument(
        "--to-start",
        action="store_true",
        help="move PSMs to where episodes begin first, by move_cp",
    )
    limits = Limits()
    for flag, what, unit in LIMITS:
        default = getattr(limits, flag.replace("-", "_"))
        kind = f"%(default)s {unit}" if default is not None else "no limit"
        parser.add_argument(f"--{flag}", type=float, default=default, help=f"{what} ({kind})")
    parser.add_argument(
        "--box",
        type=numbers,
        metavar="X,Y,Z,X,Y,Z",
        help="where wrists may be sent: two corners in the scene, m (the task's)",
    )
    parser.add_argument(
        "--floor",
        metavar="Z",
        help="lowest height of tips in the scene, m (the task's)",
    )
    parser.add_argument(
        "--log", type=Path, metavar="FOLDER", help="write a file of each episode there"
    )
    parser.add_argument("--plot", action="store_true", help="draw each file of --log")
    parser.add_argument(
        "--paired",
        action="store_true",
        help="play the same seeds in the task's environment, too, and compare",
    )
    parser.add_argument("--json", action="store_true", help="one JSON object an episode, on stdout")
    return parser


LIMITS = (
    ("rate", "set-points in a second", "Hz"),
    ("stale", "longest silence of a topic", "s"),
    ("jump", "farthest that an object's pose moves in a step", "m"),
    ("patience", "longest wait for missing topics and jumping poses", "s"),
    ("step", "farthest that a wrist is sent in a step, m", "m"),
    ("turn", "farthest that a wrist or a joint of the ECM is turned in a step, rad", "rad"),
    ("held-up", "how far off its set-point an arm counts as held up", "m"),
)


def finite(flag: str, text: str, allowed: str) -> tuple[float, ...]:
    """The finite numbers between commas of an option: a value, or NAME=VALUE.

    Raises:
        trocar.errors.InvalidOption: A part is not a number, or not finite.
    """
    try:
        found = numbers(text.rpartition("=")[2])
    except ValueError:
        raise refuse(InvalidOption, flag, text, allowed) from None
    if not np.isfinite(found).all():
        raise refuse(InvalidOption, flag, text, f"{allowed}; every number must be finite")
    return found


def frames(given: Sequence[str], arms: Collection[str]) -> dict[str, Pose]:
    """Reference frames of arms, which must be among the arms of the task."""
    expected = (
        "ARM=x,y,z,x,y,z,w was expected, a position (m) and a quaternion of length 1 "
        f"(within {UNIT_TOLERANCE})"
    )
    found = {}
    for assignment in given:
        arm = assignment.partition("=")[0]
        if arm not in arms:
            raise refuse(InvalidOption, "--frame", assignment, f"allowed arms are {sorted(arms)}")
        place = finite("--frame", assignment, expected)
        if len(place) != 7 or abs(math.hypot(*place[3:]) - 1.0) > UNIT_TOLERANCE:
            raise refuse(InvalidOption, "--frame", assignment, expected)
        found[arm] = Pose.of_numbers(place)
    return found


def colours(given: Sequence[str], names: Collection[str]) -> dict[str, Colour]:
    """Colours of objects, which must be among the names."""
    expected = "NAME=R,G,B was expected, three numbers from 0 to 255"
    found = {}
    for assignment in given:
        name = assignment.partition("=")[0]
        if name not in names:
            allowed = f"allowed names are {sorted(names)}"
            raise refuse(InvalidOption, "--colour", assignment, allowed)
        parts = finite("--colour", assignment, expected)
        if len(parts) != 3 or not all(0.0 <= part <= 255.0 for part in parts):
            raise refuse(InvalidOption, "--colour", assignment, expected)
        found[name] = Colour((parts[0], parts[1], parts[2]))
    return found


def floor(task: Task, text: str) -> Task:
    """The task with a lowest height of tips near the task's own."""
    if not task.lowest:
        raise refuse(InvalidOption, "--floor", text, "the task moves no arm with a tip")
    low = min(task.lowest.values()) - FLOOR_MARGIN
    high = min(float(upper[2]) for _, upper in task.boxes.values())
    allowed = f"allowed are heights from {low:.4f} to {high:.4f} m, scene frame"
    heights = finite("--floor", text, allowed)
    if len(heights) != 1 or not low <= heights[0] <= high:
        raise refuse(InvalidOption, "--floor", text, allowed)
    return task.with_floor(heights[0])


UNIT_TOLERANCE = 1e-2
"""Greatest difference of a quaternion's length from 1: of numbers rounded to two digits."""

FLOOR_MARGIN = 0.05
"""Greatest depth of a floor below the task's own, m: of trays that stand lower."""

COLOURS = {"target": Colour((214.0, 31.0, 33.0)), "block": Colour((29.0, 106.0, 207.0))}
"""Colours of things in Trocar's pictures."""


def check_folder(path: Path) -> None:
    """Makes the folder of ``--log``, and checks that a file can be written there.

    Raises:
        InvalidOption: No file can be written there.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            pass
    except OSError as error:
        allowed = f"expected a folder for files: {error.strerror}"
        raise refuse(InvalidOption, "--log", str(path), allowed) from None


def made(given: argparse.Namespace, told: Any) -> Runner:
    """The runner that a command line asks for."""
    if given.episodes < 1:
        raise refuse(InvalidOption, "--episodes", given.episodes, "allowed are numbers from 1 on")
    policy = policies.load(given.policy)
    if given.task is None and policy.task is None:
        raise refuse(InvalidOption, "--task", None, "the policy names no task, so this must")
    if given.plot and given.log is None:
        raise refuse(InvalidOption, "--plot", True, "it draws the files of --log FOLDER")
    if given.plot:
        check_matplotlib()
    if given.log is not None:
        check_folder(given.log)
    chosen = {flag.replace("-", "_"): getattr(given, flag.replace("-", "_")) for flag, *_ in LIMITS}
    limits = Limits(**chosen, box=given.box)
    wanted = {**policy.options, **assignments(given.option)}
    task = Task.open(str(given.task or policy.task), server=given.server, **wanted)
    task = task if given.floor is None else floor(task, given.floor)
    policy.check(task.spec)
    layout = Layout(task)
    bases = frames(given.frame, task.bases)
    chosen_colours = colours(given.colour, {"target", *task.objects})
    robot = robots.named(given.robot, task, bases, given.server, given.speed)
    try:
        source: Source
        if given.poses == "topics":
            source = Topics(robot, layout, given.goal)
        elif given.poses == "pictures":
            call = policies.function(given.pictures, "--pictures") if given.pictures else None
            goal = robot.goal if given.goal is None else lambda: np.array(given.goal)
            found = COLOURS | chosen_colours
            board = Board.read(given.board) if given.board else None
            source = Pictures(call or robot.pictures, layout, found, goal, board=board)
        else:
            call = policies.function(given.poses, "--poses")
            source = Function(call, task, layout, given.goal)
        return Runner(
            task,
            policy,
            robot,
            source=source,
            limits=limits,
            is_dry=given.dry_run,
            enables=given.home or given.robot == "live",
            to_start=given.to_start,
            max_steps=given.steps,
            told=told,
        )
    except BaseException:
        robot.close()
        raise


def table(episodes: Sequence[Episode]) -> str:
    """The results, for people."""
    lines = [f"{'seed':>6}  {'outcome':8}  {'steps':>5}  {'distance':>9}  why"]
    for episode in episodes:
        away = "-" if episode.distance != episode.distance else f"{episode.distance:.4f}"
        lines.append(
            f"{episode.seed:>6}  {episode.outcome:8}  {episode.steps:>5}  {away:>9}  {episode.why}"
        )
    lines.append("distance: from the goal at the end, in the unit of the task's goal (m with PSMs)")
    count = len(episodes)
    good = sum(episode.outcome == "success" for episode in episodes)
    if any(episode.outcome in ("success", "failure") for episode in episodes):
        lines.append(f"{good} of {count} succeeded ({100.0 * good / count:.1f} %)")
    return "\n".join(line.rstrip() for line in lines)


def compared(runner: Runner, episodes: Sequence[Episode], server: str | None) -> str:
    """How the same episodes end in the environment."""
    deployed = [episode.outcome == "success" for episode in episodes]
    seeds = [episode.seed for episode in episodes]
    own = played(runner.task, runner.policy, seeds, server)
    mean, low, high = difference(deployed, own)
    lost = [
        seed for seed, one, other in zip(seeds, deployed, own, strict=True) if other and not one
    ]
    words = (
        f"{sum(own)} of {len(own)} succeed in the environment; deployed {mean:+.1f} points "
        f"({low:+.1f} to {high:+.1f}, 95 %)"
    )
    return f"{words}; lost: {', '.join(map(str, lost))}" if lost else words


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the episodes; the exit status."""
    given = parser().parse_args(arguments)
    is_shown = sys.stderr.isatty()
    seed = given.seeds

    def told(words: str) -> None:
        if is_shown:
            print(f"\r\x1b[Kseed {seed}: {words}", end="", file=sys.stderr, flush=True)

    try:
        runner = made(given, told)
    except (TrocarError, LaunchError) as error:
        print(f"trocar.dvrk.deploy: {error}", file=sys.stderr)
        return 2
    episodes = []
    try:
        for seed in range(given.seeds, given.seeds + given.episodes):
            episode = runner.run(seed, given.log)
            episodes.append(episode)
            if given.json:
                line = {**vars(episode), "path": str(episode.path) if episode.path else None}
                print(json.dumps({"task": runner.task.spec.id, **line}), flush=True)
            if given.plot and episode.path is not None:
                plot(episode.path)
    except KeyboardInterrupt:
        told("interrupted: the arms hold\n")
    finally:
        runner.robot.close()
    if is_shown:
        print("\r\x1b[K", end="", file=sys.stderr)
    print(table(episodes), file=sys.stderr)
    if given.paired and episodes:
        print(compared(runner, episodes, given.server), file=sys.stderr)
    stopped = any(episode.outcome == "stopped" for episode in episodes)
    return int(stopped or len(episodes) < given.episodes)


if __name__ == "__main__":
    sys.exit(main())
