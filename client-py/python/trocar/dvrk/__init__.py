"""Scripts for a real da Vinci (dVRK 2.4, CRTK) in a simulated world, without ROS.

``python -m trocar.dvrk script.py`` runs a script unchanged. It puts the names ``crtk``, ``dvrk``
and, where there is none, ``PyKDL`` in place for that process only. In Python of your own:

>>> import numpy
>>> from trocar import dvrk
>>> with dvrk.session("NeedleReach-v0") as world:
...     ral = dvrk.crtk.ral("example")
...     psm = dvrk.psm(ral, "PSM1")
...     ready = psm.enable(10) and psm.home(10)
...     done = psm.move_jp(numpy.array([0.1, 0.0, 0.12, 0.0, 0.0, 0.0])).wait()
...     ready, done, round(float(psm.measured_jp()[0][0]), 6)
(True, True, 0.1)
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any

from trocar.dvrk import crtk
from trocar.dvrk._world import World, current, use
from trocar.dvrk.arms import arm, console, ecm, psm, system
from trocar.dvrk.env import LiveEnv

__all__ = [
    "LiveEnv",
    "World",
    "arm",
    "console",
    "crtk",
    "current",
    "ecm",
    "psm",
    "session",
    "system",
    "use",
]


@contextlib.contextmanager
def session(task: str = "NeedlePick-v0", **options: Any) -> Iterator[World]:
    """A live world that the classes here drive, for a ``with`` block; as :class:`World`."""
    world = World(task, **options)
    use(world)
    try:
        yield world
    finally:
        use(None)
        world.close()
