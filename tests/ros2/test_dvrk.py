"""All of a da Vinci at once: both PSMs and the ECM, console, system, objects and pictures."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from conftest import Start
from crtk_client import LATCHED, VOLATILE, Arm, Ros, seconds
from crtk_msgs.srv import TriggerOperatingState
from endoscope import unpacked
from geometry_msgs.msg import Pose, PoseStamped
from sensor_msgs.msg import CameraInfo, CompressedImage
from std_msgs.msg import Bool, Empty, Float64, Float64MultiArray, String
from test_scenarios import moved

ARMS = ["PSM1", "PSM2", "ECM"]

TICK = 1.0 / 240.0
"""Of the world, s."""

ALL = {
    "state_command": "crtk_msgs/msg/StringStamped",
    "hold free": "std_msgs/msg/Empty",
    "servo_jp servo_jr servo_jf move_jp move_jr": "sensor_msgs/msg/JointState",
    "servo_cp move_cp set_base_frame": "geometry_msgs/msg/PoseStamped",
    "spatial/servo_cf body/servo_cf": "geometry_msgs/msg/WrenchStamped",
    "body/set_cf_orientation_absolute use_gravity_compensation": "std_msgs/msg/Bool",
    "trajectory_j/set_ratio trajectory_j/set_ratio_v trajectory_j/set_ratio_a": (
        "std_msgs/msg/Float64"
    ),
    "servo_cs": "crtk_msgs/msg/CartesianServo",
    "servo_ci": "crtk_msgs/msg/CartesianImpedance",
    "operating_state": "crtk_msgs/msg/OperatingState",
    "measured_js setpoint_js": "sensor_msgs/msg/JointState",
    "measured_cp setpoint_cp local/measured_cp local/setpoint_cp": "geometry_msgs/msg/PoseStamped",
    "measured_cv local/measured_cv setpoint_cv": "geometry_msgs/msg/TwistStamped",
    "spatial/measured_cf body/measured_cf": "geometry_msgs/msg/WrenchStamped",
    "spatial/jacobian body/jacobian": "std_msgs/msg/Float64MultiArray",
    "trajectory_j/ratio trajectory_j/ratio_v trajectory_j/ratio_a": "std_msgs/msg/Float64",
    "goal_reached": "std_msgs/msg/Bool",
    "desired_state error warning status": "std_msgs/msg/String",
    "measured_cs": "crtk_msgs/msg/CartesianState",
    "period_statistics": "cisst_msgs/msg/IntervalStatistics",
    "arm_clutch IO/adapter IO/tool IO/arm_clutch IO/SUJ_clutch": "sensor_msgs/msg/Joy",
}
PSM_ALONE = {
    "emulate_tool_present emulate_adapter_present": "std_msgs/msg/Bool",
    "jaw/servo_jp jaw/move_jp jaw/servo_jf jaw/measured_js jaw/setpoint_js": (
        "sensor_msgs/msg/JointState"
    ),
    "set_tool_type tool_type tool_type_request": "std_msgs/msg/String",
}
ECM_ALONE = {"set_endoscope_type endoscope_type": "std_msgs/msg/String"}
CONSOLE = {
    "teleop/enable teleop/enabled": "std_msgs/msg/Bool",
    "teleop/set_scale teleop/scale": "std_msgs/msg/Float64",
    "teleop/select teleop/unselect teleop/selected teleop/unselected": "std_msgs/msg/String",
    "emulate_operator_present emulate_clutch emulate_camera": "sensor_msgs/msg/Joy",
    "operator_present clutch camera": "sensor_msgs/msg/Joy",
}
SYSTEM = {
    "power_on power_off home": "std_msgs/msg/Empty",
    "set_volume volume": "std_msgs/msg/Float64",
    "beep": "std_msgs/msg/Float64MultiArray",
    "string_to_speech": "std_msgs/msg/String",
}
SERVICES = {
    "forward_kinematics local/forward_kinematics": "crtk_msgs/srv/QueryForwardKinematics",
    "inverse_kinematics": "crtk_msgs/srv/QueryInverseKinematics",
    "operating_state": "crtk_msgs/srv/TriggerOperatingState",
}


def named(below: str, topics: dict[str, str]) -> dict[str, str]:
    return {f"/{below}/{name}": kind for names, kind in topics.items() for name in names.split()}


@pytest.fixture(scope="module")
def da_vinci(start: Start) -> Ros:
    return start("--task", "BiPegTransfer-v0", "--images", "5")


@pytest.fixture(scope="module")
def arms(da_vinci: Ros) -> list[Arm]:
    arms = [Arm(da_vinci, name, jaw=name != "ECM") for name in ARMS]
    for arm in arms:
        arm.check_connections()
    return arms


def listen(ros: Ros, kind: Any, topic: str, qos: Any = VOLATILE) -> list[Any]:
    """What comes on a topic from now on."""
    heard: list[Any] = []

    def note(message: Any) -> None:
        with ros.changed:
            heard.append(message)
            ros.changed.notify_all()

    ros.node.create_subscription(kind, topic, note, qos)
    return heard


def test_every_topic_and_service_of_a_da_vinci_is_there(arms: list[Arm]) -> None:
    ros = arms[0].ros
    expected = named("console", CONSOLE) | named("system", SYSTEM)
    services = {}
    for arm in ARMS:
        expected |= named(arm, ALL) | named(arm, ECM_ALONE if arm == "ECM" else PSM_ALONE)
        services |= named(arm, SERVICES)

    def there(found: list[tuple[str, list[str]]]) -> dict[str, str]:
        return {name: kinds[0] for name, kinds in found}

    def missing(expected: dict[str, str], find: Callable[[], Any]) -> set[tuple[str, str]]:
        """What was not discovered within a while."""
        deadline = time.monotonic() + 20.0
        while lacks := set(expected.items()) - set(there(find()).items()):
            if time.monotonic() > deadline:
                break
            time.sleep(0.05)
        return lacks

    assert not missing(expected, ros.node.get_topic_names_and_types)
    assert not missing(services, ros.node.get_service_names_and_types)
    # And nothing that is not listed, but for what is CRTK's, and what only a simulator knows.
    crtk = {"servo_jv", "servo_cv", "servo_cr", "move_cr", "goal_js", "goal_cp", "emulate_fault"}
    more = {
        name
        for name in there(ros.node.get_topic_names_and_types())
        if name.split("/")[1] in (*ARMS, "console", "system") and name not in expected
    }
    assert {name.rsplit("/", 1)[1] for name in more} <= crtk


def test_both_instruments_and_the_endoscope_move_at_once(arms: list[Arm]) -> None:
    assert all(arm.enable(10) for arm in arms)
    for arm in arms:
        arm.state_command("home")
    assert all(arm.home(20) for arm in arms)
    moves = [
        arm.move_jp([0.1, 0.05, 0.13, 0.0, 0.0, 0.0][: 4 if arm.name == "ECM" else 6])
        for arm in arms
    ]
    assert all(move.wait() for move in moves)
    for arm in arms:
        measured, setpoint = arm.fresh("measured_js"), arm.fresh("setpoint_js")
        assert list(measured.position[:3]) == pytest.approx([0.1, 0.05, 0.13], abs=1e-4)
        assert list(setpoint.position[:3]) == pytest.approx([0.1, 0.05, 0.13], abs=1e-9)
    # Servoed, too, all of them at 100 Hz.
    began = time.monotonic()
    for step in range(100):
        for arm in arms:
            goal = list(arm.latest["setpoint_js"].position)
            goal[0] = 0.1 * math.cos(math.pi * step / 100)
            arm.servo_jp(goal)
        time.sleep(max(0.0, began + step / 100 - time.monotonic()))
    for arm in arms:
        assert arm.ros.until(lambda arm=arm: arm.latest["setpoint_js"].position[0] < -0.09, 5.0)
        assert arm.told["error"] == []


def test_b5_the_endoscope_refuses_a_pose_out_of_reach(arms: list[Arm]) -> None:
    ecm = arms[-1]
    assert ecm.enable(10)
    assert ecm.home(20)
    for told in ecm.told.values():
        told.clear()
    before = ecm.fresh("setpoint_js").position
    move = ecm.move_cp(moved(ecm.fresh("setpoint_cp").pose, x=1.0))
    assert ecm.ros.until(lambda: ecm.told["goal_reached"] and ecm.told["error"], 5.0)
    assert ecm.told["goal_reached"] == [False]
    assert not move.wait(timeout=0.5)
    assert ecm.fresh("setpoint_js").position == before
    ecm.told["error"].clear()


def test_one_publication_has_one_stamp(arms: list[Arm]) -> None:
    """A script that is late misses messages, so the stamps of both topics are judged together."""
    arm = arms[0]
    measured: list[float] = []
    setpoint: list[float] = []
    arm.listeners["measured_js"] = [lambda m: measured.append(seconds(m.header))]
    arm.listeners["setpoint_cp"] = [lambda m: setpoint.append(seconds(m.header))]
    assert arm.ros.until(lambda: len(set(measured) & set(setpoint)) > 20, 30.0)
    arm.listeners.clear()
    for stamps in (measured, setpoint):
        assert stamps == sorted(set(stamps))
    every = sorted({*measured, *setpoint})
    assert min(later - earlier for earlier, later in itertools.pairwise(every)) > 0.5 * TICK


def test_the_system_powers_and_homes_all_arms(arms: list[Arm]) -> None:
    ros = arms[0].ros
    publishers = {
        word: ros.node.create_publisher(Empty, f"system/{word}", VOLATILE)
        for word in ("power_off", "power_on", "home")
    }
    assert ros.until(lambda: True, 0)
    assert all(ros_matched(publisher) for publisher in publishers.values())
    publishers["power_off"].publish(Empty())
    assert ros.until(lambda: all(arm.state.state == "DISABLED" for arm in arms), 10)
    publishers["power_on"].publish(Empty())
    assert ros.until(lambda: all(arm.state.state == "ENABLED" for arm in arms), 10)
    publishers["home"].publish(Empty())
    assert ros.until(lambda: all(arm.state.is_homed and not arm.state.is_busy for arm in arms), 20)
    client = ros.node.create_client(TriggerOperatingState, "ECM/operating_state")
    state = ros.call(client, TriggerOperatingState.Request()).operating_state
    assert (state.state, state.is_homed) == ("ENABLED", True)
    assert abs(seconds(state.header) - time.time()) < 5.0


def ros_matched(publisher: Any, timeout: float = 10.0) -> bool:
    deadline = time.monotonic() + timeout
    while publisher.get_subscription_count() == 0:
        if time.monotonic() > deadline:
            return False
        time.sleep(0.01)
    return True


def test_the_console_keeps_what_it_is_told(da_vinci: Ros) -> None:
    scale = listen(da_vinci, Float64, "console/teleop/scale", LATCHED)
    selected = listen(da_vinci, String, "console/teleop/selected", LATCHED)
    assert da_vinci.until(lambda: scale, 10)
    assert scale[0].data == 0.2
    publishers = [
        (da_vinci.node.create_publisher(Float64, "console/teleop/set_scale", 1), Float64(data=0.3)),
        (
            da_vinci.node.create_publisher(String, "console/teleop/select", 1),
            String(data="MTMR_PSM1"),
        ),
    ]
    for publisher, message in publishers:
        assert ros_matched(publisher)
        publisher.publish(message)
    assert da_vinci.until(lambda: scale[-1].data == 0.3 and selected, 10)
    assert selected[-1].data == "MTMR_PSM1"


def test_both_lenses_show_the_world_as_the_endoscope_moves(arms: list[Arm]) -> None:
    ros, ecm = arms[0].ros, arms[2]
    sides = ("left", "right")
    images = [
        listen(ros, CompressedImage, f"endoscope/{side}/image_raw/compressed") for side in sides
    ]
    infos = [listen(ros, CameraInfo, f"endoscope/{side}/camera_info") for side in sides]
    assert ros.until(lambda: all(images) and all(infos), 20)
    for image, info, side in zip(images, infos, sides, strict=True):
        picture = unpacked(bytes(image[-1].data))
        assert picture.shape == (info[-1].height, info[-1].width, 3)
        assert len(np.unique(picture)) > 50, "there is something to see"
        assert image[-1].header.frame_id == f"endoscope_{side}"
        assert info[-1].k[0] == info[-1].p[0] > 100
    assert infos[0][-1].p[3] == 0.0 > infos[1][-1].p[3]
    assert images[0][-1].data != images[1][-1].data
    before = bytes(images[0][-1].data)
    assert ecm.enable(10)
    assert ecm.home(20)
    assert ecm.move_jp([0.3, 0.0, 0.12, 0.0]).wait()
    count = len(images[0])
    assert ros.until(lambda: len(images[0]) > count + 1, 20)
    assert bytes(images[0][-1].data) != before


TIP = 0.0102
RADIUS = 0.02


def cross(one: list[float], other: list[float]) -> list[float]:
    (a, b, c), (x, y, z) = one, other
    return [b * z - c * y, c * x - a * z, a * y - b * x]


def turned(pose: Pose, x: float, y: float, z: float) -> list[float]:
    """A vector of a pose's axes in those of its frame."""
    turn = pose.orientation
    axis = [turn.x, turn.y, turn.z]
    double = [2.0 * number for number in cross(axis, [x, y, z])]
    more = cross(axis, double)
    return [v + turn.w * d + m for v, d, m in zip((x, y, z), double, more, strict=True)]


