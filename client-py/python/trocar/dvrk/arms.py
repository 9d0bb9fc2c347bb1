"""What scripts import as ``dvrk``: arms, console and system of a da Vinci Research Kit.

The names, what is returned and what is raised are those of ``dvrk_python`` 2.4.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from trocar.dvrk import crtk
from trocar.dvrk._world import World

__all__ = ["arm", "console", "ecm", "psm", "system"]


class _WrenchPart:
    """What an arm has below ``body`` and ``spatial``."""

    def __init__(self, ral: crtk.ral, timeout: float) -> None:
        interface = crtk.utils(self, ral, timeout)
        interface.add_measured_cf()
        interface.add_servo_cf()
        interface.add_jacobian()


class _LocalPart:
    """What an arm has below ``local``: poses in the frame of the remote centre."""

    def __init__(self, ral: crtk.ral, timeout: float) -> None:
        interface = crtk.utils(self, ral, timeout)
        interface.add_measured_cp()
        interface.add_setpoint_cp()
        interface.add_forward_kinematics()


class _Jaw:
    """The jaw of a PSM. Its handles wait for the arm, whose trajectory it is part of."""

    move_jp: Any

    def __init__(self, ral: crtk.ral, timeout: float, arm: Any) -> None:
        interface = crtk.utils(self, ral, timeout, arm)
        interface.add_measured_js()
        interface.add_setpoint_js()
        interface.add_servo_jp()
        interface.add_move_jp()
        interface.add_servo_jf()

    def close(self) -> crtk.move_handle:
        """Moves to -20 degrees."""
        return self.move_jp(np.array([math.radians(-20.0)]))  # type: ignore[no-any-return]

    def open(self, angle: float = math.radians(60.0)) -> crtk.move_handle:
        """Moves to an angle, rad: 60 degrees unless another is given."""
        return self.move_jp(np.array([angle]))  # type: ignore[no-any-return]


class arm:  # noqa: N801
    """An arm: what PSM and ECM have in common.

    Args:
        ral: The layer of the script.
        arm_name: ``PSM1``, ``PSM2`` or ``ECM``.
        connection_timeout: Longest silence after which readings fail, s.
    """

    setpoint_jp: Any
    move_jp: Any

    def __init__(self, ral: crtk.ral, arm_name: str, connection_timeout: float = 1.0) -> None:
        self._name = arm_name
        self._ral = ral.create_child(arm_name)
        self._world: World = ral._world
        interface = crtk.utils(self, self._ral, connection_timeout)
        interface.add_operating_state()
        interface.add_setpoint_js()
        interface.add_setpoint_cp()
        interface.add_measured_js()
        interface.add_measured_cp()
        interface.add_measured_cv()
        interface.add_hold()
        interface.add_free()
        interface.add_servo_jp()
        interface.add_servo_jr()
        interface.add_servo_cp()
        interface.add_servo_jf()
        interface.add_move_jp()
        interface.add_move_jr()
        interface.add_move_cp()
        interface.add_forward_kinematics()
        interface.add_inverse_kinematics()
        self.spatial = _WrenchPart(self._ral.create_child("spatial"), connection_timeout)
        self.body = _WrenchPart(self._ral.create_child("body"), connection_timeout)
        self.local = _LocalPart(self._ral.create_child("local"), connection_timeout)

    def name(self) -> str:
        """The arm's name."""
        return self._name

    def ral(self) -> crtk.ral:
        """The layer of the arm."""
        return self._ral

    def check_connections(self, timeout: float = 5.0) -> None:
        """As :meth:`crtk.ral.check_connections`."""
        self._ral.check_connections(timeout)

    def _send(self, topic: str, numbers: Any) -> None:
        if self._name in self._world.feeds:
            self._world.command(self._name, topic, numbers)

    def body_set_cf_orientation_absolute(self, absolute: bool) -> None:
        """Whether wrenches are in the axes of the reference frame; none are simulated."""
        self._send("body/set_cf_orientation_absolute", [float(absolute)])

    def use_gravity_compensation(self, gravity_compensation: bool) -> None:
        """Whether the arm's weight is held; no efforts are simulated."""
        self._send("use_gravity_compensation", [float(gravity_compensation)])

    def trajectory_j_set_ratio(self, ratio: float) -> None:
        """Scales velocities and accelerations of moves, in ]0, 1]."""
        self._send("trajectory_j/set_ratio", [ratio])

    def trajectory_j_get_ratio(self) -> float:
        """The ratio."""
        if self._name not in self._world.feeds:
            return 1.0
        self._world.hear()
        return self._world.live.status(self._name)[0]

    trajectory_j_ratio = trajectory_j_get_ratio

    def _insert(self, depth: float) -> crtk.move_handle:
        joints, _ = self.setpoint_jp()
        goal = np.copy(joints)
        goal[2] = depth
        return self.move_jp(goal)  # type: ignore[no-any-return]


