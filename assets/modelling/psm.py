"""PSM with a Large Needle Driver: instrument, wrist and jaws on the remote-centre mechanism."""

from __future__ import annotations

import math
from dataclasses import dataclass

from .mechanism import Mechanism
from .mesh import Mesh, Point, bar, lathe, loft, rod, rounded_rectangle, slab
from .urdf import FLIPPED, HALF_PI, Joint, Link, Model, Visual, box, capsule, origin

SHAFT_RADIUS = 4.2
PITCH_TO_YAW = 9.1
JAW_LENGTH = 10.2
FAST = 12 * HALF_PI  # rad/s, 1080 °/s


@dataclass(frozen=True)
class Generation:
    name: str
    insertion_offset: float  # m
    roll_offset: float  # m
    insertion_max: float  # m
    yaw: float  # rad, symmetric
    pitch: tuple[float, float]  # rad
    effort: tuple[float, float, float]  # N·m, N·m, N
    jaw_min: float  # rad
    instrument: str


CLASSIC = Generation(
    "psm",
    -0.4318,
    0.4162,
    0.24,
    1.588,
    (-0.925025, 0.925025),
    (3.316101, 3.316101, 9.877926),
    -0.698132,
    "400006",
)
SI = Generation(
    "psm_si",
    -0.4826,
    0.4670,
    0.29,
    2.964,
    (-1.265, 1.301),
    (17.0845, 17.0845, 40.9063),
    -0.349066,
    "420006",
)


def model(generation: Generation, lender: Model | None = None) -> Model:
    g = generation
    mechanism = Mechanism(
        back=486.4,
        insertion_offset=g.insertion_offset,
        width=44.0,
        rail_top=-1e3 * g.insertion_offset + 60.0,
        cannula_inner=4.4,
        cannula_outer=5.4,
        yaw=(-g.yaw, g.yaw, g.effort[0], HALF_PI),
        pitch=(*g.pitch, g.effort[1], HALF_PI),
        insertion=(0.0, g.insertion_max, g.effort[2], 0.2),
    )
    length = 1e3 * g.roll_offset
    links = mechanism.links() + [
        Link(
            "insertion_link",
            [
                Visual("carriage", carriage(mechanism), "joint"),
                Visual("housing", housing(), "shell"),
                Visual("housing_trim", housing_trim(), "accent"),
            ],
        ),
        Link(
            "roll_link",
            [Visual("shaft", shaft(length), "graphite"), Visual("shaft_end", shaft_end(), "steel")],
            [capsule(SHAFT_RADIUS, length - 30.0, origin((0, 0, -4.2 - (length - 30.0) / 2)))],
        ),
        Link(
            "wrist_pitch_link",
            [Visual("clevis", clevis(), "steel")],
            [
                capsule(
                    2.6,
                    PITCH_TO_YAW - 2.6,
                    origin(((PITCH_TO_YAW - 2.6) / 2, 0, 0), f"0 {HALF_PI} 0"),
                )
            ],
        ),
        Link("wrist_yaw_link", [Visual("axle", rod(1.0, -2.85, 2.85, 0.15, 32), "carbide")]),
        Link("jaw_link"),
        Link(
            "jaw_1_link", [Visual("jaw", jaw(), "steel")], [box((1.4, 10.2, 1.8), (-0.7, 5.1, 0))]
        ),
        Link(
            "jaw_2_link",
            [Visual("jaw", jaw(), "steel", FLIPPED)],
            [box((1.4, 10.2, 1.8), (0.7, 5.1, 0))],
        ),
        Link("wrist"),
        Link("tip"),
    ]
    bent = origin(rpy=f"-{HALF_PI} -{HALF_PI} 0")
    low, high = g.jaw_min, 1.39626
    half = (low / 2, high / 2, 0.16, FAST / 2)
    joints = mechanism.joints() + [
        Joint(
            "roll",
            "revolute",
            "insertion_link",
            "roll_link",
            origin((0, 0, length)),
            (-4.53786, 4.53786, 0.33, FAST),
        ),
        Joint(
            "wrist_pitch",
            "revolute",
            "roll_link",
            "wrist_pitch_link",
            bent,
            (-1.39626, 1.39626, 0.25, FAST),
        ),
        Joint(
            "wrist_yaw",
            "revolute",
            "wrist_pitch_link",
            "wrist_yaw_link",
            origin((PITCH_TO_YAW, 0, 0), f"-{HALF_PI} -{HALF_PI} 0"),
            (-1.39626, 1.39626, 0.20, FAST),
        ),
        Joint("jaw", "revolute", "wrist_yaw_link", "jaw_link", origin(), (low, high, 0.16, FAST)),
        Joint("jaw_1", "revolute", "wrist_yaw_link", "jaw_1_link", origin(), half, ("jaw", 0.5)),
        Joint(
            "jaw_2",
            "revolute",
            "wrist_yaw_link",
            "jaw_2_link",
            origin(),
            (-half[1], -half[0], *half[2:]),
            ("jaw", -0.5),
        ),
        Joint(
            "wrist_frame", "fixed", "wrist_yaw_link", "wrist", origin(rpy=f"-{HALF_PI} {HALF_PI} 0")
        ),
        Joint("tip_frame", "fixed", "wrist", "tip", origin((0, 0, JAW_LENGTH))),
    ]
    comment = f"Base: the remote centre. Instrument: Large Needle Driver {g.instrument}."
    return Model(g.name, links, joints, comment, lender)


