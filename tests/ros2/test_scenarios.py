"""What dVRK's own test scripts do (A1 to A14 of the list in the issue), over ROS 2 in real time."""

from __future__ import annotations

import itertools
import math
import statistics
import time
from collections.abc import Callable
from typing import Any

import pytest
from conftest import IS_SOAK, Start
from crtk_client import Arm, seconds
from geometry_msgs.msg import Pose
from std_msgs.msg import Float64

ZERO = [0.0, 0.0, 0.12, 0.0, 0.0, 0.0]
DEGREE = math.pi / 180.0

LATE = 1.5 if IS_SOAK else 10.0
"""How much later than the robot a move may end on a machine that does other things, s."""

Record = Callable[[str, object], None]


def timed(act: Callable[[], Any], expected: float) -> float:
    """The time that something takes, which is that of the planner and what messages need."""
    began = time.monotonic()
    assert act()
    took = time.monotonic() - began
    assert expected - 0.01 < took < expected + LATE, f"{took:.3f} s, expected {expected} s"
    return took


def moved(pose: Pose, x: float = 0.0, y: float = 0.0) -> Pose:
    result = Pose(orientation=pose.orientation)
    result.position.x, result.position.y = pose.position.x + x, pose.position.y + y
    result.position.z = pose.position.z
    return result


def distance(one: Pose, other: Pose) -> float:
    one_at, other_at = one.position, other.position
    return math.dist((one_at.x, one_at.y, one_at.z), (other_at.x, other_at.y, other_at.z))


def stream(step: Callable[[float], None], length: float = 5.0, hertz: float = 100.0) -> float:
    """Calls `step` at a rate with the time since it began; the time that it took, s."""
    began = time.monotonic()
    for index in range(round(length * hertz)):
        step(index / hertz)
        time.sleep(max(0.0, began + (index + 1) / hertz - time.monotonic()))
    return time.monotonic() - began


def test_a1_every_topic_of_a_script_has_a_peer(start: Start) -> None:
    ros = start("--task", "NeedleReach-v0")
    psm = Arm(ros, "PSM1", everything=True)
    psm.check_connections()
    # Where nothing was told yet, a late script knows no state.
    assert psm.state is None
    for topic in ("body/jacobian", "measured_cv", "spatial/measured_cf", "local/setpoint_cp"):
        assert psm.read(topic) is not None
    assert psm.read("trajectory_j/ratio").data == 1.0
    assert len(psm.read("spatial/jacobian").data) == 36


def test_a2_enabling_and_homing_bring_the_arm_to_its_zeros(psm: Arm) -> None:
    assert psm.enable(10)
    assert psm.home(10)
    assert psm.home(10)
    assert list(psm.fresh("measured_js").position) == pytest.approx(ZERO, abs=1e-4)
    states = [(state.state, state.is_homed, state.is_busy) for state in psm.states]
    assert states.index(("ENABLED", False, False)) < states.index(("ENABLED", False, True))
    assert states.index(("ENABLED", False, True)) < states.index(("ENABLED", True, False))
    stamps = [seconds(state.header) for state in psm.states]
    assert stamps == sorted(set(stamps)), "stamps of states increase strictly"
    assert abs(stamps[-1] - time.time()) < 5.0


def test_a3_a_move_to_where_the_arm_is_ends(homed: Arm) -> None:
    before = len(homed.states)
    assert homed.move_jp(ZERO).wait(timeout=5)
    assert [state.is_busy for state in homed.states[before:]] == [True, False]


def test_a4_servoed_joints_are_followed(homed: Arm) -> None:
    turn = math.tau / 5.0
    stamps: list[float] = []
    sent: list[float] = [0.0]
    apart: list[float] = []

    def step(at: float) -> None:
        angle, speed = (
            5 * DEGREE * (1 - math.cos(turn * at)),
            5 * DEGREE * turn * math.sin(turn * at),
        )
        sent.append(angle)
        homed.servo_jp([angle, angle, *ZERO[2:]], [speed, speed, 0.0, 0.0, 0.0, 0.0])
        setpoint, measured = homed.read("setpoint_js"), homed.read("measured_js")
        stamps.append(seconds(setpoint.header))
        if setpoint.header == measured.header:
            apart.append(abs(setpoint.position[0] - measured.position[0]))
        assert min(abs(setpoint.position[0] - angle) for angle in sent) < 0.1 * DEGREE

    took = stream(step)
    assert 4.9 < took < 5.0 + LATE
    assert min(stamps) > 0.0
    assert stamps == sorted(stamps)
    assert apart
    assert max(apart) < 1e-3
    # The last set-point stays.
    assert homed.ros.until(
        lambda: abs(homed.latest["setpoint_js"].position[0]) < 0.01 * DEGREE, 2.0
    )


