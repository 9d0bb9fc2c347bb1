"""Bad use of an arm (B1 to B12 of the list in the issue), over ROS 2 in real time."""

from __future__ import annotations

import math
import time

import pytest
from conftest import Start
from crtk_client import Arm
from crtk_msgs.srv import QueryForwardKinematics, QueryInverseKinematics
from geometry_msgs.msg import Pose
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from test_scenarios import DEGREE, ZERO, moved


def until_setpoint(arm: Arm, index: int, value: float) -> bool:
    return arm.ros.until(lambda: abs(arm.latest["setpoint_js"].position[index] - value) < 1e-4, 5.0)


def test_b1_a_disabled_arm_ignores_motions_and_says_so(psm: Arm) -> None:
    psm.read("measured_js")
    assert psm.disable(5)
    before = psm.fresh("measured_js").position[0]
    psm.told["warning"].clear()
    move = psm.move_jp([0.5, *ZERO[1:]])
    psm.servo_jp([0.5, *ZERO[1:]])
    assert not move.wait(timeout=2)
    assert len(psm.told["warning"]) == 1
    assert "not ready" in psm.told["warning"][0]
    assert psm.fresh("measured_js").position[0] == before


def test_b2_homing_a_disabled_arm_is_answered_and_does_nothing(psm: Arm) -> None:
    count = len(psm.states)
    assert psm.disable(5)
    assert psm.ros.until(lambda: len(psm.states) > count, 5.0)
    count = len(psm.states)
    assert not psm.home(2)
    assert len(psm.states) == count + 1
    assert (psm.state.state, psm.state.is_homed) == ("DISABLED", False)


def test_b3_and_b4_goals_beyond_limits_are_clipped(homed: Arm) -> None:
    assert homed.move_jp([120 * DEGREE, *ZERO[1:]]).wait()
    assert until_setpoint(homed, 0, 1.588)
    assert homed.jaw(-90 * DEGREE).wait()
    assert homed.ros.until(
        lambda: abs(homed.latest["jaw/setpoint_js"].position[0] + 40 * DEGREE) < 1e-6, 5.0
    )
    assert not homed.told["error"]


def test_b5_a_pose_out_of_reach_moves_a_psm_to_clipped_joints(homed: Arm) -> None:
    assert homed.move_cp(moved(homed.fresh("setpoint_cp").pose, x=1.0)).wait()
    assert homed.ros.until(lambda: homed.told["goal_reached"], 5.0)
    assert homed.told["goal_reached"] == [True]


def test_b6_a_jump_that_the_arm_does_not_follow_is_a_fault(homed: Arm) -> None:
    homed.servo_jp([60 * DEGREE, *ZERO[1:]])
    assert homed.ros.until(lambda: homed.state.state == "FAULT", 5.0)
    assert homed.ros.until(lambda: homed.told["error"], 5.0)
    assert "tracking error" in homed.told["error"][0]
    assert homed.enable(5)


def test_b6_an_arm_that_lags_faults_as_well_and_recovers(start: Start) -> None:
    lagging = Arm(start("--task", "NeedleReach-v0", "--errors", "dvrk"), "PSM1")
    lagging.check_connections()
    assert lagging.enable(10)
    assert lagging.home(10)
    assert lagging.move_jp(ZERO).wait()
    lagging.servo_jp([60 * DEGREE, *ZERO[1:]])
    assert lagging.ros.until(lambda: lagging.told["error"], 5.0)
    assert "tracking error" in lagging.told["error"][0]
    assert lagging.ros.until(lambda: lagging.state.state == "FAULT", 5.0)
    assert lagging.enable(5)
    assert lagging.home(10)
    assert lagging.move_jp(ZERO).wait()


def test_b7_disabling_during_a_move_stops_it(homed: Arm) -> None:
    assert homed.move_jp([60 * DEGREE, *ZERO[1:]]).wait(is_busy=True)
    time.sleep(0.2)
    assert homed.disable(5)
    stopped = homed.fresh("measured_js").position[0]
    assert 0.0 < stopped < 50 * DEGREE
    assert not homed.move_jp(ZERO).wait(timeout=0.5)
    assert homed.fresh("measured_js").position[0] == stopped


def test_b8_holding_during_a_move_stops_it(homed: Arm) -> None:
    move = homed.move_jp([60 * DEGREE, *ZERO[1:]])
    assert move.wait(is_busy=True)
    time.sleep(0.2)
    homed.send("hold")
    assert move.wait()
    assert homed.ros.until(lambda: homed.told["goal_reached"] == [False], 5.0)
    held = homed.fresh("setpoint_js").position[0]
    time.sleep(0.1)
    assert homed.fresh("setpoint_js").position[0] == held < 50 * DEGREE


