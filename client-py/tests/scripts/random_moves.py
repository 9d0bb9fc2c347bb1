"""Moves an arm at random, and prints where it is to the last bit."""

import crtk
import dvrk
import numpy

ral = crtk.ral("random_moves")
psm = dvrk.psm(ral, "PSM1")
psm.enable(10)
psm.home(10)
rng = numpy.random.default_rng(7)
rate = ral.create_rate(17.0)
home = numpy.array([0.0, 0.0, 0.12, 0.0, 0.0, 0.0])
for step in range(50):
    goal = home + rng.uniform(-0.05, 0.05, 6)
    if step % 3 == 0:
        psm.move_jp(goal)
    else:
        psm.servo_jp(goal)
    psm.jaw.move_jp(rng.uniform(-0.3, 1.0, 1))
    rate.sleep()
    p, v, _, _ = psm.measured_js()
    print([value.hex() for value in (*p.tolist(), *v.tolist(), *psm.jaw.measured_jp()[0].tolist())])
