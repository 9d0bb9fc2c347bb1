"""Policies leave the environment: a runner drives arms by the names of dVRK's own packages."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from trocar import dvrk
from trocar.dvrk import LiveEnv, World, arms, kdl
from trocar.dvrk.deploy import Limits, Policy, Runner, Task, installed, live, load
from trocar.dvrk.deploy.__main__ import main
from trocar.dvrk.deploy.action import Actions, Aim
from trocar.dvrk.deploy.geometry import (
    Pose,
    euler_xyz,
    of_euler_xyz,
    rotation_matrix,
    rotation_vector,
)
from trocar.dvrk.deploy.observation import Layout, Reading
from trocar.dvrk.deploy.paired import difference
from trocar.dvrk.deploy.robot import LiveRobot, named
from trocar.dvrk.deploy.sources import Function, Topics
from trocar.errors import InvalidOption, InvalidRequest, TrocarError, Unsupported


def still(seen: Any) -> Any:
    """A policy that does nothing, with closed jaws."""
    del seen
    return [0.0, 0.0, 0.0, 0.0, -1.0]


def wild(seen: Any) -> Any:
    """A policy that goes down and aside as fast as it can."""
    del seen
    return [1e3, 1e3, -1e3, 0.0, 1.0]


def broken(seen: Any) -> Any:
    """A policy that gives no numbers."""
    del seen
    return np.full(5, np.nan)


@pytest.fixture(scope="module")
def pick(server: str) -> Task:
    """NeedlePick as a runner sees it."""
    return Task.open("NeedlePick-v0", server=server)


@pytest.fixture
def robot(server: str, pick: Task) -> Iterator[LiveRobot]:
    """Its arm, in a live world in lock-step."""
    made = live(pick, server=server)
    yield made
    made.close()


def run(task: Task, robot: Any, act: Any = still, **settings: Any) -> Any:
    """A short episode, with arms that are enabled first."""
    policy = Policy("test", lambda seen, _: act(seen))
    settings = {"enables": True, "max_steps": 4, **settings}
    return Runner(task, policy, robot, **settings).run(3)


def both(first: Any, then: Any) -> Any:
    """Calls one after the other."""

    def call(*arguments: Any, **named: Any) -> None:
        first(*arguments, **named)
        then(*arguments, **named)

    return call


def assert_holds(robot: LiveRobot) -> None:
    """Whether the arm stays where it is while time passes."""
    before = robot.arms["PSM1"].measured_cp()[0]
    robot.world.sleep(0.5)
    assert (robot.arms["PSM1"].measured_cp()[0].p - before.p).Norm() < 1e-6


@pytest.mark.parametrize(
    "task",
    ["NeedleReach-v0", "NeedlePick-v0", "GauzeRetrieve-v0", "PegTransfer-v0", "BiPegTransfer-v0"],
)
def test_topics_make_the_observation_of_the_simulator(server: str, task: str) -> None:
    """At the start, and after actions of the runner that move everything the task moves."""
    described = Task.open(task, server=server)
    made = live(described, server=server)
    own: list[Any] = []
    rng = np.random.default_rng(5)

    def act(seen: Any) -> Any:
        own.append((seen, made.world.live.observation()))
        return rng.uniform(-1.0, 1.0, len(described.spec.action))

    try:
        episode = run(described, made, act, max_steps=5)
    finally:
        made.close()
    assert episode.outcome == "failure", episode.why
    assert len(own) == 5
    for seen, simulated in own:
        names = ("observation", "achieved_goal", "desired_goal")
        for name, expected in zip(names, simulated, strict=True):
            assert seen[name].dtype == np.float32
            assert np.abs(seen[name] - expected).max() < 2e-6, (task, name)


@pytest.mark.parametrize("task", ["StaticTrack-v0", "MisOrient-v0", "ActiveTrack-v0"])
def test_the_endoscope_is_observed_and_steered_as_by_the_task(server: str, task: str) -> None:
    described = Task.open(task, server=server)
    made = live(described, server=server)
    rng = np.random.default_rng(6)
    apart: list[float] = []

    def act(seen: Any) -> Any:
        expected = made.world.live.observation()[0]
        observed = seen["observation"] if isinstance(seen, dict) else seen
        apart.append(float(np.abs(observed - expected).max()))
        action = rng.uniform(-1.0, 1.0, len(described.spec.action))
        goal, why = made.world.live.ask("ECM", "task/set_point", action)
        assert not why
        expected_goals.append(goal)
        return action

    expected_goals: list[Any] = []
    sent: list[Any] = []
    servo = made.arms["ECM"].servo_jp
    made.arms["ECM"].servo_jp = both(sent.append, servo)
    try:
        run(described, made, act, max_steps=6)
    finally:
        made.close()
    assert max(apart) < 2e-6
    lasts = sent[11::12]
    assert np.abs(np.array(lasts) - np.array(expected_goals)).max() < 1e-6


@pytest.mark.parametrize(
    ("task", "options"),
    [
        ("NeedlePick-v0", {}),
        ("NeedlePick-v0", {"rate": 20.0}),
        ("BiPegTransfer-v0", {}),
        ("NeedleRegrasp-v0", {}),
        ("NeedlePick-v0", {"action": "cartesian"}),
    ],
)
def test_actions_ask_for_what_the_simulator_makes_of_them(
    server: str, task: str, options: dict[str, Any]
) -> None:
    described = Task.open(task, server=server, **options)
    actions, rng = Actions(described), np.random.default_rng(7)
    env = LiveEnv(task, server=server, **options)
    env.reset(seed=1)
    try:
        for _ in range(8):
            action = rng.uniform(-1.0, 1.0, len(described.spec.action)).astype(np.float32)
            parts = np.split(action, len(described.arms))
            for arm, numbers in zip(described.arms, parts, strict=True):
                base = described.bases[arm]
                here = base @ Pose.of_numbers(env.live.pose(arm, "measured_cp")[0])
                jaw = float(env.live.joints(arm, setpoint=True, jaw=True)[0][0])
                expected, why = env.live.ask(arm, "task/set_point", numbers)
                assert not why
                aim = actions.aim(arm, Aim(here, jaw), numbers.astype(np.float64))
                assert aim.wrist is not None
                there = base @ Pose.of_numbers(expected[:7])
                assert np.abs(aim.wrist.position - there.position).max() < 1e-6
                assert np.abs(aim.wrist.rotation - there.rotation).max() < 1e-6
                assert aim.jaw == pytest.approx(expected[7], abs=1e-6)
            env.step(action)
    finally:
        env.close()


def test_joints_of_the_endoscope_go_no_farther_than_a_step() -> None:
    start = np.array([0.1, 0.2, 0.05, 0.0])
    limits = Limits(step=0.001, turn=0.01)
    goal = limits.confine_joints(start + np.array([0.5, -0.005, 0.2, -0.5]), start)
    assert goal - start == pytest.approx([0.01, -0.005, 0.001, -0.01])
    assert np.array_equal(Limits().confine_joints(start + 1.0, start), start + 1.0)


def test_turns_and_angles_are_found_again() -> None:
    rng = np.random.default_rng(8)
    for _ in range(50):
        turn = rng.uniform(-1.0, 1.0, 3)
        assert rotation_vector(rotation_matrix(turn)) == pytest.approx(turn, abs=1e-9)
        angles = rng.uniform(-1.5, 1.5, 3)
        assert euler_xyz(of_euler_xyz(angles)) == pytest.approx(angles, abs=1e-9)
    half = rotation_vector(rotation_matrix(np.array([0.0, math.pi, 0.0])))
    assert np.abs(half) == pytest.approx([0.0, math.pi, 0.0])
    assert euler_xyz(np.diag([1.0, -1.0, -1.0]))[0] == -math.pi


def test_an_episode_is_as_that_of_the_live_environment(server: str, pick: Task) -> None:
    """Same policy, same seed: the arm comes to the same place, and the file tells how."""

    def towards(seen: Any) -> Any:
        way = seen["desired_goal"] - seen["observation"][:3]
        return [*np.clip(way / 0.01, -1.0, 1.0), 0.0, -1.0]

    env = LiveEnv("NeedlePick-v0", server=server, max_steps=6)
    seen, _ = env.reset(seed=3)
    for _ in range(6):
        seen, *_ = env.step(towards(seen))
    env.close()
    made = live(pick, server=server)
    run(pick, made, towards, max_steps=6)
    last, *_ = made.world.live.observation()
    made.close()
    assert np.abs(last - seen["observation"]).max() < 1e-6


def test_increments_of_an_arm_that_lags_add_up(server: str) -> None:
    """An arm that is late is on its way, and is not taken for one that is held up."""
    joints = ["yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw"]
    domain = {f"lag_{joint}": [0.05, 0.05] for joint in joints}
    task = Task.open("NeedlePick-v0", server=server, domain=domain)
    made = live(task, server=server)
    run(task, made, lambda _: [1.0, 0.0, 0.0, 0.0, -1.0], max_steps=6)
    sent = made.frames["PSM1"] @ Pose.of_frame(made.arms["PSM1"].setpoint_cp()[0])
    made.close()
    assert abs(sent.position[0] - task.starts["PSM1"].position[0] - 0.06) < 1e-3


@pytest.mark.parametrize("is_dry", [False, True])
def test_the_file_of_an_episode_has_it_all(
    pick: Task, robot: LiveRobot, tmp_path: Path, is_dry: bool
) -> None:
    """A dry run computes the same and commands nothing."""
    counted: list[str] = []
    count: Any = lambda _, topic, *__, **___: counted.append(topic)  # noqa: E731
    command: Any = both(count, robot.world.command)
    robot.world.command = command  # type: ignore[method-assign]
    policy = Policy("wild", lambda seen, _: wild(seen))
    runner = Runner(pick, policy, robot, enables=True, is_dry=is_dry, max_steps=3)
    episode = runner.run(9, tmp_path)
    assert episode.outcome == ("dry run" if is_dry else "failure")
    assert bool(counted) is not is_dry
    assert episode.path is not None
    with np.load(episode.path) as file:
        told = {name: file[name] for name in file.files}
    about = json.loads(str(told["about"]))
    assert (about["task"], about["policy"], about["seed"]) == ("NeedlePick-v0", "wild", 9)
    assert told["observation"].shape == (4, 19)
    assert np.array_equal(told["action"], [[1.0, 1.0, -1.0, 0.0, 1.0]] * 3)
    assert told["stamps"].shape == (4, len(told["topics"]))
    assert (np.diff(told["stamps"], axis=0) > 0.0).all()
    assert told["PSM1/measured"].shape == (72, 13)
    assert ("PSM1/setpoint" in told) is not is_dry


def test_a_wild_policy_stays_within_the_box_and_the_step(pick: Task, robot: LiveRobot) -> None:
    low, high = pick.boxes["PSM1"]
    box = (*(low + 0.02), *(high + 0.001))
    places: list[Any] = []
    servo = robot.arms["PSM1"].servo_cp
    in_scene = pick.bases["PSM1"]
    robot.arms["PSM1"].servo_cp = both(
        lambda frame: places.append((in_scene @ Pose.of_frame(frame)).position), servo
    )
    robot.reset(3)
    first = run(pick, robot, wild, limits=Limits(box=box))
    assert "outside of the box" in first.why
    assert first.outcome == "stopped"
    assert not places
    box = (*low, *high)
    run(pick, robot, wild, limits=Limits(box=box, step=0.004), max_steps=20)
    way = np.diff(np.array(places)[23::24], axis=0)
    assert np.linalg.norm(way, axis=1).max() < 0.004 + 1e-9
    assert (np.array(places) >= low - 1e-9).all()
    assert (np.array(places) <= high + 1e-9).all()
    assert pick.with_floor(0.7).lowest == {"PSM1": 0.7}
    places.clear()
    run(pick.with_floor(0.7), robot, wild, max_steps=20)
    assert min(place[2] for place in places) == pytest.approx(0.7102, abs=1e-6)


# ---- What is wrong is named, and the arm holds ----


def test_a_policy_of_another_task_is_refused(
    server: str, pick: Task, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(InvalidOption, match="trained for GauzeRetrieve-v0, not for NeedlePick-v0"):
        load("GauzeRetrieve").check(pick.spec)
    assert main(["GauzeRetrieve", "--task", "NeedlePick-v0", "--server", server]) == 2
    assert "trained for GauzeRetrieve-v0" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("Nothing", "allowed are a task"),
        ("no.onnx", "No such file"),
        ("no_such:thing", "expected"),
        ("math:pi", "cannot be called"),
    ],
)
def test_what_is_no_policy_is_refused(name: str, words: str) -> None:
    with pytest.raises(InvalidRequest, match=words):
        load(name)


def test_a_policy_that_gives_no_numbers_is_refused_and_the_arm_holds(
    pick: Task, robot: LiveRobot
) -> None:
    episode = run(pick, robot, broken)
    assert (episode.outcome, episode.steps) == ("stopped", 0)
    assert "must give 5 finite numbers" in episode.why
    assert_holds(robot)


def test_a_topic_that_falls_silent_stops_the_arm(pick: Task, robot: LiveRobot) -> None:
    """Its stamp stays: between set-points, and of an object between steps."""
    arm, get = robot.arms["PSM1"], robot.arms["PSM1"].measured_cp
    dead: list[Any] = []
    arm.measured_cp = lambda: dead[0] if dead else get()

    def after_two(seen: Any) -> Any:
        if robot.world.elapsed() > began + 0.3 and not dead:
            dead.append(get())
        return [0.5, 0.0, 0.0, 0.0, -1.0] if seen is not None else None

    began = robot.world.elapsed() + 1.0
    episode = run(pick, robot, after_two, max_steps=20)
    assert "PSM1/measured_cp is stale: no new stamp for 0.1" in episode.why
    arm.measured_cp = get
    assert_holds(robot)
    told: list[Any] = []
    of_object = robot.object
    robot.object = lambda name: told[0] if told else of_object(name)  # type: ignore[method-assign]
    told.append(of_object("needle"))
    episode = run(pick, robot)
    assert "needle/measured_cp is stale: all its messages have one stamp" in episode.why
    assert episode.steps == 0


def test_missing_topics_are_named(pick: Task, robot: LiveRobot) -> None:
    def no_data() -> Any:
        raise TimeoutError("no data received yet")

    arm, get = robot.arms["PSM1"], robot.arms["PSM1"].measured_cp
    arm.measured_cp = no_data
    assert "PSM1/measured_cp is missing: no data" in run(pick, robot).why
    arm.measured_cp = get
    source = Function(dict, pick, Layout(pick))
    assert "needle is missing" in run(pick, robot, source=source).why
    assert_holds(robot)


def test_poses_that_jump_hold_the_arm_until_they_agree(pick: Task, robot: LiveRobot) -> None:
    """Once: a step passes without a command. For long: the run ends."""
    for times, outcome in ((1, "failure"), (1000, "stopped")):
        steps: list[Any] = []

        def source(jumps: int = times, steps: list[Any] = steps) -> Any:
            number = len(steps) if len(steps) % 2 and len(steps) <= 2 * jumps else 0
            pose = [0.55, 0.0 if not number else 0.05, 0.69, 0.0, 0.0, 0.0, 1.0]
            return {"needle": (pose, robot.now()), "goal": [0.55, 0.0, 0.71]}

        def act(seen: Any, steps: list[Any] = steps) -> Any:
            steps.append(seen)
            return [0.0, -1.0, 0.0, 0.0, -1.0]

        told: list[str] = []
        episode = run(
            pick,
            robot,
            act,
            source=Function(source, pick, Layout(pick)),
            limits=Limits(patience=0.5),
            told=told.append,
            max_steps=8,
        )
        assert episode.outcome == outcome
        assert any("needle/measured_cp jumped by 50 mm" in words for words in told)
        assert any("the arms hold" in words for words in told)
    assert "jumped by 50 mm" in episode.why
    assert_holds(robot)


@pytest.mark.parametrize("goal", [[0.55, 0.0, 0.9], [0.55, 0.0], [0.55, math.nan, 0.7], None])
def test_a_goal_that_cannot_be_is_refused_before_the_arm_moves(
    pick: Task, robot: LiveRobot, goal: Any
) -> None:
    def source() -> Any:
        pose = [0.55, 0.0, 0.69, 0.0, 0.0, 0.0, 1.0]
        return {"needle": (pose, robot.now()), "goal": goal}

    episode = run(pick, robot, source=Function(source, pick, Layout(pick)))
    assert (episode.outcome, episode.steps) == ("stopped", 0)
    assert episode.why.startswith("goal")
    assert_holds(robot)


@pytest.mark.parametrize(
    ("option", "value", "words"),
    [
        ("--floor", "nan", "must be finite"),
        ("--floor", "inf", "must be finite"),
        ("--floor", "9", "allowed are heights from"),
        ("--frame", "psm1=0,0,0.1,0,0,0,1", "allowed arms are"),
        ("--frame", "PSM9=0,0,0.1,0,0,0,1", "allowed arms are"),
        ("--frame", "PSM1=nan,0,0,0,0,0,1", "must be finite"),
        ("--frame", "PSM1=0,0,0,0,0,0,2", "a quaternion of length 1"),
        ("--colour", "targte=1,2,3", "allowed names are"),
        ("--colour", "target=300,0,0", "from 0 to 255"),
        ("--colour", "target=nan,0,0", "must be finite"),
        ("--episodes", "0", "from 1 on"),
    ],
)
def test_safety_options_outside_of_their_range_are_refused(
    server: str, capsys: pytest.CaptureFixture[str], option: str, value: str, words: str
) -> None:
    given = ["NeedleReach", "--server", server, "--steps", "2", option, value]
    assert main(given) == 2
    message = capsys.readouterr().err
    assert option in message
    assert value in message
    assert words in message


def test_jaws_that_point_elsewhere_are_refused_or_brought_to_the_start(
    pick: Task, robot: LiveRobot
) -> None:
    arm, start = robot.arms["PSM1"], pick.starts["PSM1"]
    stay: Any = lambda _: None  # noqa: E731
    robot.reset = stay  # type: ignore[method-assign]
    assert run(pick, robot).outcome == "failure"
    leaning = start.moved(np.array([0.03, -0.03, 0.0]), np.array([0.5, 0.0, 0.0]))
    assert arm.move_cp((pick.bases["PSM1"].inverse() @ leaning).frame(kdl)).wait()
    assert "its jaws point 0.50 rad away" in run(pick, robot).why
    assert run(pick, robot, to_start=True).outcome == "failure"
    there = pick.bases["PSM1"] @ Pose.of_frame(arm.measured_cp()[0])
    assert np.linalg.norm(there.position - start.position) < 1e-4


def test_an_arm_without_power_is_not_driven(pick: Task, robot: LiveRobot) -> None:
    episode = run(pick, robot, enables=False)
    assert "PSM1 is not ENABLED" in episode.why
    ready: list[Any] = []

    def power_off(seen: Any) -> Any:
        ready.append(seen)
        if len(ready) == 2:
            robot.arms["PSM1"].disable(1.0)
        return still(seen)

    episode = run(pick, robot, power_off)
    assert "PSM1 is not ENABLED" in episode.why
    assert episode.steps == 2


def test_what_no_robot_measures_is_named(server: str) -> None:
    task = Task.open("NeedlePick-v0", server=server, observation=["state", "contact"])
    with pytest.raises(Unsupported, match="finger 1 contact"):
        Layout(task)
    with pytest.raises(InvalidOption, match="rate"):
        Limits(rate=0.0)
    with pytest.raises(InvalidOption, match="jump"):
        Limits(jump=float("nan"))
    with pytest.raises(InvalidOption, match="box"):
        Limits(box=(0.0, 0.0, 0.0, 1.0, 1.0, -1.0))


def test_the_command_runs_a_policy_of_the_program(
    server: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """NeedleReach is solved, in two episodes, and told in JSON and in a table."""
    arguments = ["NeedleReach", "--server", server, "--episodes", "2", "--seeds", "5", "--json"]
    assert main([*arguments, "--steps", "25", "--log", str(tmp_path), "--paired"]) == 0
    told = capsys.readouterr()
    rows = [json.loads(line) for line in told.out.splitlines()]
    assert [row["seed"] for row in rows] == [5, 6]
    assert {row["outcome"] for row in rows} == {"success"}
    assert all(row["distance"] < 0.005 and Path(row["path"]).exists() for row in rows)
    assert "2 of 2 succeeded" in told.err
    assert "2 of 2 succeed in the environment; deployed +0.0 points" in told.err


def test_paired_episodes_count_where_they_end_differently() -> None:
    mean, low, high = difference([True, False, True, True], [True, True, True, False])
    assert mean == 0.0
    assert high == pytest.approx(100.0 * 1.96 * math.sqrt(0.5 / 4))
    assert low == -high
    assert difference([True] * 9 + [False], [True] * 10)[0] == pytest.approx(-10.0)


def test_a_robot_is_made_by_a_function_of_the_task(
    server: str, pick: Task, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A world is driven as a live world is; a robot without the task's arms is refused."""
    made: list[Any] = []

    def world(task: Task) -> World:
        made.append(World(task.spec.id, server=server, homing="in_place"))
        return made[0]  # type: ignore[no-any-return]

    monkeypatch.setattr("trocar.dvrk.deploy.paired.world", world, raising=False)
    robot = named("trocar.dvrk.deploy.paired:world", pick, {}, server, None)
    assert isinstance(robot, LiveRobot)
    assert run(pick, robot).outcome == "failure"
    robot.close()
    none = SimpleNamespace(arms={})
    monkeypatch.setattr("trocar.dvrk.deploy.paired.world", lambda _: none)
    with pytest.raises(InvalidRequest, match="it has no arm PSM1"):
        named("trocar.dvrk.deploy.paired:world", pick, {}, server, None)


