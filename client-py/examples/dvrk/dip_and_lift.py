"""Goes down with open jaws, closes them, and lifts what is there; runs on a robot and in Trocar.

On a robot: ``python dip_and_lift.py PSM1 0.03``, with how far down it goes in m. Here:
``python -m trocar.dvrk --task GauzeRetrieve-v0 --homing in_place dip_and_lift.py PSM1 0.03``
"""

import math
import sys

import crtk
import dvrk
import PyKDL


def main() -> None:
    """Runs the script."""
    name, depth = crtk.ral.parse_argv(sys.argv[1:])
    ral = crtk.ral("dip_and_lift")
    psm = dvrk.psm(ral, name)
    ral.check_connections()
    if not (psm.enable(10) and psm.home(10)):
        sys.exit(f"{name} is not ready")
    psm.trajectory_j_set_ratio(0.5)
    above, _ = psm.setpoint_cp()
    # Along the instrument's axis.
    below = PyKDL.Frame(above.M, above.p + above.M * PyKDL.Vector(0.0, 0.0, float(depth)))
    psm.jaw.open(math.radians(40)).wait()
    psm.move_cp(below).wait()
    psm.jaw.close().wait()
    psm.move_cp(above).wait()
    reached, _ = psm.measured_cp()
    off = (reached.p - above.p).Norm()
    print(f"{name} is back within {1e3 * off:.1f} mm, its jaw at {psm.jaw.measured_jp()[0][0]:.2f}")


if __name__ == "__main__":
    main()
