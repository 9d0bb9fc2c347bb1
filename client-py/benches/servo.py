"""How much faster than life a dVRK script runs that servoes an arm at 100 Hz in lock-step.

The loop is that of dVRK's own arm test: ``servo_jp`` with velocities, two readings, a rate's sleep.
``make bench-dvrk`` runs it on one core, with all that is compiled in the release profile.
"""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np

import trocar
from trocar import dvrk
from trocar.dvrk import crtk

ROUNDS = 10
"""Of 5 s of the world's time each."""


def servo(world: dvrk.World) -> float:
    """Servoes the arm for 5 s, and returns how many times faster than life that was."""
    psm: Any = dvrk.psm(crtk.ral("servo"), "PSM1")
    assert psm.enable(10)
    assert psm.home(10)
    start = np.copy(psm.setpoint_jp()[0])
    goal, velocity = np.copy(start), np.zeros(6)
    best = 0.0
    for _ in range(ROUNDS):
        began, passed = time.perf_counter(), world.elapsed()
        rate = psm.ral().create_rate(100.0)
        for step in range(500):
            angle = step * math.tau / 500
            goal[:2] = start[:2] + math.radians(1.0) * (1.0 - math.cos(angle))
            velocity[:2] = math.radians(1.0) * math.sin(angle)
            psm.servo_jp(goal, velocity)
            psm.measured_jp()
            psm.setpoint_jp()
            rate.sleep()
        took = time.perf_counter() - began
        best = max(best, (world.elapsed() - passed) / took)
    return best


def main() -> None:
    """Measures with nothing, with a needle that lies, and with one that is held."""
    with trocar.Server(threads=1) as server:
        for name, task, options in (
            ("empty", "NeedleReach-v0", {}),
            ("lies", "NeedlePick-v0", {}),
            ("held", "NeedlePick-v0", {"start": "lift"}),
        ):
            with dvrk.session(
                task, server=server.name, options=options, homing="in_place"
            ) as world:
                print(f"{name}: {servo(world):.0f} times as fast as life")


if __name__ == "__main__":
    main()