def there_and_back(arm: Arm, wait: Callable[[Any], bool]) -> bool:
    for angle in (10, -10, 0):
        if not wait(arm.move_jp([angle * DEGREE, -angle * DEGREE, *ZERO[2:]])):
            return False
    return True


def test_a5_moves_of_two_joints_take_the_time_of_the_closed_form(
    homed: Arm, record_property: Record
) -> None:
    took = timed(lambda: there_and_back(homed, lambda move: move.wait()), 2.276)
    record_property("figure", f"A5: three moves took {took:.3f} s (robot: 2.276 s)")
    assert list(homed.fresh("measured_js").position) == pytest.approx(ZERO, abs=1e-4)
    assert homed.told["goal_reached"][-3:] == [True] * 3


def test_a6_a_loop_over_is_busy_never_returns_before_the_arm_stops(
    homed: Arm, record_property: Record
) -> None:
    def wait(move: Any) -> bool:
        while move.is_busy():
            time.sleep(0.01)
        return not homed.state.is_busy

    took = timed(lambda: there_and_back(homed, wait), 2.276)
    record_property("figure", f"A6: the same by is_busy took {took:.3f} s")


def test_a7_servoed_poses_are_followed_on_a_diagonal(homed: Arm, record_property: Record) -> None:
    start = homed.fresh("setpoint_cp").pose
    sent = [start]
    furthest: list[float] = []

    def step(at: float) -> None:
        way = 0.02 * (1 - math.cos(math.tau / 5.0 * at))
        goal = moved(start, way, way)
        sent.append(goal)
        homed.pose("servo_cp", goal)
        seen = homed.read("setpoint_cp").pose
        furthest.append(distance(goal, seen))
        assert min(distance(goal, seen) for goal in sent) < 1e-3

    stream(step)
    # What a script sees is as old as its latest message.
    assert not IS_SOAK or statistics.median(furthest) < 2e-3
    record_property(
        "figure", f"A7: the set-point was at most {1e3 * max(furthest):.2f} mm away (robot: 2 mm)"
    )
    assert homed.ros.until(lambda: distance(start, homed.latest["setpoint_cp"].pose) < 1e-4, 2.0)


def test_a8_moves_of_poses_take_the_time_of_the_slowest_joint(
    homed: Arm, record_property: Record
) -> None:
    start = homed.fresh("setpoint_cp").pose
    goals = [(-0.05, 0.0), (0.05, 0.0), (0.0, 0.0), (0.0, -0.05), (0.0, 0.05), (0.0, 0.0)]
    times = [1.028, 1.454, 1.028, 1.067, 1.508, 1.067]
    joints = {
        0: [-23.775 * DEGREE, 0.0, 0.13053, 0.0, 0.0, 23.775 * DEGREE],
        3: [0.0, 25.591 * DEGREE, 0.13136, 0.0, -25.591 * DEGREE, 0.0],
    }
    total = 0.0
    for index, (way, expected) in enumerate(zip(goals, times, strict=True)):
        goal = moved(start, *way)
        total += timed(lambda goal=goal: homed.move_cp(goal).wait(), expected)
        reached = homed.fresh("measured_cp")
        assert distance(reached.pose, goal) < 1e-5
        if index in joints:
            assert list(homed.fresh("setpoint_js").position) == pytest.approx(
                joints[index], abs=1e-4
            )
    record_property("figure", f"A8: six moves of poses took {total:.3f} s (robot: 7.151 s)")


