"""What scripts import as ``crtk``: the ROS layer without ROS, and the methods of an interface.

The names, what is returned and what is raised are those of ``crtk_python_client`` 1.4. Behind them
is the live world of this process (:func:`trocar.dvrk.use`) instead of topics.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.dvrk._world import Feed, World, current
from trocar.errors import ServerLost, TransportError

try:
    import PyKDL as kdl  # noqa: N813
except ImportError:
    from trocar.dvrk import kdl

__all__ = ["move_handle", "ral", "utils", "wait_move_handle"]

Numbers = NDArray[np.float64]

PARTS = ("jaw", "local", "body", "spatial")
"""Namespaces below an arm's."""


class time_point:  # noqa: N801
    """A moment or a duration: what ``now``, ``create_time`` and ``create_duration`` return."""

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds

    @property
    def nanoseconds(self) -> int:
        """The same in ns."""
        return round(self.seconds * 1e9)

    def to_sec(self) -> float:
        """The same in s."""
        return self.seconds

    def __add__(self, other: time_point) -> time_point:
        return time_point(self.seconds + other.seconds)

    def __sub__(self, other: time_point) -> time_point:
        return time_point(self.seconds - other.seconds)

    def __lt__(self, other: time_point) -> bool:
        return self.seconds < other.seconds

    def __le__(self, other: time_point) -> bool:
        return self.seconds <= other.seconds

    def __repr__(self) -> str:
        return f"{self.seconds:.9f} s"


class rate:  # noqa: N801
    """Lets a loop run so many times a second."""

    def __init__(self, world: World, hertz: float) -> None:
        self._world, self._period = world, 1.0 / hertz
        self._next = world.elapsed() + self._period

    def sleep(self) -> None:
        """Sleeps until the next multiple of the period; a loop that is late goes on at once."""
        left = self._next - self._world.elapsed()
        if left < -self._period:
            self._next = self._world.elapsed()
        self._world.sleep(max(left, 0.0))
        self._next += self._period


