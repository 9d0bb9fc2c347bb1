"""A small client of CRTK arms over rclpy, as a user of ROS 2 would write it: it drives the arms."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

import rclpy
from crtk_msgs.msg import OperatingState, StringStamped
from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Empty, Float64, Float64MultiArray, String

VOLATILE = QoSProfile(depth=10)
LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)

STATES = {
    "measured_js": JointState,
    "setpoint_js": JointState,
    "measured_cp": PoseStamped,
    "setpoint_cp": PoseStamped,
}
"""What the tests read of every arm."""

MORE_STATES = {
    "local/measured_cp": PoseStamped,
    "local/setpoint_cp": PoseStamped,
    "measured_cv": TwistStamped,
    "spatial/measured_cf": WrenchStamped,
    "body/measured_cf": WrenchStamped,
    "spatial/jacobian": Float64MultiArray,
    "body/jacobian": Float64MultiArray,
}
"""What dVRK's client reads besides."""

COMMANDS = {
    "state_command": StringStamped,
    "hold": Empty,
    "free": Empty,
    "servo_jp": JointState,
    "servo_jr": JointState,
    "servo_jf": JointState,
    "servo_cp": PoseStamped,
    "move_jp": JointState,
    "move_jr": JointState,
    "move_cp": PoseStamped,
    "spatial/servo_cf": WrenchStamped,
    "body/servo_cf": WrenchStamped,
    "body/set_cf_orientation_absolute": Bool,
    "use_gravity_compensation": Bool,
    "trajectory_j/set_ratio": Float64,
}
"""What dVRK's client sends."""

JAW_STATES = {"jaw/measured_js": JointState, "jaw/setpoint_js": JointState}
JAW_COMMANDS = {
    "jaw/servo_jp": JointState,
    "jaw/move_jp": JointState,
    "jaw/servo_jf": JointState,
    "emulate_tool_present": Bool,
    "emulate_fault": String,
}


def seconds(header: Any) -> float:
    """A header's stamp, s since 1970."""
    return header.stamp.sec + header.stamp.nanosec * 1e-9


class Ros:
    """A context of rclpy with one node, whose callbacks run in a thread of their own."""

    def __init__(self, domain: int, name: str = "script") -> None:
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = rclpy.create_node(name, context=self.context)
        self.changed = threading.Condition()
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)
        self._is_closing = False
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def _spin(self) -> None:
        while not self._is_closing:
            self._executor.spin_once(timeout_sec=0.1)

    def until(self, holds: Callable[[], Any], timeout: float) -> bool:
        """Waits until something holds that messages change; whether it does."""
        with self.changed:
            return self.changed.wait_for(lambda: bool(holds()), timeout)

    def call(self, client: Any, request: Any, timeout: float = 10.0) -> Any:
        """Calls a service."""
        assert client.wait_for_service(timeout)
        future, done = client.call_async(request), threading.Event()
        future.add_done_callback(lambda _: done.set())
        assert done.wait(timeout), client.srv_name
        return future.result()

    def close(self) -> None:
        self._is_closing = True
        self._thread.join()
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


class Handle:
    """A move that was commanded."""

    def __init__(self, arm: Arm) -> None:
        self._arm, self._busy, self._sent = arm, arm.busy_count, time.time()

    def wait(self, is_busy: bool = False, timeout: float = 30.0) -> bool:
        """Waits until the arm was busy since, and is not any more, or with `is_busy` still is."""
        arm = self._arm
        return arm.ros.until(
            lambda: arm.busy_count > self._busy and (is_busy or not arm.state.is_busy), timeout
        )

    def is_busy(self) -> bool:
        """Whether no state since the move was commanded says that it has ended."""
        state = self._arm.state
        return state is None or seconds(state.header) <= self._sent or state.is_busy