def test_the_packages_that_are_installed_reach_the_arms(
    server: str, pick: Task, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on a robot: by what scripts import as ``crtk``, ``dvrk`` and ``PyKDL``, and no more."""
    world = World("NeedlePick-v0", server=server, homing="in_place", seed=3)
    dvrk.use(world)
    names = {"crtk": dvrk.crtk, "dvrk": arms, "PyKDL": kdl}
    for name, module in names.items():
        monkeypatch.setitem(sys.modules, name, module)
    robot = installed(pick, pick.bases)
    goal = [0.55, 0.0, 0.71]
    source = Topics(robot, Layout(pick), goal)
    before = robot.arms["PSM1"].measured_cp()[0].p
    other = replace(pick, arms=("PSM1", "PSM2"))
    try:
        with pytest.raises(TrocarError, match="timed out waiting for PSM2"):
            installed(other)
        episode = run(pick, robot, lambda _: [1.0, 0.0, 0.0, 0.0, -1.0], source=source)
        moved = robot.arms["PSM1"].measured_cp()[0].p - before
    finally:
        dvrk.use(None)
        world.close()
    # Nothing but what was measured tells whether the goal is reached.
    assert episode.outcome == "failure"
    assert moved.Norm() == pytest.approx(0.04, abs=1e-4)
    monkeypatch.setitem(sys.modules, "PyKDL", None)
    with pytest.raises(Unsupported, match="PyKDL is missing"):
        installed(pick)


def test_a_policy_that_fails_leaves_an_arm_that_holds_and_a_file(
    pick: Task, robot: LiveRobot, tmp_path: Path
) -> None:
    def fails(seen: Any, _: int) -> Any:
        raise ZeroDivisionError(f"{len(seen)} things")

    runner = Runner(pick, Policy("fails", fails), robot, enables=True)
    with pytest.raises(ZeroDivisionError):
        runner.run(3, tmp_path)
    assert_holds(robot)
    with np.load(tmp_path / "NeedlePick-v0_3.npz") as file:
        about = json.loads(str(file["about"]))
    assert (about["outcome"], about["why"]) == ("stopped", "ZeroDivisionError: 3 things")


def test_readings_are_laid_out_by_name(pick: Task) -> None:
    """A reading that was made by hand: where each number goes is told by the specification."""
    layout = Layout(pick)
    down = np.diag([1.0, -1.0, -1.0])
    reading = Reading(
        wrists={"PSM1": Pose(down, np.array([0.55, 0.01, 0.72]))},
        jaws={"PSM1": 0.25},
        objects={"needle": Pose(np.eye(3), np.array([0.53, 0.02, 0.69]))},
        goal=np.array([0.55, 0.0, 0.71]),
    )
    seen = layout.seen(reading)
    names = [element.name for element in pick.spec.observation]
    numbers = dict(zip(names, seen["observation"], strict=True))
    assert numbers["wrist y"] == np.float32(0.01)
    assert numbers["jaw"] == np.float32(0.25)
    assert numbers["needle from wrist x"] == pytest.approx(-0.02, abs=1e-7)
    # The middle of the arc is a radius from its centre.
    middle = np.array([numbers[f"mid arc {axis}"] for axis in "xyz"])
    assert np.linalg.norm(middle - [0.53, 0.02, 0.69]) == pytest.approx(0.02, abs=1e-3)