class ral:  # noqa: N801
    """The layer between a script and what carries its messages."""

    def __init__(self, node_name: str, namespace: str = "", node: Any = None) -> None:
        self._node_name, self._namespace = node_name, namespace.strip("/")
        self._children: dict[str, ral] = {}
        self._world = current()
        self._root: ral = node if isinstance(node, ral) else self
        self._is_shutdown = False
        self._callbacks: list[Callable[[], object]] = []

    @staticmethod
    def ros_version() -> int:
        """2: scripts that ask do as with ROS 2."""
        return 2

    @staticmethod
    def parse_argv(argv: list[str]) -> list[str]:
        """The arguments without those that are ROS's own."""
        kept, is_ros = [], False
        for argument in argv:
            if argument in ("--ros-args", "--"):
                is_ros = argument == "--ros-args"
            elif not is_ros and ":=" not in argument:
                kept.append(argument)
        return kept

    def node_name(self) -> str:
        """The script's name."""
        return self._node_name

    def namespace(self) -> str:
        """Where its names begin."""
        return self._namespace

    def create_child(self, child_namespace: str) -> ral:
        """The layer for names below this one's."""
        if child_namespace in self._children:
            raise RuntimeError(f'ral object already has child "{child_namespace}"!')
        below = f"{self._namespace}/{child_namespace.strip('/')}"
        child = self._children[child_namespace] = ral(self._node_name, below, self._root)
        return child

    def now(self) -> time_point:
        """The script's time."""
        return time_point(self._world.now())

    def get_timestamp(self, of: Any) -> Any:
        """The time of a message, a header or a stamp."""
        of = getattr(of, "header", of)
        return getattr(of, "stamp", of)

    def to_sec(self, of: Any) -> float:
        """A time in s."""
        of = self.get_timestamp(of)
        return float(of.nanoseconds) / 1e9 if hasattr(of, "nanoseconds") else float(of)

    def create_duration(self, seconds: float) -> time_point:
        """A duration."""
        return time_point(seconds)

    def create_time(self) -> time_point:
        """The time 0."""
        return time_point(0.0)

    def create_rate(self, rate_hz: float) -> rate:
        """What lets a loop run so many times a second."""
        return rate(self._world, rate_hz)

    def set_timestamp(self, message: Any) -> None:
        """Gives a message the present time."""
        message.header.stamp = self.now()

    def spin(self) -> None:
        """Nothing: what arms tell is heard when the script waits or reads."""

    def spin_and_execute(self, function: Callable[..., object], *arguments: Any) -> None:
        """Runs a function, then shuts down."""
        with contextlib.suppress(KeyboardInterrupt):
            function(*arguments)
        self.shutdown()

    def on_shutdown(self, callback: Callable[[], object]) -> None:
        """Has something called at :meth:`shutdown`."""
        self._root._callbacks.append(callback)

    def is_shutdown(self) -> bool:
        """Whether :meth:`shutdown` was called."""
        return self._root._is_shutdown

    def shutdown(self) -> None:
        """Calls what was to be called then; the world goes on."""
        if not self._root._is_shutdown:
            self._root._is_shutdown = True
            for callback in self._root._callbacks:
                callback()

    def publisher(self, topic: str, *_: Any, **__: Any) -> Any:
        """Refused: there are no topics."""
        raise NotImplementedError(
            f"publisher({topic!r}): there is no ROS here; the classes of dvrk and crtk.utils reach "
            "the arms"
        )

    subscriber = publisher
    service_client = publisher

    def check_connections(self, timeout_seconds: float = 5.0, check_children: bool = True) -> None:
        """Whether all that the script wants to reach is there.

        Raises:
            TimeoutError: Something is not, which it names.
        """
        if timeout_seconds == 0.0:
            return
        known = (*self._world.feeds, *self._world.objects, "system", "console", "")
        missing = sorted(
            name for name in self._names(check_children) if name.split("/")[0] not in known
        )
        if missing:
            self._world.sleep(timeout_seconds)
            there = ", ".join([*self._world.feeds, *self._world.objects])
            raise TimeoutError(
                f"timed out waiting for {', '.join(missing)}; this world has {there}"
            )

    def _names(self, with_children: bool) -> list[str]:
        names = [self._namespace.strip("/")]
        if with_children:
            for child in self._children.values():
                names += child._names(True)
        return names


class move_handle:  # noqa: N801
    """A move that was commanded: waits for its end."""

    def __init__(self, world: World, feed: Feed | None) -> None:
        self._world, self._feed = world, feed
        if feed is not None:
            self._began = world.elapsed()
            self._count, self._busy_count = feed.count, feed.busy_count

    def wait(self, is_busy: bool = False, timeout: float = 30.0) -> bool:
        """Waits until the arm was busy since, and is not any more; whether that came in time.

        With ``is_busy``, it waits until the arm is busy. True does not say that the goal was
        reached: a move that was stopped has ended, too.
        """
        feed = self._has_feed()

        def holds() -> bool:
            return feed.busy_count > self._busy_count and (is_busy or not feed.is_busy)

        return self._world.wait(holds, timeout)

    def is_busy(self, timeout: float = 30.0) -> bool:
        """Whether the move goes on, or was not heard of yet."""
        feed = self._has_feed()
        self._world.hear()
        if feed.count > self._count:
            return feed.is_busy
        if self._world.elapsed() - self._began > timeout:
            raise RuntimeWarning("is_busy: no operating_state since the move was commanded")
        return True

    def _has_feed(self) -> Feed:
        if self._feed is None:
            raise RuntimeWarning("the class has no CRTK operating state to wait for")
        return self._feed


wait_move_handle = move_handle


