"""The remote-centre mechanism that PSM and ECM share: base, yaw body, parallelogram, rail, cannula.

Link frames are the DH frames of dVRK. At joint values zero, frame 1 (yaw) has x up, z backwards
from the remote centre; frame 2 (pitch) has x backwards, y up, z sideways, and the shaft runs
along −y.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from .mesh import Mesh, bar, lathe, rod, slab, tube
from .urdf import HALF_PI, Joint, Link, Visual, origin


@dataclass(frozen=True)
class Mechanism:
    """Sizes in mm, limits in rad, m, N·m, N, rad/s, m/s as (lower, upper, effort, velocity)."""

    back: float  # remote centre to the pivot of the parallelogram, along the yaw axis
    insertion_offset: float  # DH offset of the insertion, m (negative)
    width: float  # of the bars
    rail_top: float  # height of the rail's upper end above the remote centre
    cannula_inner: float
    cannula_outer: float
    yaw: tuple[float, float, float, float]
    pitch: tuple[float, float, float, float]
    insertion: tuple[float, float, float, float]

    @property
    def rail_x(self) -> float:
        """Distance of the rail's pivots behind the shaft."""
        return 1.5 * self.width

    @property
    def bar_heights(self) -> tuple[float, float]:
        """Heights of the two horizontal bars above the remote centre."""
        return 0.32 * self.rail_top, 0.50 * self.rail_top

    @property
    def foot(self) -> float:
        """Height of the rail's lower end above the remote centre."""
        return 0.16 * self.rail_top

    def links(self) -> list[Link]:
        """base, yaw, pitch and the cosmetic parallelogram; the caller adds what is inserted."""
        return [
            Link(
                "base",
                [
                    Visual("base", self.base(), "shell"),
                    Visual("base_flange", self.base_flange(), "joint"),
                ],
            ),
            Link(
                "yaw_link",
                [
                    Visual("yaw_body", self.yaw_body(), "shell"),
                    Visual("yaw_fork", self.yaw_fork(), "joint"),
                ],
            ),
            Link(
                "pitch_link",
                [
                    Visual("rail", self.rail(), "shell"),
                    Visual("rail_track", self.rail_track(), "steel"),
                    Visual("cannula_mount", self.cannula_mount(), "joint"),
                    Visual("cannula", self.cannula(), "steel"),
                ],
            ),
            Link("back_link", [Visual("back", self.back_bar(), "shell")]),
            Link("bottom_link", [Visual("bar", self.parallel_bar(), "shell")]),
            Link("top_link", [Visual("bar", self.parallel_bar(), "shell")]),
        ]

    def joints(self) -> list[Joint]:
        """Joints 1–3 and the parallelogram, which mimics the pitch."""
        low, high, effort, speed = self.pitch
        reverse = (-high, -low, effort, speed)
        back_turn = f"-{HALF_PI} -{HALF_PI} 0"
        bottom, top = (origin((self.rail_x, height, 0)) for height in self.bar_heights)
        return [
            Joint(
                "yaw",
                "revolute",
                "base",
                "yaw_link",
                origin(rpy=f"{HALF_PI} -{HALF_PI} 0"),
                self.yaw,
            ),
            Joint("pitch", "revolute", "yaw_link", "pitch_link", origin(rpy=back_turn), self.pitch),
            Joint(
                "insertion",
                "prismatic",
                "pitch_link",
                "insertion_link",
                origin((0, -1e3 * self.insertion_offset, 0), f"{HALF_PI} 0 0"),
                self.insertion,
            ),
            Joint(
                "pitch_back",
                "revolute",
                "yaw_link",
                "back_link",
                origin((0, 0, self.back), back_turn),
                self.pitch,
                ("pitch", 1),
            ),
            Joint(
                "pitch_bottom",
                "revolute",
                "back_link",
                "bottom_link",
                bottom,
                reverse,
                ("pitch", -1),
            ),
            Joint("pitch_top", "revolute", "back_link", "top_link", top, reverse, ("pitch", -1)),
        ]

    def base(self) -> Mesh:
        """Motor housing on the yaw axis, which is the base's −y."""
        r, start = 1.25 * self.width, self.back + 4.0 * self.width
        return soft_rod(r, -start - 3.2 * self.width, -start, 0.18 * r).along_y()

    def base_flange(self) -> Mesh:
        r, start = 1.05 * self.width, self.back + 4.0 * self.width
        ring = soft_rod(0.9 * r, -start - 0.05, -start + 0.22 * self.width, 0.06 * r)
        foot = slab(1.7 * r, 2.4 * r, 0, 0.35 * self.width, 0.3 * r, 0.06 * r)
        return ring.along_y() + foot.moved(y=-start - 1.6 * self.width, z=-1.5 * self.width)

    def yaw_body(self) -> Mesh:
        """Turns about z of frame 1, in front of the base."""
        w = self.width
        return soft_rod(1.1 * w, self.back + 2.3 * w, self.back + 3.8 * w, 0.16 * w)

    def yaw_fork(self) -> Mesh:
        """Two cheeks that hold the parallelogram's pivot (along y of frame 1)."""
        w = self.width
        cheeks = bar(2.4 * w, 1.1 * w, 0.44 * w, 0.62 * w, 0.04 * w) + bar(
            2.4 * w, 1.1 * w, -0.62 * w, -0.44 * w, 0.04 * w
        )
        pin = rod(0.22 * w, -0.70 * w, 0.70 * w, 0.03 * w)
        return (cheeks.axes((0, 0, 1), (1, 0, 0), (0, 1, 0)) + pin.along_y()).moved(z=self.back)

    def back_bar(self) -> Mesh:
        """Stands on the yaw axis and carries both horizontal bars."""
        w = self.width
        post = slab(
            0.62 * w, self.bar_heights[1] + 0.8 * w, -0.36 * w, 0.36 * w, 0.30 * w, 0.05 * w
        )
        foot = bar(self.rail_x, 0.8 * w, -0.36 * w, 0.36 * w, 0.05 * w)
        pins = rod(0.18 * w, -0.60 * w, 0.60 * w, 0.03 * w)
        mesh = foot + post.moved(x=self.rail_x, y=self.bar_heights[1] / 2)
        for height in self.bar_heights:
            mesh += pins.moved(x=self.rail_x, y=height)
        return mesh

    def parallel_bar(self) -> Mesh:
        """From the back bar's pivot forwards to the rail's: two cheeks, one on either side."""
        w = self.width
        cheek = bar(self.back, 0.5 * w, 0.38 * w, 0.52 * w, 0.04 * w)
        other = bar(self.back, 0.5 * w, -0.52 * w, -0.38 * w, 0.04 * w)
        return (cheek + other).moved(x=-self.back)

    def rail(self) -> Mesh:
        """The upright along which the carriage slides, behind the shaft."""
        w, foot = self.width, self.foot
        body = slab(0.9 * w, 0.72 * w, foot, self.rail_top, 0.2 * w, 0.06 * w)
        mesh = body.axes((1, 0, 0), (0, 0, -1), (0, 1, 0)).moved(x=self.rail_x)
        for pivot in self.bar_heights:
            mesh += rod(0.18 * w, -0.60 * w, 0.60 * w, 0.03 * w).moved(x=self.rail_x, y=pivot)
        return mesh

    def rail_track(self) -> Mesh:
        w, foot = self.width, self.foot
        track = slab(
            0.16 * w, 0.34 * w, foot + 0.5 * w, self.rail_top - 0.3 * w, 0.07 * w, 0.02 * w
        )
        return track.axes((1, 0, 0), (0, 0, -1), (0, 1, 0)).moved(x=self.rail_x - 0.5 * w)

    def cannula_mount(self) -> Mesh:
        """From the rail's foot forwards to the cannula's head."""
        w, foot = self.width, self.foot
        arm = bar(self.rail_x, 0.42 * w, -0.22 * w, 0.22 * w, 0.05 * w)
        clamp = tube(0.36 * w, self.cannula_outer - 0.2, foot - 0.12 * w, foot + 0.36 * w)
        return arm.moved(y=foot + 0.12 * w) + clamp.axes((1, 0, 0), (0, 0, -1), (0, 1, 0))

    def cannula(self) -> Mesh:
        """Open pipe along the shaft with a funnel, and a ring that marks the remote centre."""
        inner, outer = self.cannula_inner, self.cannula_outer
        top = self.foot + 0.5 * self.width
        funnel = inner + 5.5
        pipe = lathe(
            [
                (inner, -28.0),
                (outer - 0.4, -28.0),
                (outer, -27.0),
                (outer, top - 26.0),
                (outer + 1.5, top - 22.0),
                (funnel, top - 9.0),
                (funnel + 1.4, top - 6.0),
                (funnel + 1.4, top - 0.8),
                (funnel + 0.6, top),
                (funnel - 0.8, top),
                (inner + 0.3, top - 12.0),
                (inner, top - 16.0),
            ],
            closed=True,
        )
        mark = tube(outer + 0.15, outer - 0.1, -1.5, 1.5)
        return (pipe + mark).axes((1, 0, 0), (0, 0, -1), (0, 1, 0))


def soft_rod(radius: float, z0: float, z1: float, round_off: float, segments: int = 64) -> Mesh:
    """A cylinder whose rims are quarter circles of radius `round_off`."""
    steps = [math.radians(a) for a in (0.0, 22.5, 45.0, 67.5, 90.0)]
    rim = [(round_off * (1 - math.sin(a)), round_off * (1 - math.cos(a))) for a in steps]
    low = [(radius - inset, z0 + rise) for inset, rise in rim]
    high = [(radius - inset, z1 - rise) for inset, rise in reversed(rim)]
    return lathe(low + high, segments)
