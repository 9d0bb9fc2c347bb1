"""Where coloured things are: in pictures of an endoscope, and in space, by both of its lenses.

A picture is uint8 (H, W, 3), RGB. Image points are in halves of its height, from its middle to the
right and down.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.dvrk.deploy.geometry import Numbers, Pose

Picture = NDArray[np.uint8]

LEAST_LIGHT = 0.01
"""Least sum of red, green and blue light, each 0 to 1: what is darker has no colour to speak of."""

LEAST_PIXELS = 4
"""Least pixels of a region that counts as seen."""


@dataclass(frozen=True)
class Colour:
    """A colour to look for: red, green, blue (0 to 255), and how far off its parts may be."""

    rgb: tuple[float, float, float]
    tolerance: float = 0.2

    def mask(self, picture: Picture) -> NDArray[np.bool_]:
        """The pixels that have its chromaticity, however much light they get."""
        light = _light(picture.astype(np.float64))
        whole = light.sum(axis=2)
        parts = light[..., :2] / np.maximum(whole, LEAST_LIGHT)[..., None]
        own = _light(np.array(self.rgb))
        off = np.linalg.norm(parts - own[:2] / own.sum(), axis=2)
        return np.asarray((off < self.tolerance) & (whole > LEAST_LIGHT))


@dataclass(frozen=True)
class Lens:
    """A pinhole camera of an endoscope.

    Attributes:
        tangent: Of half of the picture's height: 0.577 for 60 degrees.
        baseline: Distance of both lenses, m; their axes are parallel.
    """

    tangent: float = math.tan(math.radians(30.0))
    baseline: float = 0.0042

    def triangulate(self, left: Numbers, right: Numbers) -> Numbers:
        """A point by its image points in both lenses: x, y, z (m) in dVRK's camera frame.

        That is between the lenses: left, up, forward.

        Raises:
            ValueError: The rays do not meet in front of the lenses.
        """
        apart = float(left[0] - right[0]) * self.tangent
        if apart <= 0.0:
            raise ValueError(f"the rays of {left.tolist()} and {right.tolist()} do not meet")
        depth = self.baseline / apart
        middle = 0.5 * (left + right) * self.tangent * depth
        return np.array([-middle[0], -middle[1], depth])

    def turned(self, point: Numbers, before: Pose, after: Pose) -> Numbers:
        """An image point of something far away, after the camera has turned.

        What is nearer also moves by what the camera has moved sideways, which is left out.
        """
        ray = np.array([-point[0] * self.tangent, -point[1] * self.tangent, 1.0])
        left, up, forward = after.rotation.T @ (before.rotation @ ray)
        return np.asarray(np.array([-left, -up]) / (forward * self.tangent))


def find(picture: Picture, colour: Colour) -> Numbers | None:
    """The image point of the largest region of a colour: the mean of its pixels; or ``None``."""
    rows, columns = largest_region(colour.mask(picture))
    if len(rows) < LEAST_PIXELS:
        return None
    height, width = picture.shape[:2]
    right, down = columns.mean() + 0.5 - width / 2.0, rows.mean() + 0.5 - height / 2.0
    return np.asarray(np.array([right, down]) / (height / 2.0))


def locate(
    left: Picture, right: Picture, colour: Colour, lens: Lens, world_from_camera: Pose
) -> Numbers | None:
    """Where the middle of what has a colour is in the world, m; ``None`` where a lens misses it."""
    seen = [find(picture, colour) for picture in (left, right)]
    if seen[0] is None or seen[1] is None:
        return None
    try:
        point = lens.triangulate(seen[0], seen[1])
    except ValueError:
        return None
    return np.asarray(world_from_camera.position + world_from_camera.rotation @ point)


def largest_region(mask: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns of the largest region of a mask whose pixels hang together by their sides.

    Runs of each row are joined with those that they touch in the row above.
    """
    parents: list[int] = []
    runs: list[tuple[int, int, int]] = []

    def root(index: int) -> int:
        while parents[index] != index:
            parents[index] = parents[parents[index]]
            index = parents[index]
        return index

    above: Sequence[int] = ()
    edges = np.diff(np.pad(mask, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    for row in range(mask.shape[0]):
        starts, ends = np.flatnonzero(edges[row] > 0), np.flatnonzero(edges[row] < 0)
        here = range(len(runs), len(runs) + len(starts))
        for index, start, end in zip(here, starts.tolist(), ends.tolist(), strict=True):
            parents.append(index)
            runs.append((row, start, end))
            for other in above:
                if runs[other][1] < end and start < runs[other][2]:
                    parents[root(index)] = root(other)
        above = here
    sizes: dict[int, int] = {}
    for index, (_, start, end) in enumerate(runs):
        sizes[root(index)] = sizes.get(root(index), 0) + end - start
    if not sizes:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    most = max(sizes, key=lambda region: sizes[region])
    kept = [run for index, run in enumerate(runs) if root(index) == most]
    rows = np.concatenate([np.full(end - start, row) for row, start, end in kept])
    columns = np.concatenate([np.arange(start, end) for _, start, end in kept])
    return rows, columns


def _light(rgb: Any) -> Numbers:
    """Light, 0 to 1, of numbers of sRGB, 0 to 255."""
    part = np.asarray(rgb, np.float64) / 255.0
    return np.where(part <= 0.04045, part / 12.92, ((part + 0.055) / 1.055) ** 2.4)
