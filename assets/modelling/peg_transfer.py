"""Board, pegs and blocks of the peg transfer."""

from __future__ import annotations

import math

from .mesh import Mesh, Point, lathe, loft, slab
from .urdf import Collision, Joint, Link, Model, Visual, box, capsule, origin

BOARD = (103.0, 154.0, 22.0)
PEG_HEIGHT = 22.0  # of the pegs' centres over the board's
PEG_RADIUS, PEG_LENGTH = 1.5, 30.0  # as they look
PEG_BODY_RADIUS, PEG_BODY_LENGTH = 1.0, 28.0  # as blocks meet them
TARGETS = [(x, y) for y in (43.0, 13.0) for x in (-30.0, -10.0, 10.0)]
SOURCES = [
    (-33.0, -27.0),
    (13.0, -27.0),
    (-21.5, -7.081),
    (1.5, -7.081),
    (-21.5, -46.919),
    (1.5, -46.919),
]

BLOCK_HEIGHT = 14.5
WALL_MIDLINE = 5.0  # from the axis to the middle of each wall
WALL = 1.6  # thickness
CORNER = 8.9  # from the axis to the flats that cut the outer corners


def pegboard() -> Model:
    """Board with twelve pegs: 0 to 5 are targets, 6 to 11 sources."""
    width, depth, height = BOARD
    pegs = [*TARGETS, *SOURCES]
    board = slab(width, depth, -height / 2, height / 2, 6.0, 0.8)
    collisions = [box(BOARD, (0, 0, 0))]
    mesh = Mesh()
    frames = []
    joints = []
    for index, (x, y) in enumerate(pegs):
        mesh += peg_mesh().moved(x, y, PEG_HEIGHT)
        # Round ends count as part of a peg's length.
        length = PEG_BODY_LENGTH - 2 * PEG_BODY_RADIUS
        collisions.append(capsule(PEG_BODY_RADIUS, length, origin((x, y, PEG_HEIGHT))))
        name = f"peg_{index}"
        frames.append(Link(name))
        joints.append(Joint(f"{name}_frame", "fixed", "pegboard", name, origin((x, y, PEG_HEIGHT))))
    visuals = [Visual("board", board, "board"), Visual("pegs", mesh, "peg")]
    links = [Link("pegboard", visuals, collisions), *frames]
    return Model("pegboard", links, joints, "Origin: centre of the board.")


def peg_mesh() -> Mesh:
    """A rod about the origin, round at its top."""
    low, high, r = -PEG_LENGTH / 2, PEG_LENGTH / 2, PEG_RADIUS
    dome = [math.radians(a) for a in (0.0, 22.5, 45.0, 67.5)]
    top = [(r * math.cos(a), high - r + r * math.sin(a)) for a in dome]
    return lathe([(r, low), *top, (0.0, high)], 24)


def block() -> Model:
    """A triangular ring: three walls about the vertical axis, the first one towards −x."""
    places = {0: 180.0, 1: 60.0, 2: -60.0}  # direction in which each wall faces
    outer = WALL_MIDLINE + WALL / 2
    # Where the cut of the corner begins along a wall.
    half = (CORNER - outer / 2) / math.cos(math.radians(30.0))
    collisions: list[Collision] = []
    frames = []
    joints = []
    for index, degrees in places.items():
        t = math.radians(degrees)
        at = tuple(round(WALL_MIDLINE * x, 9) for x in (math.cos(t), math.sin(t), 0.0))
        # x of a wall's frame points to the axis.
        turn = math.remainder(t - math.pi, 2.0 * math.pi)
        pose = origin(at, f"0 0 {turn:.10g}")
        size = " ".join(f"{x * 1e-3:.10g}" for x in (WALL, 2.0 * half, BLOCK_HEIGHT))
        collisions.append(Collision(f'<box size="{size}"/>', pose))
        name = f"wall_{index}"
        frames.append(Link(name))
        joints.append(Joint(f"{name}_frame", "fixed", "block", name, pose))
    links = [Link("block", [Visual("block", block_mesh(), "block")], collisions), *frames]
    return Model("block", links, joints, "Origin: centre; the axis is z.")


def block_mesh() -> Mesh:
    outer, inner = WALL_MIDLINE + WALL / 2, WALL_MIDLINE - WALL / 2
    z, bevel = BLOCK_HEIGHT / 2, 0.3
    soft = bevel * (1.0 - math.sqrt(0.5))

    def outside(inset: float, height: float) -> list[Point]:
        return triangle(outer - inset, CORNER - inset, 0.5, height)

    def inside(inset: float, height: float) -> list[Point]:
        return triangle(inner + inset, 2.0 * (inner + inset) - 0.5, 0.25, height)

    rim = [(0.0, z - bevel), (soft, z - soft), (bevel, z)]
    low = [(inset, -height) for inset, height in rim]
    return loft(
        [inside(*each) for each in low]
        + [outside(*each) for each in reversed(low)]
        + [outside(*each) for each in rim]
        + [inside(*each) for each in reversed(rim)],
        closed=True,
    )


def triangle(apothem: float, corner: float, radius: float, z: float) -> list[Point]:
    """Outline of a triangle with a vertex towards +x, its corners cut at `corner` from the axis and
    each of the six edges that leaves rounded with `radius`."""
    points: list[Point] = []
    steps = 4
    for third in range(3):
        turn = 2.0 * math.pi * third / 3.0
        for side in (-1, 1):
            # Between a wall that faces side·60° and the cut, which faces 0°.
            x = corner - radius
            y = side * ((apothem - radius) - 0.5 * x) / math.sin(math.pi / 3.0)
            start = -math.pi / 3.0 if side < 0 else 0.0
            for i in range(steps + 1):
                a = start + math.pi / 3.0 * i / steps
                px, py = x + radius * math.cos(a), y + radius * math.sin(a)
                points.append(
                    (
                        px * math.cos(turn) - py * math.sin(turn),
                        px * math.sin(turn) + py * math.cos(turn),
                        z,
                    )
                )
    return points
