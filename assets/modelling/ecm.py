"""ECM: endoscope, camera head and lens on the remote-centre mechanism."""

from __future__ import annotations

import math
from dataclasses import dataclass

from .mechanism import Mechanism, soft_rod
from .mesh import Mesh, Point, lathe, loft, rod, slab, tube
from .urdf import HALF_PI, Joint, Link, Model, Visual, capsule, origin

SCOPE_RADIUS = 6.0
ROLL_OFFSET = 382.9
PI_6 = 0.5235987755982988  # rad; also rad/s, 30 °/s

# Name of the URDF: (mesh of the tip, roll of the optical axis about the camera's x).
ENDOSCOPES = {
    "model.urdf": ("straight", "0"),
    "model_up30.urdf": ("up30", f"-{PI_6}"),
    "model_down30.urdf": ("down30", f"{PI_6}"),
}


@dataclass(frozen=True)
class Generation:
    name: str
    yaw: tuple[float, float]  # rad
    pitch: tuple[float, float]  # rad
    insertion: tuple[float, float]  # m
    roll: tuple[float, float]  # rad
    effort: tuple[float, float, float, float]  # N·m, N·m, N, N·m


CLASSIC = Generation(
    "ecm",
    (-HALF_PI, HALF_PI),
    (-0.76794, 1.1344),
    (0.0, 0.255),
    (-1.552, 1.552),
    (26.93208, 26.93208, 80.6589483, 0.87658808),
)
SI = Generation(
    "ecm_si",
    (-2.964, 2.964),
    (-1.10, 1.04),
    (0.001, 0.259),
    (-1.54, 1.54),
    (17.0845, 34.0845, 70.900, 6.81923),
)


def model(generation: Generation, urdf_name: str, lender: Model | None = None) -> Model:
    g = generation
    tip, tilt = ENDOSCOPES[urdf_name]
    mechanism = Mechanism(
        back=612.6,
        insertion_offset=-0.3822,
        width=58.0,
        rail_top=470.0,
        cannula_inner=6.2,
        cannula_outer=7.4,
        yaw=(*g.yaw, g.effort[0], PI_6),
        pitch=(*g.pitch, g.effort[1], PI_6),
        insertion=(*g.insertion, g.effort[2], 0.06),
    )
    length = ROLL_OFFSET - 12.0
    links = mechanism.links() + [
        Link("insertion_link", [Visual("carriage", carriage(mechanism), "joint")]),
        Link(
            "roll_link",
            [
                Visual("camera_head", camera_head(), "shell"),
                Visual("camera_trim", camera_trim(), "accent"),
                Visual(f"scope_{tip}", scope(tip), "steel"),
                Visual(f"window_{tip}", window(tip), "glass"),
                Visual(f"light_{tip}", light(tip), "light"),
            ],
            [capsule(SCOPE_RADIUS, length, origin((0, 0, -SCOPE_RADIUS - length / 2)))],
        ),
        Link("camera"),
    ]
    joints = mechanism.joints() + [
        Joint(
            "roll",
            "revolute",
            "insertion_link",
            "roll_link",
            origin((0, 0, ROLL_OFFSET)),
            (*g.roll, g.effort[3], PI_6),
        ),
        Joint("camera_frame", "fixed", "roll_link", "camera", origin(rpy=f"{tilt} 0 -{HALF_PI}")),
    ]
    return Model(g.name, links, joints, f"Base: the remote centre. Endoscope: {tip}.", lender)


def slope(tip: str) -> float:
    """dz/dx of the end face: the face is square to the optical axis, which tilts in x."""
    return {"straight": 0.0, "up30": -1.0, "down30": 1.0}[tip] * math.tan(math.radians(30.0))


def tilted(mesh: Mesh, tip: str) -> Mesh:
    """A part along z turned so that it stands square on the end face."""
    angle = math.atan(slope(tip))
    s, c = math.sin(angle), math.cos(angle)
    return mesh.axes((c, 0, s), (0, 1, 0), (-s, 0, c))


def scope(tip: str) -> Mesh:
    """The endoscope's tube with its end face through the origin of the roll frame."""
    r, rise = SCOPE_RADIUS, slope(tip)

    def ring(radius: float, z: float, rise: float) -> list[Point]:
        points = [
            (radius * math.cos(t), radius * math.sin(t))
            for t in (2 * math.pi * i / 48 for i in range(48))
        ]
        return [(x, y, z + rise * x) for x, y in points]

    return loft(
        [
            ring(r - 0.3, -ROLL_OFFSET - 20.0, 0),
            ring(r, -ROLL_OFFSET - 19.7, 0),
            ring(r, -12.0, 0),
            ring(r, -0.35, rise),
            ring(r - 0.35, 0, rise),
        ]
    )


def window(tip: str) -> Mesh:
    """Two objective lenses side by side (a stereo endoscope), proud of the face by 0.05 mm."""
    lens = rod(1.7, -1.0, 0.05, 0.04, 32)
    return tilted(lens.moved(y=2.1) + lens.moved(y=-2.1), tip)


def light(tip: str) -> Mesh:
    """Two windows of the light guide, above and below the lenses."""
    guide = slab(1.5, 4.6, -1.0, 0.05, 0.7, 0.04)
    return tilted(guide.moved(x=3.7) + guide.moved(x=-3.7), tip)


def camera_head() -> Mesh:
    """Handle with the camera, above the carriage, and the ring that clamps the scope."""
    z = -ROLL_OFFSET
    grip = lathe(
        [
            (7.0, z - 14.0),
            (14.0, z - 16.0),
            (17.0, z - 20.0),
            (17.0, z - 48.0),
            (21.0, z - 56.0),
            (23.0, z - 62.0),
            (23.0, z - 118.0),
            (21.5, z - 124.0),
            (16.0, z - 128.0),
        ][::-1]
    )
    cable = lathe(
        [(3.4, z - 190.0), (4.0, z - 189.0), (4.0, z - 150.0), (7.0, z - 142.0), (9.0, z - 127.0)]
    )
    return grip + cable


def camera_trim() -> Mesh:
    """Grip rings and the post of the light cable."""
    z = -ROLL_OFFSET
    rings = Mesh()
    for i in range(3):
        rings += tube(17.6, 16.5, z - 30.0 - 6.0 * i, z - 27.0 - 6.0 * i)
    post = lathe([(3.0, 15.0), (5.0, 15.4), (5.0, 30.0), (6.5, 31.0), (6.5, 44.0), (5.5, 45.0)], 32)
    return rings + post.along_y().moved(z=z - 80.0)


def carriage(mechanism: Mechanism) -> Mesh:
    """Slides on the rail and holds the scope: frame 3 has x backwards and z along the shaft."""
    depth = mechanism.rail_x - 0.45 * mechanism.width - 10.0
    block = slab(depth, 56.0, -14.0, 62.0, 8.0, 2.5)
    collar = soft_rod(21.0, -12.0, 46.0, 4.0)
    return block.moved(x=10.0 + depth / 2) + collar
