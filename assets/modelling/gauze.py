"""The gauze: a small folded swab with a standing pleat across its middle, by which it is gripped."""

from __future__ import annotations

import math

from .mesh import Mesh, Point, loft
from .urdf import Link, Model, Visual, box

WIDTH, DEPTH, HEIGHT = 15.2, 25.5, 2.45  # x, y, z
SHEET = 0.9  # thickness of the swab beside the pleat
PLEAT = 1.8  # thickness of the pleat: the sheet twice
THREADS = 12  # across the width; as far apart along the depth
RELIEF = 0.16  # of the weave: half the height from over to under


def gauze() -> Model:
    # The bodies end at the weave's mean height, half way between over and under.
    flat, crest = SHEET - RELIEF, HEIGHT - RELIEF
    sheet = box((WIDTH, DEPTH, flat), (0, 0, (flat - HEIGHT) / 2))
    pleat = box((WIDTH, PLEAT, crest - flat), (0, 0, (flat + crest - HEIGHT) / 2))
    link = Link("gauze", [Visual("gauze", gauze_mesh().moved(z=-HEIGHT / 2), "gauze")], [sheet, pleat])
    return Model("gauze", [link], comment="Origin: the middle of its height above the centre of the underside.")


def gauze_mesh() -> Mesh:
    """A plain weave on top, flat below; rings across the width, lofted along the depth."""
    columns = 2 * THREADS
    xs = [WIDTH * (i / columns - 0.5) for i in range(columns + 1)]
    bevel = 0.15

    def ring(top_y: float, top: float, bottom_y: float, row: int, relief: float) -> list[Point]:
        """Over the top from −x to +x, then back below; `row` counts half threads."""
        points: list[Point] = [(-WIDTH / 2, bottom_y, bevel)]
        for i, x in enumerate(xs):
            # Threads that run along x pass over and under those that run along y in turn.
            weave = relief * math.sin(math.pi / 2 * (2 * (i // 2) + row)) * (i % 2)
            edge = 0 < i < columns
            points.append((x if edge else x - math.copysign(0.05, x), top_y, top + weave))
        points.append((WIDTH / 2, bottom_y, bevel))
        points.append((WIDTH / 2 - bevel, bottom_y, 0.0))
        points.append((-WIDTH / 2 + bevel, bottom_y, 0.0))
        return points

    thread = WIDTH / THREADS
    flat, foot, crest = SHEET - RELIEF, PLEAT / 2, HEIGHT - RELIEF
    half = round((DEPTH / 2 - foot) / (thread / 2))
    rings = []
    profile: list[tuple[float, float, int, float]] = []  # y and z of the top, row, relief
    for i in range(half + 1):
        y = -DEPTH / 2 + (DEPTH / 2 - foot - 0.12) * i / half
        profile.append((y, flat, i, RELIEF if 0 < i < half else 0.0))
    profile += [
        (-foot, flat + 0.12, 0, 0.0),
        (-foot, 0.5 * (flat + crest), 1, RELIEF),
        (-foot, crest - 0.25, 0, 0.0),
        (-foot + 0.10, crest - 0.07, 0, 0.0),
        (-foot + 0.30, crest, 0, 0.0),
        (0.0, crest, 1, RELIEF),
    ]
    profile += [(-y, z, row, relief) for y, z, row, relief in reversed(profile[:-1])]
    for i, (y, z, row, relief) in enumerate(profile):
        # Nodes of the flat underside lie nearly below those of the top, but never on one another.
        even = DEPTH * (i / (len(profile) - 1) - 0.5)
        rings.append(ring(y, z, 0.9 * y + 0.1 * even, row, relief))
    return loft(rings)