class utils:  # noqa: N801
    """Gives an object the methods of an arm's, a jaw's or an object's interface.

    Args:
        class_instance: The object that gets the methods.
        ral: The layer below whose namespace the interface is: ``PSM1``, ``PSM1/jaw``, ``needle``.
        connection_timeout: Longest silence after which readings fail, s.
        operating_state_instance: The object whose operating state moves are waited for by.
    """

    def __init__(
        self,
        class_instance: Any,
        ral: ral,
        connection_timeout: float = 1.0,
        operating_state_instance: Any = None,
    ) -> None:
        self._of, self._timeout = class_instance, connection_timeout
        self._world: World = ral._world
        self._name, _, self._part = ral.namespace().strip("/").partition("/")
        self._feed: Feed | None = None
        if operating_state_instance is not None:
            self._feed = self._world.feeds.get(self._name)

    def remove_all(self) -> None:
        """Nothing: the methods stay."""

    def _add(self, name: str, method: Callable[..., object]) -> None:
        if hasattr(self._of, name):
            raise RuntimeWarning(f"{name} already exists")
        setattr(self._of, name, method)

    def _topic(self, name: str) -> str:
        return f"{self._part}/{name}" if self._part else name

    def _is_arm(self) -> bool:
        return self._name in self._world.feeds

    def _send(self, topic: str, numbers: Any = (), more: Any = (), text: str = "") -> None:
        if self._is_arm():
            self._world.command(self._name, self._topic(topic), numbers, more, text)

    def _move(self, topic: str, numbers: Any, more: Any = ()) -> move_handle:
        # What was commanded before is not to be taken for this move.
        self._world.hear()
        handle = move_handle(self._world, self._feed)
        self._send(topic, numbers, more)
        return handle

    def _read(self, get: Callable[[], Any], wait_timeout: float | None) -> Any:
        """What an arm measured; readings fail where there is no such arm, or no server."""
        known = self._is_arm() or (not self._part and self._name in self._world.objects)
        if not known:
            self._world.sleep(wait_timeout or 0.0)
            raise TimeoutError(f"{self._name}: no data received yet")
        try:
            self._world.read()
            return get()
        except (ServerLost, TransportError) as error:
            self._world.sleep(self._timeout)
            raise TimeoutError(f"{self._name}: no data for {self._timeout} s ({error})") from error

    # ---- Operating state ----

    def add_operating_state(self) -> None:
        """``enable``, ``home`` and the like, and what tells of the state."""
        if self._feed is not None:
            raise RuntimeWarning(f"overwriting the operating state of {self._name}")
        self._feed = feed = self._world.feeds.get(self._name, Feed())
        world = self._world

        def told(value: Any, extra: Any) -> Any:
            return (value, world.stamped(feed.stamp)) if extra else value

        def heard() -> Feed:
            world.hear()
            return feed

        def command(word: str) -> None:
            self._send("state_command", text=word)

        def change(word: str, is_already: bool, holds: Callable[[], bool], wait: float) -> bool:
            if is_already:
                command(word)
                world.look()
                return True
            count = feed.count
            command(word)
            if wait <= 0.0:
                # As with messages: none comes in no time.
                world.look()
                return False
            return world.wait(lambda: feed.count > count and holds(), wait)

        def homes(is_homed: bool) -> Callable[[], bool]:
            return lambda: feed.is_homed == is_homed and not feed.is_busy

        def wait_for_busy(
            is_busy: bool = False, start_time: Any = 0.0, timeout: float = 30.0
        ) -> bool:
            start = getattr(start_time, "seconds", start_time)
            return world.wait(
                lambda: world.stamped(feed.stamp) > start and feed.is_busy == is_busy, timeout
            )

        def wait_for_operating_state(expected_state: str, timeout: float) -> bool:
            return world.wait(lambda: feed.state == expected_state, timeout)

        methods: dict[str, Callable[..., object]] = {
            "operating_state": lambda extra=None: told(heard().state, extra),
            "wait_for_operating_state": wait_for_operating_state,
            "wait_for_busy": wait_for_busy,
            "state_command": command,
            "is_enabled": lambda: heard().state == "ENABLED",
            "is_disabled": lambda: heard().state == "DISABLED",
            "is_homed": lambda extra=None: told(heard().is_homed, extra),
            "is_busy": lambda extra=None: told(heard().is_busy, extra),
            "enable": lambda timeout=0.0: change(
                "enable", heard().state == "ENABLED", lambda: feed.state == "ENABLED", timeout
            ),
            "disable": lambda timeout=0.0: change(
                "disable", heard().state == "DISABLED", lambda: feed.state == "DISABLED", timeout
            ),
            "home": lambda timeout=0.0: change("home", heard().is_homed, homes(True), timeout),
            "unhome": lambda timeout=0.0: change(
                "unhome", not heard().is_homed, homes(False), timeout
            ),
        }
        for name, method in methods.items():
            self._add(name, method)

    # ---- What can be read ----

    def _add_js(self, of: str) -> None:
        is_setpoint = of == "setpoint"

        def state(wait_timeout: float | None = None) -> tuple[Numbers, Numbers, Numbers, float]:
            def get() -> tuple[Numbers, Numbers, Numbers, float]:
                is_jaw = self._part == "jaw"
                p, v, stamp = self._world.live.joints(self._name, setpoint=is_setpoint, jaw=is_jaw)
                if is_jaw and is_setpoint:
                    v = v[:0]
                return p, v, np.zeros(len(p)), self._world.stamped(stamp)

            got: tuple[Numbers, Numbers, Numbers, float] = self._read(get, wait_timeout)
            return got

        def part(index: int) -> Callable[..., tuple[Numbers, float]]:
            def get(wait_timeout: float | None = None) -> tuple[Numbers, float]:
                all_of = state(wait_timeout)
                return all_of[index], all_of[3]  # type: ignore[return-value]

            return get

        self._add(f"{of}_js", state)
        for index, letter in enumerate("pvf"):
            self._add(f"{of}_j{letter}", part(index))

    def add_measured_js(self) -> None:
        """``measured_js``, ``measured_jp``, ``measured_jv``, ``measured_jf``."""
        self._add_js("measured")

    def add_setpoint_js(self) -> None:
        """``setpoint_js``, ``setpoint_jp``, ``setpoint_jv``, ``setpoint_jf``."""
        self._add_js("setpoint")

    def _add_cp(self, topic: str) -> None:
        def pose(wait_timeout: float | None = None) -> tuple[Any, float]:
            def get() -> tuple[Any, float]:
                if self._is_arm():
                    numbers, stamp = self._world.live.pose(self._name, self._topic(topic))
                else:
                    numbers = self._world.live.object(self._world.objects[self._name])
                    stamp = (self._world.live.ticks + 1) / 240.0
                return frame_of(numbers), self._world.stamped(stamp)

            got: tuple[Any, float] = self._read(get, wait_timeout)
            return got

        self._add(topic, pose)

    def add_measured_cp(self) -> None:
        """``measured_cp``: where the wrist, the camera or an object is."""
        self._add_cp("measured_cp")

    def add_setpoint_cp(self) -> None:
        """``setpoint_cp``."""
        self._add_cp("setpoint_cp")

    def _add_six(self, topic: str, get: Callable[[], tuple[Any, float]]) -> None:
        def read(wait_timeout: float | None = None) -> tuple[Numbers, float]:
            numbers, stamp = self._read(get, wait_timeout)
            return np.array(numbers), self._world.stamped(stamp)

        self._add(topic, read)

    def add_measured_cv(self) -> None:
        """``measured_cv``: m/s and rad/s."""
        self._add_six("measured_cv", lambda: self._world.live.twist(self._name))

    def add_measured_cf(self) -> None:
        """``measured_cf``: zeros, since no efforts are simulated."""
        self._add_six("measured_cf", lambda: (np.zeros(6), self._world.live.twist(self._name)[1]))

    def add_jacobian(self) -> None:
        """``jacobian``: a matrix, and when it was received."""

        def jacobian(wait_timeout: float | None = None) -> tuple[Numbers, float]:
            def get() -> tuple[Numbers, float]:
                numbers, _ = self._world.ask(self._name, f"{self._part or 'body'}/jacobian", ())
                return np.array(numbers).reshape(6, -1) if numbers else np.zeros((6, 0)), 0.0

            matrix, _ = self._read(get, wait_timeout)
            return matrix, self._world.now()

        self._add("jacobian", jacobian)

    # ---- Commands ----

    def add_hold(self) -> None:
        """``hold``."""
        self._add("hold", lambda: self._send("hold"))

    def add_free(self) -> None:
        """``free``."""
        self._add("free", lambda: self._send("free"))

    def add_servo_jp(self) -> None:
        """``servo_jp``: positions, and velocities where they are known."""

        def servo_jp(setpoint_p: Numbers, setpoint_v: Numbers | None = None) -> None:
            velocity = [] if setpoint_v is None else setpoint_v.tolist()
            self._send("servo_jp", setpoint_p.tolist(), velocity)

        self._add("servo_jp", servo_jp)

    def _add_joints(self, topic: str) -> None:
        self._add(topic, lambda numbers: self._send(topic, numbers.tolist()))

    def add_servo_jr(self) -> None:
        """``servo_jr``."""
        self._add_joints("servo_jr")

    def add_servo_jv(self) -> None:
        """``servo_jv``, which dVRK's arms do not have."""
        self._add_joints("servo_jv")

    def add_servo_jf(self) -> None:
        """``servo_jf``: no efforts are simulated, and the arm says so."""
        self._add_joints("servo_jf")

    def add_servo_cp(self) -> None:
        """``servo_cp``."""
        self._add("servo_cp", lambda setpoint: self._send("servo_cp", *numbers_of(setpoint)))

    def add_servo_cv(self) -> None:
        """``servo_cv``, which dVRK's arms do not have."""
        self._add("servo_cv", lambda setpoint: self._send("servo_cv", [float(n) for n in setpoint]))

    def add_servo_cf(self) -> None:
        """``servo_cf``: no efforts are simulated, and the arm says so."""
        self._add("servo_cf", lambda setpoint: self._send("servo_cf", [float(n) for n in setpoint]))

    def _add_move(self, topic: str) -> None:
        self._add(topic, lambda goal: self._move(topic, goal.tolist()))

    def add_move_jp(self) -> None:
        """``move_jp``, which returns a handle."""
        self._add_move("move_jp")

    def add_move_jr(self) -> None:
        """``move_jr``, which returns a handle."""
        self._add_move("move_jr")

    def add_move_cp(self) -> None:
        """``move_cp``, which returns a handle."""
        self._add("move_cp", lambda goal: self._move("move_cp", *numbers_of(goal)))

    # ---- Services ----

    def add_forward_kinematics(self) -> None:
        """``forward_kinematics``: a frame, or with ``extra`` also whether and why not."""

        def forward_kinematics(jp: Numbers, extra: Any = None) -> Any:
            self._world.hear()
            question = self._topic("forward_kinematics")
            numbers, why = self._world.ask(self._name, question, jp.tolist())
            frame = frame_of(numbers) if numbers else kdl.Frame()
            return (frame, not why, why) if extra else frame

        self._add("forward_kinematics", forward_kinematics)

    def add_inverse_kinematics(self) -> None:
        """``inverse_kinematics``: joints near to others for a pose below the remote centre."""

        def inverse_kinematics(jp: Numbers, cp: Any, extra: Any = None) -> Any:
            self._world.hear()
            position, orientation = numbers_of(cp)
            joints, why = self._world.ask(
                self._name, "inverse_kinematics", [*position, *orientation], jp.tolist()
            )
            return (np.array(joints), not why, why) if extra else np.array(joints)

        self._add("inverse_kinematics", inverse_kinematics)


def frame_of(numbers: Any) -> Any:
    """A frame of x, y, z and x, y, z, w of a quaternion; the identity where that is none."""
    x, y, z, *quaternion = numbers
    if math.fsum(n * n for n in quaternion) < 0.5:
        return kdl.Frame()
    return kdl.Frame(kdl.Rotation.Quaternion(*quaternion), kdl.Vector(x, y, z))


def numbers_of(frame: Any) -> tuple[list[float], list[float]]:
    """The position and the quaternion of a frame."""
    p = frame.p
    return [p[0], p[1], p[2]], list(frame.M.GetQuaternion())