def test_a9_the_jaw_opens_and_closes_in_the_time_of_its_limits(homed: Arm) -> None:
    timed(lambda: homed.jaw(-20 * DEGREE).wait(), 0.333)
    timed(lambda: homed.jaw(60 * DEGREE).wait(), 0.667)
    assert homed.fresh("jaw/setpoint_js").position[0] == pytest.approx(60 * DEGREE, abs=1e-6)
    assert not homed.fresh("jaw/setpoint_js").velocity
    timed(lambda: homed.jaw(-20 * DEGREE).wait(), 0.667)


def test_a10_jaw_and_insertion_share_a_trajectory(homed: Arm) -> None:
    assert homed.jaw(-20 * DEGREE).wait(is_busy=True)
    assert homed.insert(0.1).wait()
    assert homed.fresh("setpoint_js").position[2] == pytest.approx(0.1, abs=1e-6)
    assert homed.fresh("jaw/setpoint_js").position[0] == pytest.approx(-20 * DEGREE, abs=1e-6)
    assert homed.jaw(60 * DEGREE).wait(is_busy=True)
    timed(lambda: homed.insert(0.12).wait(), 0.632)


def test_a11_a_jaw_that_moves_during_a_move_of_the_arm_leaves_its_goal(homed: Arm) -> None:
    goal = moved(homed.fresh("setpoint_cp").pose, -0.05)
    assert homed.move_cp(goal).wait(is_busy=True)
    assert homed.jaw(-20 * DEGREE).wait()
    assert distance(homed.fresh("measured_cp").pose, goal) < 1e-5
    assert homed.fresh("jaw/setpoint_js").position[0] == pytest.approx(-20 * DEGREE, abs=1e-6)


def test_a12_a_servoed_jaw_is_followed_and_moves_on(homed: Arm) -> None:
    assert homed.jaw(50 * DEGREE).wait()
    seen: list[float] = []

    def step(at: float) -> None:
        angle = 50 * DEGREE + 30 * DEGREE * math.sin(math.tau / 2.5 * at)
        homed.joints("jaw/servo_jp", [angle])
        seen.append(homed.read("jaw/setpoint_js").position[0])

    stream(step, 2.5)
    assert max(seen) > 78 * DEGREE
    assert min(seen) < 22 * DEGREE
    timed(lambda: homed.jaw(60 * DEGREE).wait(), 0.1)
    timed(lambda: homed.jaw(-20 * DEGREE).wait(), 0.667)


def test_a13_a_second_move_takes_over_without_a_jump(homed: Arm) -> None:
    angles: list[tuple[float, float]] = []
    homed.listeners["setpoint_js"] = [
        lambda message: angles.append((seconds(message.header), message.velocity[0]))
    ]
    homed.told["goal_reached"].clear()
    homed.move_jp([60 * DEGREE, *ZERO[1:]])
    time.sleep(0.2)
    assert homed.move_jp([-10 * DEGREE, *ZERO[1:]]).wait()
    homed.fresh("setpoint_js")
    homed.listeners.clear()
    assert homed.ros.until(lambda: homed.told["goal_reached"], 2.0)
    assert homed.told["goal_reached"] == [True]
    # Its acceleration is limited, on the whole way.
    for (earlier, before), (later, after) in itertools.pairwise(angles):
        assert abs(after - before) <= 90 * DEGREE * (later - earlier + 0.02)


def test_a14_a_ratio_slows_moves_down(homed: Arm) -> None:
    homed.send("trajectory_j/set_ratio", Float64(data=0.5))
    assert homed.ros.until(lambda: homed.latest["trajectory_j/ratio"].data == 0.5, 5.0)
    timed(lambda: homed.move_jp([10 * DEGREE, *ZERO[1:]]).wait(), 0.943)
    for refused in (0.0, 1.5):
        homed.send("trajectory_j/set_ratio", Float64(data=refused))
    assert homed.ros.until(lambda: len(homed.told["warning"]) == 2, 5.0)
    assert "]0, 1]" in homed.told["warning"][0]
    assert homed.latest["trajectory_j/ratio"].data == 0.5
    homed.send("trajectory_j/set_ratio", Float64(data=1.0))
    assert homed.ros.until(lambda: homed.latest["trajectory_j/ratio"].data == 1.0, 5.0)
