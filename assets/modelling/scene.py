"""Objects of the scenes: needle, cylinder, pad, tray and table."""

from __future__ import annotations

import math

from .mesh import Mesh, Point, loft, rod, rounded_rectangle, slab
from .urdf import HALF_PI, Collision, Joint, Link, Model, Visual, box, capsule, origin
from .urdf import cylinder as cylinder_shape

RADIUS = 20.0  # of the needle's arc
WIRE = 0.5  # radius of the needle's wire
CAPSULES = 8

PIN_RADIUS, PIN_LENGTH = 1.25, 6.0  # of the cylinder


def arc(degrees: float, radius: float = RADIUS) -> Point:
    """A point of the needle: 0° is the middle of the arc, −90° the point, +90° the swage."""
    t = math.radians(degrees)
    return (-radius * math.cos(t), radius * math.sin(t), 0.0)


def needle() -> Model:
    frames = {
        "mid_arc": 0.0,
        "point_45": -45.0,
        "swage_45": 45.0,
        "point_60": -60.0,
        "swage_60": 60.0,
    }
    links = [Link("needle", [Visual("needle", needle_mesh(), "steel")], needle_capsules())]
    joints = []
    for name, degrees in frames.items():
        links.append(Link(name))
        joints.append(
            Joint(
                f"{name}_frame",
                "fixed",
                "needle",
                name,
                origin(arc(degrees), f"0 0 {math.radians(0.0 - degrees):.10g}"),
            )
        )
    return Model("needle", links, joints, "Origin: centre of the arc, in the xy plane.")


def needle_mesh() -> Mesh:
    """Half circle of round wire: a tapered point at −y, a drilled swage for the thread at +y."""
    rings: list[list[Point]] = []

    def ring(degrees: float, radius: float) -> list[Point]:
        centre, t = arc(degrees), math.radians(degrees)
        outward = (-math.cos(t), math.sin(t))
        if radius == 0.0:
            return [centre]
        points = []
        for i in range(16):
            a = 2.0 * math.pi * i / 16
            side = radius * math.cos(a)
            points.append(
                (centre[0] + side * outward[0], centre[1] + side * outward[1], radius * math.sin(a))
            )
        return points

    rings.append(ring(-90.0, 0.0))
    taper = 14.0  # degrees of arc, about 5 mm
    for i in range(1, 11):
        s = i / 10
        rings.append(ring(-90.0 + taper * s, WIRE * s**0.75))
    rings += [ring(-90.0 + taper + (178.2 - taper) * i / 64, WIRE) for i in range(1, 65)]
    # The rim of the swage and the bore, 1.2 mm deep.
    rings += [
        ring(89.2, WIRE),
        ring(89.8, 0.46),
        ring(90.0, 0.40),
        ring(90.0, 0.26),
        ring(86.6, 0.22),
    ]
    return loft(rings)


def needle_capsules() -> list[Collision]:
    """Chords whose ends lie half a sagitta outside the arc: the axis stays within 0.19 mm of it.

    The ends stop where the capsules' round ends meet the needle's.
    """
    margin = math.degrees(WIRE / RADIUS)
    step = (180.0 - 2.0 * margin) / CAPSULES
    sagitta = RADIUS * (1.0 - math.cos(math.radians(step / 2)))
    radius = RADIUS + sagitta / 2.0
    length = 2.0 * radius * math.sin(math.radians(step / 2))
    pieces = []
    for i in range(CAPSULES):
        degrees = -90.0 + margin + step * (i + 0.5)
        centre = arc(degrees, radius * math.cos(math.radians(step / 2)))
        # A capsule lies along its z: turn z into the plane, then along the chord.
        pose = origin(centre, f"{HALF_PI} 0 {math.radians(180.0 - degrees):.10g}")
        pieces.append(capsule(WIRE, length, pose))
    return pieces


def cylinder() -> Model:
    """A pin of steel with broken edges."""
    half = PIN_LENGTH / 2
    mesh = rod(PIN_RADIUS, -half, half, 0.1)
    link = Link(
        "cylinder", [Visual("cylinder", mesh, "steel")], [cylinder_shape(PIN_RADIUS, PIN_LENGTH)]
    )
    return Model("cylinder", [link], comment="Origin: its middle; z is its axis.")


def pad() -> Model:
    """Silicone pad 101 × 170 × 5.2 mm, centred 3.6 mm above the tray's origin."""
    size = (101.0, 170.0, 5.2)
    mesh = slab(size[0], size[1], 1.0, 6.2, 6.0, 0.8)
    link = Link("pad", [Visual("pad", mesh, "silicone")], [box(size, (0, 0, 3.6))])
    return Model("pad", [link], comment="Origin: that of the tray it lies in.")


def tray() -> Model:
    """Instrument tray 120 × 196 × 22.75 mm: floor 0.36 mm, walls 3 mm."""
    width, depth, height, floor, wall = 120.0, 196.0, 22.75, 0.36, 3.0

    def ring(inset: float, z: float, radius: float) -> list[Point]:
        flat = rounded_rectangle(width - 2 * inset, depth - 2 * inset, radius, 8)
        return [(x, y, z) for x, y in flat]

    mesh = loft(
        [
            ring(0.2, 0.0, 5.8),
            ring(0.0, 0.2, 6.0),
            ring(0.0, height - 0.6, 6.0),
            ring(0.6, height, 5.4),
            ring(wall - 0.6, height, 3.6),
            ring(wall, height - 0.6, 3.0),
            ring(wall, floor, 3.0),
        ]
    )
    inside = depth - 2 * wall
    # An object that is pressed into a body as thin as the floor comes out below it. The bodies reach as
    # far down as a wall is thick.
    low = floor - wall
    rise, middle = height - low, (height + low) / 2
    collisions = [box((width, depth, wall), (0, 0, floor - wall / 2))]
    for side in (-1, 1):
        collisions.append(box((wall, depth, rise), (side * (width - wall) / 2, 0, middle)))
        collisions.append(
            box((width - 2 * wall, wall, rise), (0, side * (inside + wall) / 2, middle))
        )
    link = Link("tray", [Visual("tray", mesh, "tray")], collisions)
    return Model("tray", [link], comment="Origin: centre of the underside.")


def table() -> Model:
    """Table 416 × 537 mm, its top at 675 mm: plate 50 mm thick on four legs."""
    width, depth, top, plate = 416.0, 537.0, 675.0, 50.0
    slab_top = slab(width, depth, top - plate, top, 20.0, 3.0)
    legs = Mesh()
    for x in (-1, 1):
        for y in (-1, 1):
            leg = slab(40.0, 40.0, 0.0, top - plate + 5.0, 8.0, 1.5)
            legs += leg.moved(x=x * (width / 2 - 40.0), y=y * (depth / 2 - 40.0))
    link = Link(
        "table",
        [Visual("top", slab_top, "table"), Visual("legs", legs, "joint")],
        [box((width, depth, plate), (0, 0, top - plate / 2))],
    )
    return Model("table", [link], comment="Origin: the floor below the centre of the plate.")
