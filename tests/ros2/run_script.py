"""Runs a script for a dVRK over ROS 2: ``python run_script.py SCRIPT args…``, on $ROS_DOMAIN_ID.

``-m MODULE`` in place of the script runs a module. A lab has ``crtk``, ``dvrk`` and ``PyKDL``, of
which no wheels exist. Here, the client of these tests has their names, as far as the policy runner
and the examples of ``client-py/examples/dvrk`` use them.
"""

from __future__ import annotations

import importlib.util
import math
import os
import runpy
import sys
import time
import types
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from crtk_client import VOLATILE, Arm, Handle, Ros, seconds
from geometry_msgs.msg import Pose, PoseStamped
from std_msgs.msg import Float64

KDL = Path(__file__).parents[2] / "client-py/python/trocar/dvrk/kdl.py"
_spec = importlib.util.spec_from_file_location("PyKDL", KDL)
assert _spec is not None
assert _spec.loader is not None
kdl: Any = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(kdl)


def frame_of(message: PoseStamped) -> Any:
    """A message as a frame."""
    position, turn = message.pose.position, message.pose.orientation
    rotation = kdl.Rotation.Quaternion(turn.x, turn.y, turn.z, turn.w)
    return kdl.Frame(rotation, kdl.Vector(position.x, position.y, position.z))


def pose_of(frame: Any) -> Pose:
    """A frame as it is in messages."""
    pose = Pose()
    pose.position.x, pose.position.y, pose.position.z = frame.p
    turn = frame.M.GetQuaternion()
    pose.orientation.x, pose.orientation.y, pose.orientation.z, pose.orientation.w = turn
    return pose


class Rate:
    """Lets a loop run so many times a second."""

    def __init__(self, hertz: float) -> None:
        self._period, self._next = 1.0 / hertz, time.monotonic() + 1.0 / hertz

    def sleep(self) -> None:
        time.sleep(max(self._next - time.monotonic(), 0.0))
        self._next = max(self._next, time.monotonic() - self._period) + self._period


class Ral:
    """What a script calls ``crtk.ral``."""

    opened: ClassVar[list[Ros]] = []

    def __init__(self, name: str, root: Ral | None = None) -> None:
        self.name = name
        self.root = root or self
        self.arms: list[Arm] = []
        if root is None:
            self.ros = Ros(int(os.environ.get("ROS_DOMAIN_ID", "0")), name)
            self.opened.append(self.ros)

    parse_argv = staticmethod(list)
    to_sec = staticmethod(float)

    def now(self) -> float:
        return time.time()

    def spin(self) -> None:
        """Callbacks run from the beginning on."""

    def create_child(self, name: str) -> Ral:
        return Ral(name, self.root)

    def create_rate(self, hertz: float) -> Rate:
        return Rate(hertz)

    def check_connections(self, timeout: float = 10.0) -> None:
        for arm in self.root.arms:
            arm.check_connections(timeout)


class Utils:
    """What a script calls ``crtk.utils``: the methods of a CRTK interface, here of an object's."""

    def __init__(self, instance: Any, ral: Ral, timeout: float) -> None:
        self._instance, self._ral, self._timeout = instance, ral, timeout

    def add_measured_cp(self) -> None:
        latest: list[PoseStamped] = []
        ros, topic = self._ral.root.ros, f"/{self._ral.name}/measured_cp"

        def heard(message: PoseStamped) -> None:
            with ros.changed:
                latest[:] = [message]
                ros.changed.notify_all()

        def measured_cp(wait_timeout: float = 0.0) -> tuple[Any, float]:
            if not ros.until(lambda: latest, wait_timeout):
                raise TimeoutError(f"{topic}: no data received yet")
            return frame_of(latest[0]), 0.0

        self._subscription = ros.node.create_subscription(PoseStamped, topic, heard, VOLATILE)
        self._instance.measured_cp = measured_cp