def test_a_needle_is_picked_and_placed_by_commands_of_a_robot_alone(start: Start) -> None:
    ros = start("--task", "NeedlePick-v0", "--frames", "world")
    arm = Arm(ros, "PSM1")
    arm.check_connections()
    needle = listen(ros, PoseStamped, "needle/measured_cp")
    goal = listen(ros, Float64MultiArray, "task/desired_goal")
    success = listen(ros, Bool, "task/is_success")
    assert arm.enable(10)
    assert arm.home(10)
    assert ros.until(lambda: needle and goal and success, 10)
    assert not success[-1].data
    lies = needle[-1].pose

    def middle(pose: Pose) -> list[float]:
        arc = turned(pose, -RADIUS, 0.0, 0.0)
        at = pose.position
        return [at.x + arc[0], at.y + arc[1], at.z + arc[2]]

    wire = turned(lies, 0.0, 1.0, 0.0)
    yaw = math.atan2(wire[1], wire[0])
    yaw -= math.pi * round(yaw / math.pi)
    grasp = Pose()
    # Straight down, and turned about the vertical.
    grasp.orientation.x, grasp.orientation.y = math.cos(yaw / 2), math.sin(yaw / 2)
    grasp.orientation.w = 0.0
    at = middle(lies)

    def go(x: float, y: float, z: float) -> None:
        grasp.position.x, grasp.position.y, grasp.position.z = x, y, z
        assert arm.move_cp(grasp).wait()

    depth = TIP - 0.00045
    assert arm.jaw(math.radians(40)).wait()
    go(at[0], at[1], at[2] + depth + 0.02)
    go(at[0], at[1], at[2] + depth)
    assert arm.jaw(math.radians(-20)).wait()
    go(at[0], at[1], at[2] + depth + 0.02)
    needle.clear()
    assert ros.until(lambda: len(needle) > 5, 5)
    way = [there - here for there, here in zip(goal[-1].data, middle(needle[-1].pose), strict=True)]
    go(at[0] + way[0], at[1] + way[1], at[2] + depth + 0.02 + way[2])
    assert ros.until(lambda: success[-1].data, 5), "the needle is at the goal"
    assert needle[-1].pose.position.z > lies.position.z + 0.005
    assert needle[-1].header.frame_id == "world"
    assert arm.told["error"] == []
