"""Servoes the wrist of an arm round a circle of 1 cm at 100 Hz; runs on a robot and in Trocar.

On a robot: ``python servo_circle.py PSM1``. Here:
``python -m trocar.dvrk --task NeedleReach-v0 servo_circle.py PSM1``
"""

import math
import sys

import crtk
import dvrk
import PyKDL

RADIUS = 0.01
SECONDS = 5.0
HERTZ = 100.0


def main() -> None:
    """Runs the script."""
    (name,) = crtk.ral.parse_argv(sys.argv[1:])
    ral = crtk.ral("servo_circle")
    psm = dvrk.psm(ral, name)
    ral.check_connections()
    if not (psm.enable(10) and psm.home(10)):
        sys.exit(f"{name} is not ready")
    start, _ = psm.setpoint_cp()
    rate = ral.create_rate(HERTZ)
    furthest = 0.0
    for step in range(1, round(SECONDS * HERTZ) + 1):
        angle = math.tau * step / (SECONDS * HERTZ)
        way = PyKDL.Vector(RADIUS * (1.0 - math.cos(angle)), RADIUS * math.sin(angle), 0.0)
        psm.servo_cp(PyKDL.Frame(start.M, start.p + way))
        rate.sleep()
        measured, _ = psm.measured_cp()
        furthest = max(furthest, (start.p + way - measured.p).Norm())
    print(f"{name} was never more than {1e3 * furthest:.1f} mm away from its circle")


if __name__ == "__main__":
    main()