class Jaw:
    """The jaw of a PSM."""

    def __init__(self, arm: Arm) -> None:
        self._arm = arm

    def open(self, angle: float = math.radians(60.0)) -> Handle:
        return self._arm.jaw(angle)

    def close(self) -> Handle:
        return self._arm.jaw(math.radians(-20.0))

    def measured_jp(self) -> tuple[Any, float]:
        return np.array(self._arm.read("jaw/measured_js").position), 0.0


class Psm:
    """A patient-side manipulator."""

    def __init__(self, ral: Ral, name: str) -> None:
        self._ral, self._arm = ral, Arm(ral.root.ros, name)
        ral.root.arms.append(self._arm)
        self.jaw = Jaw(self._arm)
        self.enable, self.home = self._arm.enable, self._arm.home

    def name(self) -> str:
        return self._arm.name

    def ral(self) -> Ral:
        return self._ral

    def trajectory_j_set_ratio(self, ratio: float) -> None:
        self._arm.send("trajectory_j/set_ratio", Float64(data=ratio))

    def _joints(self, topic: str) -> tuple[Any, float]:
        return np.array(self._arm.read(topic).position), 0.0

    def setpoint_jp(self) -> tuple[Any, float]:
        # A script moves on from there. Topics have no order: the latest may be of the move before.
        return np.array(self._arm.fresh("setpoint_js").position), 0.0

    def measured_jp(self) -> tuple[Any, float]:
        return self._joints("measured_js")

    def setpoint_cp(self) -> tuple[Any, float]:
        return frame_of(self._arm.fresh("setpoint_cp")), 0.0

    def measured_cp(self) -> tuple[Any, float]:
        return frame_of(self._arm.read("measured_cp")), 0.0

    def move_jp(self, goal: Any) -> Handle:
        return self._arm.move_jp(goal)

    def move_cp(self, goal: Any) -> Handle:
        return self._arm.move_cp(pose_of(goal))

    def servo_cp(self, setpoint: Any) -> None:
        self._arm.pose("servo_cp", pose_of(setpoint))


class Local:
    """The poses of an arm in the frame of its remote centre."""

    def __init__(self, arm: Arm) -> None:
        self._arm = arm
        arm.listen("local/measured_cp", PoseStamped)

    def measured_cp(self) -> tuple[Any, float]:
        message = self._arm.read("local/measured_cp")
        return frame_of(message), seconds(message.header)


class Ecm:
    """An endoscope camera manipulator."""

    def __init__(self, ral: Ral, name: str) -> None:
        self._arm = Arm(ral.root.ros, name, jaw=False)
        ral.root.arms.append(self._arm)
        self.local = Local(self._arm)
        self.enable, self.home = self._arm.enable, self._arm.home
        self.servo_jp = self._arm.servo_jp

    def is_enabled(self) -> bool:
        return self._arm.state is not None and self._arm.state.state == "ENABLED"

    def is_homed(self) -> bool:
        return self._arm.state is not None and bool(self._arm.state.is_homed)

    def hold(self) -> None:
        self._arm.send("hold")

    def _joints(self, topic: str) -> tuple[Any, Any, Any, float]:
        message = self._arm.read(topic)
        parts = (message.position, message.velocity, message.effort)
        position, velocity, effort = map(np.array, parts)
        return position, velocity, effort, seconds(message.header)

    def measured_js(self) -> tuple[Any, Any, Any, float]:
        return self._joints("measured_js")

    def setpoint_js(self) -> tuple[Any, Any, Any, float]:
        return self._joints("setpoint_js")


def main() -> None:
    """Puts the names in place, and runs the script."""
    crtk: Any = types.ModuleType("crtk")
    crtk.ral, crtk.utils = Ral, Utils
    dvrk: Any = types.ModuleType("dvrk")
    dvrk.psm, dvrk.ecm = Psm, Ecm
    sys.modules.update({"crtk": crtk, "dvrk": dvrk, "PyKDL": kdl})
    del sys.argv[0]
    try:
        if sys.argv[0] == "-m":
            del sys.argv[0]
            runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)
        else:
            runpy.run_path(sys.argv[0], run_name="__main__")
    finally:
        for ros in Ral.opened:
            ros.close()


if __name__ == "__main__":
    main()
