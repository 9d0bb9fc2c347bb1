"""Picks up the needle and brings it to the goal, by the commands of a robot alone.

Where the middle of the needle's arc is, and where it is to go, comes from the simulator, as it
would come from a camera.
"""

import math
import sys

import crtk
import dvrk
import numpy
import PyKDL

from trocar.dvrk import current

TIP = 0.0102  # from measured_cp to the tip of the jaws, m
HOVER = 0.02  # above the grasp, m


def seen():
    """The middle of the needle's arc, its roll, pitch and yaw, and the goal."""
    observation, achieved, desired = current().live.observation()
    return PyKDL.Vector(*achieved), observation[16:19], PyKDL.Vector(*desired)


def raised(frame, by):
    return PyKDL.Frame(frame.M, frame.p + PyKDL.Vector(0.0, 0.0, by))


def main():
    ral = crtk.ral("pick_needle")
    psm = dvrk.psm(ral, "PSM1")
    ral.check_connections()
    if not (psm.enable(10) and psm.home(10)):
        sys.exit("the arm is not ready")
    middle, (roll, pitch, yaw), _ = seen()
    wire = PyKDL.Rotation.RPY(roll, pitch, yaw).UnitY()
    # Jaws straight down that close across the wire, turned as little as possible.
    turn = math.atan2(wire[1], wire[0])
    turn -= math.pi * round(turn / math.pi)
    down = PyKDL.Rotation.RotZ(turn) * PyKDL.Rotation.RotX(math.pi)
    grasp = PyKDL.Frame(down, middle + PyKDL.Vector(0.0, 0.0, TIP - 0.00045))
    needle = crtk.utils(type("needle", (), {})(), ral.create_child("needle"), 1.0)
    needle.add_measured_cp()
    lies = needle._of.measured_cp()[0].p[2]
    psm.jaw.open(math.radians(40)).wait()
    psm.move_cp(raised(grasp, HOVER)).wait()
    psm.move_cp(grasp).wait()
    psm.jaw.close().wait()
    psm.move_cp(raised(grasp, HOVER)).wait()
    middle, _, goal = seen()
    here, _ = psm.measured_cp()
    psm.move_cp(PyKDL.Frame(here.M, here.p + goal - middle)).wait()
    if needle._of.measured_cp()[0].p[2] < lies + 0.005:
        sys.exit("the needle was not lifted")
    if numpy.abs(psm.jaw.measured_jp()[0][0]) < 0.02:
        sys.exit("the jaws are empty")
    told = current().live.world
    print(f"reward {told['reward']}, success {told['is_success']}")


if __name__ == "__main__":
    main()