class psm(arm):  # noqa: N801
    """A patient-side manipulator: an arm with a tool that has a jaw."""

    def __init__(self, ral: crtk.ral, arm_name: str, connection_timeout: float = 5.0) -> None:
        super().__init__(ral, arm_name, connection_timeout)
        self.jaw = _Jaw(self._ral.create_child("/jaw"), connection_timeout, self)

    def insert_jp(self, depth: float) -> crtk.move_handle:
        """Moves the insertion to a depth, m."""
        return self._insert(depth)

    def set_tool_present(self, tool_present: bool) -> None:
        """Puts the tool in, or takes it out."""
        self._send("emulate_tool_present", [float(tool_present)])


class ecm(arm):  # noqa: N801
    """An endoscope camera manipulator."""

    def __init__(self, ral: crtk.ral, arm_name: str, connection_timeout: float = 5.0) -> None:
        super().__init__(ral, arm_name, connection_timeout)

    def insert_jp(self, depth: float) -> crtk.move_handle:
        """Moves the insertion to a depth, m."""
        return self._insert(depth)


class system:  # noqa: N801
    """The power, the homing and the sounds of all arms. There are no loudspeakers."""

    def __init__(self, ral: crtk.ral, system_namespace: str = "system") -> None:
        self._ral = ral.create_child(system_namespace)
        self._world: World = ral._world

    def _all(self, word: str, only_faulted: bool = False) -> None:
        for name, feed in self._world.feeds.items():
            if not only_faulted or feed.state == "FAULT":
                self._world.command(name, "state_command", text=word)

    def power_off(self) -> None:
        """Disables all arms."""
        self._all("disable")

    def power_on(self) -> None:
        """Enables all arms; those that have faulted are disabled first."""
        self._world.hear()
        self._all("disable", only_faulted=True)
        self._all("enable")

    def home(self) -> None:
        """Enables and homes all arms."""
        self._all("enable")
        self._all("home")

    def set_volume(self, volume: float) -> None:
        """Nothing."""

    def beep(self, duration: float, frequency: float, volume: float = 1.0) -> None:
        """Nothing."""

    def string_to_speech(self, string: str) -> None:
        """Nothing."""


class console:  # noqa: N801
    """The teleoperation of a console. There are no masters, so nothing follows them."""

    def __init__(self, ral: crtk.ral, console_name: str = "console") -> None:
        self._ral = ral.create_child(console_name)
        self._scale = 0.2
        self._selected: set[tuple[str, str]] = set()

    def teleop_start(self) -> None:
        """Nothing."""

    def teleop_stop(self) -> None:
        """Nothing."""

    def teleop_set_scale(self, scale: float) -> None:
        """Sets the scale between masters and arms."""
        self._scale = scale

    def teleop_get_scale(self) -> float:
        """The scale: 0.2 at first."""
        return self._scale

    def teleop_select(self, mtm: str, psm: str) -> None:
        """Selects a pair."""
        self._selected.add((mtm, psm))

    def teleop_unselect(self, mtm: str, psm: str) -> None:
        """Selects a pair no more."""
        self._selected.discard((mtm, psm))

    def teleop_is_selected(self, mtm: str, psm: str) -> bool:
        """Whether a pair is selected."""
        return (mtm, psm) in self._selected
