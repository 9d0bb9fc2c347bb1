"""Homes an arm, moves its joints, and opens and closes its jaw; runs on a robot and in Trocar.

On a robot: ``python home_and_move.py PSM1``. Here:
``python -m trocar.dvrk --task NeedleReach-v0 home_and_move.py PSM1``
"""

import math
import sys

import crtk
import dvrk
import numpy


def main() -> None:
    """Runs the script."""
    (name,) = crtk.ral.parse_argv(sys.argv[1:])
    ral = crtk.ral("home_and_move")
    psm = dvrk.psm(ral, name)
    ral.check_connections()
    if not (psm.enable(10) and psm.home(10)):
        sys.exit(f"{name} is not ready")
    start = numpy.copy(psm.setpoint_jp()[0])
    for angle in (10, -10, 0):
        goal = numpy.copy(start)
        goal[0] += math.radians(angle)
        goal[1] -= math.radians(angle)
        if not psm.move_jp(goal).wait():
            sys.exit("the move did not end")
    psm.jaw.open().wait()
    psm.jaw.close().wait()
    joints = numpy.round(psm.measured_jp()[0], 3) + 0.0  # no -0.0
    print(f"{name} is at {joints.tolist()}")


if __name__ == "__main__":
    main()
