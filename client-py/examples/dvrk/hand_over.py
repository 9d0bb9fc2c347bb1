"""Lays a needle down, picks it up, hands it from PSM1 to PSM2, and lays it down elsewhere.

Commands of a robot alone, and friction. Where the needle is comes from its topic, ``measured_cp``
below ``needle``, which a camera has to publish on a robot, in the frame of both arms. Here:
``python -m trocar.dvrk --task NeedleRegrasp-v0 --homing in_place --frames world hand_over.py``
"""

import math
import sys
import time
from typing import Any

import crtk
import dvrk
import PyKDL

RADIUS = 0.02  # of the needle's arc, m; its frame is in the centre, x points away from the middle
GRASPS = {"PSM1": -math.radians(60), "PSM2": math.radians(60)}  # from the middle of the arc
TIP = 0.0102  # from measured_cp to the tip of closed jaws, m
LYING = 0.0006  # how far below the middle of the wire the tips are where it lies, m
IN_AIR = 0.003  # the same in the air
HOVER = 0.025  # above a grasp, m
WIRE = 0.0005  # radius of the wire, m
TRAY = 0.6813  # height of its floor, m
MIDDLE = (0.575, 0.02)  # where the needle is handed over, m
LAST = (0.575, -0.02)  # where it is laid down at last, m
HERTZ, SPEED, TURNING = 100.0, 0.02, 0.6  # of servoed motions: Hz, m/s, rad/s
HEIGHT = 0.03  # of the hand-over above the tray, m


class Needle:
    """Where the needle is."""

    def __init__(self, ral: Any) -> None:
        self._topics = crtk.utils(self, ral.create_child("needle"), 1.0)
        self._topics.add_measured_cp()

    def frame(self) -> PyKDL.Frame:
        """The centre of its arc."""
        return self.measured_cp(wait_timeout=1.0)[0]

    def rests(self) -> PyKDL.Frame:
        """Where it is once it does not move any more."""
        before = self.frame()
        for _ in range(100):
            time.sleep(0.1)
            now = self.frame()
            if (now.p - before.p).Norm() < 1e-5:
                return now
            before = now
        sys.exit("the needle does not come to rest")


def grasp(needle: PyKDL.Frame, angle: float, depth: float) -> PyKDL.Frame:
    """Jaws straight down that close across the wire, turned as little as possible."""
    turn = PyKDL.Rotation.RotZ(angle)
    wire = (needle.M * turn).UnitY()
    yaw = math.atan2(wire[1], wire[0])
    yaw -= math.pi * round(yaw / math.pi)
    down = PyKDL.Rotation.RotZ(yaw) * PyKDL.Rotation.RotX(math.pi)
    place = needle * (turn * PyKDL.Vector(-RADIUS, 0.0, 0.0))
    return PyKDL.Frame(down, place + PyKDL.Vector(0.0, 0.0, TIP - depth))


def raised(frame: PyKDL.Frame, by: float) -> PyKDL.Frame:
    """The same further up."""
    return PyKDL.Frame(frame.M, frame.p + PyKDL.Vector(0.0, 0.0, by))


def move(psm: Any, goal: PyKDL.Frame) -> None:
    """Moves, and ends the script where that fails."""
    if not psm.move_cp(goal).wait():
        sys.exit(f"{psm.name()} did not get there")


def pick(psm: Any, where: PyKDL.Frame) -> None:
    """Closes the jaws about the needle, from above."""
    psm.jaw.open(math.radians(40)).wait()
    move(psm, raised(where, HOVER))
    move(psm, where)
    psm.jaw.close().wait()


def let_go(psm: Any) -> None:
    """Opens the jaws and goes back along the instrument, then up."""
    psm.jaw.open(math.radians(40)).wait()
    move(psm, psm.setpoint_cp()[0] * PyKDL.Frame(PyKDL.Vector(0.0, 0.0, -HOVER)))
    move(psm, raised(psm.setpoint_cp()[0], HOVER))


def carry(psm: Any, needle: PyKDL.Frame, there: PyKDL.Frame) -> None:
    """Brings the needle that the jaws hold to where it shall be, straight and slowly."""
    start, _ = psm.setpoint_cp()
    goal = there * needle.Inverse() * start
    way = goal.p - start.p
    angle, axis = (start.M.Inverse() * goal.M).GetRotAngle()
    steps = math.ceil(HERTZ * max(way.Norm() / SPEED, angle / TURNING, 0.1))
    rate = psm.ral().create_rate(HERTZ)
    for step in range(1, steps + 1):
        part = 0.5 - 0.5 * math.cos(math.pi * step / steps)
        turn = PyKDL.Rotation.Rot(axis, part * angle)
        psm.servo_cp(PyKDL.Frame(start.M * turn, start.p + part * way))
        rate.sleep()


def flat(needle: PyKDL.Frame, place: tuple[float, float], height: float) -> PyKDL.Frame:
    """The needle flat above a place of the tray, its swage towards PSM1, the same side up."""
    turn = PyKDL.Rotation() if needle.M.UnitZ()[2] > 0.0 else PyKDL.Rotation.RotY(math.pi)
    return PyKDL.Frame(turn, PyKDL.Vector(*place, TRAY + WIRE + height))


def millimetres(needle: PyKDL.Frame) -> str:
    """The place of the needle in words."""
    return ", ".join(f"{1e3 * coordinate:.1f}" for coordinate in needle.p) + " mm"


def main() -> None:
    """Runs the script."""
    crtk.ral.parse_argv(sys.argv[1:])
    ral = crtk.ral("hand_over")
    one, two = dvrk.psm(ral, "PSM1"), dvrk.psm(ral, "PSM2")
    needle = Needle(ral)
    ral.check_connections()
    for psm in (one, two):
        if not (psm.enable(10) and psm.home(10)):
            sys.exit(f"{psm.name()} is not ready")
        psm.trajectory_j_set_ratio(0.3)

    # PSM1 holds it, upright: its lowest point is let down to the tray.
    held = needle.frame()
    carry(one, held, raised(held, TRAY + RADIUS + WIRE - held.p[2]))
    let_go(one)
    lying = needle.rests()
    print(f"PSM1 has laid the needle down at {millimetres(lying)}")
    pick(one, grasp(lying, GRASPS["PSM1"], LYING))
    carry(one, lying, flat(lying, MIDDLE, HEIGHT))
    pick(two, grasp(needle.frame(), GRASPS["PSM2"], IN_AIR))
    let_go(one)
    held = needle.frame()
    if held.p[2] < TRAY + HEIGHT / 2.0:
        sys.exit("PSM2 does not hold the needle")
    print(f"PSM2 has the needle at {millimetres(held)}")
    for height in (HEIGHT, IN_AIR):
        carry(two, needle.frame(), flat(needle.frame(), LAST, height))
    let_go(two)
    lying = needle.rests()
    print(f"PSM2 has laid the needle down at {millimetres(lying)}")
    off = math.hypot(lying.p[0] - LAST[0], lying.p[1] - LAST[1])
    if off > 0.005 or lying.p[2] > TRAY + 0.002:
        sys.exit(f"the needle is {1e3 * off:.1f} mm from where it was to be laid down")


if __name__ == "__main__":
    main()