class Arm:
    """An arm: the latest message of each topic, and its commands."""

    def __init__(self, ros: Ros, name: str, jaw: bool = True, everything: bool = False) -> None:
        self.ros, self.name = ros, name
        self.latest: dict[str, Any] = {}
        self.state: Any = None
        self.states: list[OperatingState] = []
        self.busy_count = 0
        self.told: dict[str, list[Any]] = {"goal_reached": [], "warning": [], "error": []}
        self.listeners: dict[str, list[Callable[[Any], None]]] = {}
        node = ros.node
        self._subscriptions = [
            node.create_subscription(
                OperatingState, f"{name}/operating_state", self._heed, VOLATILE
            )
        ]
        read = STATES | (JAW_STATES if jaw else {}) | (MORE_STATES if everything else {})
        for topic, kind in read.items():
            self.listen(topic, kind)
        for topic, kind in {"goal_reached": Bool, "warning": String, "error": String}.items():
            self._subscriptions.append(
                node.create_subscription(kind, f"{name}/{topic}", self._tell(topic), VOLATILE)
            )
        self.listen("trajectory_j/ratio", Float64, LATCHED)
        commands = COMMANDS | (JAW_COMMANDS if jaw else {})
        self.publishers = {
            topic: node.create_publisher(
                kind, f"{name}/{topic}", LATCHED if topic == "state_command" else VOLATILE
            )
            for topic, kind in commands.items()
        }

    def _heed(self, message: OperatingState) -> None:
        with self.ros.changed:
            self.state = message
            self.states.append(message)
            self.busy_count += message.is_busy
            self.ros.changed.notify_all()

    def _tell(self, topic: str) -> Callable[[Any], None]:
        def told(message: Any) -> None:
            with self.ros.changed:
                self.told[topic].append(message.data)
                self.ros.changed.notify_all()

        return told

    def listen(self, topic: str, kind: Any, qos: QoSProfile = VOLATILE) -> None:
        """Keeps the latest message of a topic."""

        def heard(message: Any) -> None:
            for listener in self.listeners.get(topic, []):
                listener(message)
            with self.ros.changed:
                self.latest[topic] = message
                self.ros.changed.notify_all()

        self._subscriptions.append(
            self.ros.node.create_subscription(kind, f"{self.name}/{topic}", heard, qos)
        )

    def check_connections(self, timeout: float = 10.0) -> None:
        """As `crtk.ral`: every publisher has a subscriber and every subscription a publisher."""
        deadline = time.time() + timeout
        node = self.ros.node
        while True:
            missing = [
                topic
                for topic, publisher in self.publishers.items()
                if publisher.get_subscription_count() == 0
            ]
            missing += [
                subscription.topic_name
                for subscription in self._subscriptions
                if node.count_publishers(subscription.topic_name) == 0
            ]
            if not missing:
                return
            if time.time() > deadline:
                raise TimeoutError(f"{self.name}: not connected: {', '.join(missing)}")
            time.sleep(0.02)

    def read(self, topic: str, timeout: float = 5.0) -> Any:
        """The latest message."""
        if not self.ros.until(lambda: topic in self.latest, timeout):
            raise TimeoutError(f"{self.name}/{topic}: no data received yet")
        return self.latest[topic]

    def fresh(self, topic: str, timeout: float = 5.0) -> Any:
        """A message about a moment after this call: messages may wait for their turn."""
        now = time.time()

        def is_fresh() -> bool:
            return topic in self.latest and seconds(self.latest[topic].header) > now

        if not self.ros.until(is_fresh, timeout):
            raise TimeoutError(f"{self.name}/{topic}: no data")
        return self.latest[topic]

    # ---- States ----

    def state_command(self, word: str) -> None:
        message = StringStamped(string=word)
        message.header.stamp = self.ros.node.get_clock().now().to_msg()
        self.publishers["state_command"].publish(message)

    def _change(self, word: str, holds: Callable[[Any], bool], timeout: float) -> bool:
        if self.state is not None and holds(self.state):
            self.state_command(word)
            return True
        count = len(self.states)
        self.state_command(word)
        return self.ros.until(lambda: len(self.states) > count and holds(self.states[-1]), timeout)

    def enable(self, timeout: float = 10.0) -> bool:
        return self._change("enable", lambda state: state.state == "ENABLED", timeout)

    def disable(self, timeout: float = 10.0) -> bool:
        return self._change("disable", lambda state: state.state == "DISABLED", timeout)

    def home(self, timeout: float = 10.0) -> bool:
        return self._change("home", lambda state: state.is_homed and not state.is_busy, timeout)

    # ---- Motion ----

    def send(self, topic: str, message: Any = None) -> Handle:
        handle = Handle(self)
        self.publishers[topic].publish(Empty() if message is None else message)
        return handle

    def joints(
        self, topic: str, position: Sequence[float], velocity: Sequence[float] = ()
    ) -> Handle:
        return self.send(
            topic, JointState(position=list(map(float, position)), velocity=list(velocity))
        )

    def move_jp(self, position: Sequence[float]) -> Handle:
        return self.joints("move_jp", position)

    def servo_jp(self, position: Sequence[float], velocity: Sequence[float] = ()) -> None:
        self.joints("servo_jp", position, velocity)

    def pose(self, topic: str, pose: Any, frame: str = "") -> Handle:
        message = PoseStamped(pose=pose)
        message.header.frame_id = frame
        message.header.stamp = self.ros.node.get_clock().now().to_msg()
        return self.send(topic, message)

    def move_cp(self, pose: Any) -> Handle:
        return self.pose("move_cp", pose)

    def insert(self, depth: float) -> Handle:
        goal = list(self.fresh("setpoint_js").position)
        goal[2] = depth
        return self.move_jp(goal)

    def jaw(self, angle: float) -> Handle:
        return self.joints("jaw/move_jp", [angle])