@pytest.mark.parametrize("topic", ["move_jp", "servo_jp", "servo_jr", "move_jr"])
@pytest.mark.parametrize(
    "joints",
    [ZERO[:5], [*ZERO, 0.0, 0.0], [math.nan, *ZERO[1:]], [math.inf, *ZERO[1:]], [0.0] * 1000, []],
    ids=["5", "8", "nan", "inf", "1000", "none"],
)
def test_b10_bad_joints_are_refused_by_name(
    homed_once: Arm, topic: str, joints: list[float]
) -> None:
    arm = homed_once
    arm.told["error"].clear()
    arm.joints(topic, joints)
    assert arm.ros.until(lambda: arm.told["error"], 5.0)
    assert topic in arm.told["error"][0]
    assert not arm.state.is_busy


@pytest.fixture(scope="module")
def homed_once(psm: Arm) -> Arm:
    assert psm.enable(10)
    assert psm.home(10)
    return psm


@pytest.mark.parametrize("topic", ["move_cp", "servo_cp"])
def test_b10_bad_poses_are_refused_by_name(homed_once: Arm, topic: str) -> None:
    arm = homed_once
    good = arm.fresh("setpoint_cp").pose
    not_a_number = moved(good)
    not_a_number.position.x = math.nan
    for bad, frame in [(Pose(), ""), (not_a_number, ""), (good, "nowhere"), (good, "x" * 5000)]:
        if bad == Pose():
            bad.orientation.w = 0.0
        arm.told["error"].clear()
        arm.pose(topic, bad, frame)
        assert arm.ros.until(lambda: arm.told["error"], 5.0), (bad, frame)
        assert topic in arm.told["error"][0]
    # The arm still moves.
    assert arm.move_jp(ZERO).wait()


def test_b10_messages_of_another_type_do_no_harm(homed_once: Arm) -> None:
    ros = homed_once.ros
    wrong = ros.node.create_publisher(String, "PSM1/servo_jp_", 10)
    for _ in range(100):
        wrong.publish(String(data="x" * 100))
    homed_once.send("servo_jp", JointState(name=["x" * 10000] * 100))
    assert homed_once.move_jp(ZERO).wait()


def test_b11_services_answer_along_the_chain_and_back(homed_once: Arm) -> None:
    node, ros = homed_once.ros.node, homed_once.ros
    forward = node.create_client(QueryForwardKinematics, "PSM1/forward_kinematics")
    local = node.create_client(QueryForwardKinematics, "PSM1/local/forward_kinematics")
    inverse = node.create_client(QueryInverseKinematics, "PSM1/inverse_kinematics")

    def ask(client: object, joints: list[float]) -> object:
        return ros.call(client, QueryForwardKinematics.Request(jp=joints))

    for count in (0, 3, 6):
        assert ask(forward, [0.1, 0.2, 0.12, 0.3, 0.4, 0.5][:count]).result
    too_many = ask(forward, [0.0] * 7)
    assert not too_many.result
    assert too_many.message
    assert not ask(forward, [0.0] * 100).result
    joints = [0.1, 0.2, 0.12, 0.3, 0.4, 0.5]
    request = QueryInverseKinematics.Request(cp=ask(local, joints).cp, jp=ZERO)
    answer = ros.call(inverse, request)
    assert answer.result
    assert list(answer.jp) == pytest.approx(joints, abs=1e-9)
    request.jp = [0.0] * 3
    assert not ros.call(inverse, request).result


def test_faults_that_are_emulated_are_met_as_real_ones_are(homed: Arm) -> None:
    def emulate(word: str) -> None:
        homed.send("emulate_fault", String(data=word))

    emulate("stuck_jaw")
    time.sleep(0.5)  # two topics have no order
    assert homed.jaw(30 * DEGREE).wait()
    assert homed.fresh("jaw/setpoint_js").position[0] > 29 * DEGREE
    assert homed.fresh("jaw/measured_js").position[0] < 0.1
    emulate("none")
    assert homed.ros.until(lambda: homed.latest["jaw/measured_js"].position[0] > 29 * DEGREE, 5.0)
    emulate("lost_homing")
    assert homed.ros.until(lambda: not homed.state.is_homed, 5.0)
    assert homed.home(10)
    emulate("fault")
    assert homed.ros.until(lambda: homed.state.state == "FAULT", 5.0)
    assert homed.enable(5)
    assert homed.home(10)


def test_b12_a_script_that_starts_late_learns_the_state_by_homing(homed_once: Arm) -> None:
    late = Arm(homed_once.ros, "PSM1")
    late.check_connections()
    assert late.home(10)
    assert late.ros.until(lambda: late.state is not None, 5.0)
    assert late.state.is_homed


def test_b9_readings_stop_with_the_program(start: Start) -> None:
    ros = start("--task", "NeedleReach-v0")
    arm = Arm(ros, "PSM1")
    arm.fresh("measured_js")
    start.stop(ros)
    time.sleep(0.2)
    with pytest.raises(TimeoutError):
        arm.fresh("measured_js", timeout=1.0)