def carriage(mechanism: Mechanism) -> Mesh:
    """Slides on the rail: frame 3 has x backwards and z along the shaft."""
    depth = mechanism.rail_x - 0.45 * mechanism.width - 24.0
    block = slab(depth, 46.0, -52.0, 34.0, 6.0, 2.0)
    plate = slab(5.0, 54.0, -62.0, 40.0, 2.4, 1.0)
    return block.moved(x=24.0 + depth / 2) + plate.moved(x=22.0)


def housing() -> Mesh:
    """The instrument's box of pulleys, and the neck from which the shaft comes."""
    body = slab(40.0, 46.0, -58.0, 4.0, 9.0, 2.5)
    neck = lathe([(15.0, 3.0), (14.0, 8.0), (9.5, 18.0), (6.4, 26.0), (5.6, 30.0)])
    return body + neck


def housing_trim() -> Mesh:
    """Release buttons at both sides and the label plate on top."""
    button = slab(12.0, 26.0, 22.4, 25.4, 4.0, 0.8).along_y().moved(z=-28.0)
    other = slab(12.0, 26.0, -25.4, -22.4, 4.0, 0.8).along_y().moved(z=-28.0)
    label = slab(26.0, 30.0, -59.2, -57.6, 5.0, 0.6)
    return button + other + label


def shaft(length: float) -> Mesh:
    r = SHAFT_RADIUS
    return lathe([(r - 0.2, -length + 22.0), (r, -length + 22.4), (r, -26.2), (r - 0.2, -26.0)])


def shaft_end(radius: float = SHAFT_RADIUS) -> Mesh:
    """Metal sleeve and the fork of the wrist-pitch axis (y of the roll frame)."""
    sleeve = lathe([(radius - 0.2, -26.0), (radius, -25.8), (radius, -8.2), (radius - 0.5, -7.4)])
    prongs = bar(9.5, 4.8, 2.35, 3.35, 0.2) + bar(9.5, 4.8, -3.35, -2.35, 0.2)
    pin = rod(1.1, -3.6, 3.6, 0.15, 32)
    return sleeve + prongs.axes((0, 0, -1), (1, 0, 0), (0, -1, 0)) + pin.along_y()


def clevis() -> Mesh:
    """From the wrist-pitch axis (z) to the fork of the wrist-yaw axis (y, 9.1 mm along x)."""
    hub = rod(2.45, -2.2, 2.2, 0.2)

    def section(x: float, y: float, z: float, radius: float) -> list[Point]:
        return [(x, a, b) for a, b in rounded_rectangle(2 * y, 2 * z, radius)]

    web = loft(
        [
            section(0.0, 2.2, 2.0, 0.6),
            section(2.2, 2.3, 2.1, 0.6),
            section(3.6, 2.5, 2.4, 0.7),
            section(6.1, 2.5, 2.4, 0.7),
            section(6.3, 2.35, 2.25, 0.6),
        ]
    )
    # Laid so that the bars' z is the wrist-yaw axis and their length runs back along x.
    prongs = bar(4.6, 4.9, 1.55, 2.6, 0.2) + bar(4.6, 4.9, -2.6, -1.55, 0.2)
    return hub + web + prongs.axes((-1, 0, 0), (0, 0, 1), (0, 1, 0)).moved(x=PITCH_TO_YAW)


def jaw() -> Mesh:
    """The finger on the −x side: hub on the wrist-yaw axis (z), curved blade along +y.

    The grasping face lies at x = 0 and carries teeth 0.1 mm deep; towards the tip the blade tapers
    and its back curves inwards. The hub takes the +z half, the other finger's the −z half.
    """
    hub = rod(2.5, 0.06, 1.42, 0.15)
    neck = [0.5, 1.5, *(2.3 + 0.25 * i for i in range(10))]
    teeth = [4.7 + 0.2 * i for i in range(25)]
    rings = []
    for y in neck + teeth:
        groove = 0.11 if y in teeth[1::2] else 0.01
        blend = min(max((y - 2.4) / 2.0, 0.0), 1.0)
        blend = blend * blend * (3.0 - 2.0 * blend)
        height = half_height(y)
        low = 0.08 + (-height - 0.08) * blend
        high = 1.40 + (height - 1.40) * blend
        rings.append(section(y, groove, back(y), low, high))
    for y, shrink in ((9.72, 1.0), (9.92, 0.84), (10.08, 0.6), (JAW_LENGTH, 0.3)):
        height = half_height(y) * (0.4 + 0.6 * shrink)
        rings.append(section(y, 0.01, back(y) * shrink, -height, height))
    return hub + loft(rings)


def back(y: float) -> float:
    """Thickness of the blade at y: full at the neck, then a curve that bends in towards the tip."""
    s = min(max((y - 2.3) / (JAW_LENGTH - 2.3), 0.0), 1.0)
    return 2.1 - 0.30 * s - 0.95 * s**2.5


def half_height(y: float) -> float:
    s = min(max((y - 6.0) / (JAW_LENGTH - 6.0), 0.0), 1.0)
    return 0.92 - 0.22 * s * s


def section(y: float, groove: float, width: float, low: float, high: float) -> list[Point]:
    """D-shaped cross-section: flat at x = −groove, round at x = −width, z from low to high."""
    middle, half, depth = (low + high) / 2, (high - low) / 2, width - groove
    points = []
    for i in range(15):
        t = math.radians(-90.0 + 180.0 * i / 14)
        bulge = max(math.cos(t), 0.0) ** 0.55
        points.append((-groove - depth * bulge, y, middle + half * math.sin(t)))
    return points
