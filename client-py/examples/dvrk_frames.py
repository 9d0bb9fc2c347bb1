"""Draws which points and axes a script's poses are about: ``python dvrk_frames.py frames.png``.

Left: ``measured_cp`` and the tip of closed jaws. Right: the remote centres of both PSMs and of the
ECM, in whose frames poses are unless another base frame is set. Needs matplotlib.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from trocar import dvrk

SIZE = (480, 560)
"""Rows and columns of each picture."""

TIP = 0.0102
"""From measured_cp to the tip of closed jaws, m."""

Vector = NDArray[np.float64]


def matrix(pose: list[float]) -> NDArray[np.float64]:
    """A pose, x, y, z and x, y, z, w of a quaternion, as a 4 by 4 matrix."""
    x, y, z, i, j, k, w = pose
    turned = [
        [1 - 2 * (j * j + k * k), 2 * (i * j - k * w), 2 * (i * k + j * w), x],
        [2 * (i * j + k * w), 1 - 2 * (i * i + k * k), 2 * (j * k - i * w), y],
        [2 * (i * k - j * w), 2 * (j * k + i * w), 1 - 2 * (i * i + j * j), z],
        [0.0, 0.0, 0.0, 1.0],
    ]
    return np.array(turned)


class Picture:
    """A picture of a world from a placed camera, and what is drawn over it.

    Args:
        axes: Where it is drawn.
        task: The task whose world it is.
        eye: Where the camera is, m.
        target: What is in the middle, m.
        view: How high the picture is, degrees.
    """

    def __init__(
        self,
        axes: Axes,
        task: str,
        eye: tuple[float, float, float],
        target: tuple[float, float, float],
        view: float,
    ) -> None:
        self.axes = axes
        camera = {"camera": "placed", "camera_eye": eye, "camera_target": target}
        options = {**camera, "camera_view": view, "image_size": SIZE}
        with dvrk.session(task, homing="in_place", view=options) as world:
            ral = dvrk.crtk.ral("frames")
            arms = {name: self.arm(ral, name) for name in world.live.arms}
            for name, arm in arms.items():
                assert arm.enable(10)
                assert arm.home(10)
                if name != "ECM":
                    arm.jaw.open(0.6).wait()
            self.bases = {name: matrix(world.live.describe(name)[2]) for name in arms}
            self.ends = {
                name: self.bases[name] @ matrix(world.live.pose(name, "measured_cp")[0])
                for name in arms
            }
            axes.imshow(world.live.render())
        axes.set_axis_off()
        axes.set(xlim=(0, SIZE[1]), ylim=(SIZE[0], 0))
        # Rows: right, down and forward of the camera.
        forward = np.subtract(target, eye) / np.linalg.norm(np.subtract(target, eye))
        right = np.cross(forward, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        self._eye, self._axes = np.array(eye), np.array([right, np.cross(forward, right), forward])
        self._focal = SIZE[0] / 2 / np.tan(np.radians(view) / 2)

    @staticmethod
    def arm(ral: Any, name: str) -> Any:
        """An arm by its name."""
        return dvrk.ecm(ral, name) if name == "ECM" else dvrk.psm(ral, name)

    def pixel(self, point: Vector) -> tuple[float, float]:
        """Where a point of the world is in the picture."""
        x, y, z = self._axes @ (point - self._eye)
        return SIZE[1] / 2 + self._focal * x / z, SIZE[0] / 2 + self._focal * y / z

    def frame(self, pose: NDArray[np.float64], length: float, words: str, beside: Any) -> None:
        """Draws the axes of a frame, x red, y green, z blue, and names it."""
        start = self.pixel(pose[:3, 3])
        for axis, colour in enumerate(("tab:red", "tab:green", "tab:blue")):
            end = self.pixel(pose[:3, 3] + length * pose[:3, axis])
            arrow = {"arrowstyle": "-|>", "color": colour, "linewidth": 2}
            self.axes.annotate("", end, start, arrowprops=arrow)
        self.point(pose[:3, 3], words, beside)

    def point(self, point: Vector, words: str, beside: Any) -> None:
        """Marks a point and names it, so many pixels beside."""
        x, y = self.pixel(point)
        self.axes.plot(x, y, "o", color="white", markeredgecolor="black", markersize=5)
        line = {"arrowstyle": "-", "color": "white"}
        box = {"boxstyle": "round", "facecolor": "white", "alpha": 0.8, "edgecolor": "none"}
        self.axes.annotate(
            words, (x, y), (x + beside[0], y + beside[1]), arrowprops=line, bbox=box, fontsize=9
        )


def main() -> None:
    """Draws both pictures."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("out", help="the PNG to write")
    figure = Figure(figsize=(9.6, 4.4), layout="constrained")
    near, far = figure.subplots(1, 2)

    world = Picture(near, "NeedleReach-v0", (0.58, -0.03, 0.775), (0.5, 0.05, 0.7515), 17)
    wrist = world.ends["PSM1"]
    tip = wrist[:3, 3] + TIP * wrist[:3, 2]
    world.frame(wrist, 0.008, "measured_cp", (70, -50))
    world.point(tip, f"tip of closed jaws,\nz = {1e3 * TIP:.1f} mm", (70, 20))
    near.set_title("the pose of a PSM", fontsize=10)

    world = Picture(far, "NeedleRegrasp-v0", (1.25, -0.75, 1.25), (0.5, 0.0, 0.82), 30)
    places = {"PSM1": (-60, -120), "PSM2": (-240, -70), "ECM": (-20, 110)}
    for name, base in world.bases.items():
        world.frame(base, 0.12, f"{name}: remote centre", places[name])
    far.set_title("base frames: x red, y green, z blue", fontsize=10)
    figure.savefig(parser.parse_args().out, dpi=100)


if __name__ == "__main__":
    main()
