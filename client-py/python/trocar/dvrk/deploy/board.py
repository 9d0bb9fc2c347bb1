"""Where the endoscope is, by AprilTags whose places in the scene are known.

``python -m trocar.dvrk.deploy.board --at 0.5,0,0.6751 --out board`` writes a sheet to print and lay
on the tray, and the file that says where its tags are. Tags of a pegboard go into such a file too.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from trocar._extras import install_command
from trocar.dvrk.deploy.geometry import Numbers, Pose, between, numbers
from trocar.dvrk.deploy.pictures import Lens, Picture
from trocar.errors import InvalidOption, LaunchError, TrocarError, Unsupported, refuse

FAMILY = "36h11"

LEAST_TAGS = 3
"""Least tags that must be seen: two in a row leave the camera's tilt open by a degree."""

HALF_PIXEL = 0.5
"""AprilTag counts from a pixel's corner, OpenCV's camera from its middle."""

CV_FROM_CAMERA = np.diag([-1.0, -1.0, 1.0])
"""From dVRK's camera frame (left, up, forward) to OpenCV's (right, down, forward)."""

DOTS = 12_000.0
"""Pixels of a printed sheet in a metre: 305 in an inch."""


@dataclass(frozen=True)
class Tag:
    """A printed tag.

    Attributes:
        size: Of its black square, m.
        pose: Of its middle in the scene: x to its right, y to its top, z out of the paper.
    """

    size: float
    pose: Pose

    def corners(self) -> Numbers:
        """Its black square's corners in the scene, m, shape (4, 3): clockwise from the top left."""
        half = 0.5 * self.size
        flat = [[-half, half, 0.0], [half, half, 0.0], [half, -half, 0.0], [-half, -half, 0.0]]
        return np.asarray(np.array(flat) @ self.pose.rotation.T + self.pose.position)


class Board:
    """Tags of the family 36h11 by their numbers.

    Raises:
        trocar.errors.Unsupported: OpenCV is missing.
    """

    def __init__(self, tags: Mapping[int, Tag]) -> None:
        self.tags = dict(tags)
        self._cv = _opencv()
        aruco = self._cv.aruco
        asked = aruco.DetectorParameters()
        asked.cornerRefinementMethod = aruco.CORNER_REFINE_APRILTAG
        self._detector = aruco.ArucoDetector(_family(aruco), asked)

    @classmethod
    def read(cls, path: Path) -> Board:
        """Of a JSON file: ``{"family": "36h11", "tags": [{"id", "size", "pose"}, …]}``.

        A pose is x, y, z (m), then x, y, z, w of a quaternion.

        Raises:
            trocar.errors.InvalidOption: The file is missing, or a named field is wrong.
        """
        try:
            told = json.loads(path.read_text())
            family = str(told["family"])
            tags = {
                int(tag["id"]): (float(tag["size"]), np.array(tag["pose"], np.float64))
                for tag in told["tags"]
            }
        except (OSError, ValueError, KeyError, TypeError) as error:
            allowed = 'a file {"family": "36h11", "tags": [{"id": 0, "size": m, "pose": [7]}, …]}'
            raise refuse(InvalidOption, "--board", f"{path} ({error})", allowed) from error
        if family != FAMILY:
            raise refuse(InvalidOption, "board family", family, f"allowed is {FAMILY}")
        for number, (size, pose) in tags.items():
            is_pose = pose.shape == (7,) and np.isfinite(pose).all() and any(pose[3:])
            if not (is_pose and 0.0 < size < np.inf):
                allowed = "a size above 0 m and a pose of 7 finite numbers were expected"
                raise refuse(InvalidOption, f"board tag {number}", (size, pose.tolist()), allowed)
        if len(tags) < LEAST_TAGS:
            allowed = f"at least {LEAST_TAGS} tags were expected"
            raise refuse(InvalidOption, "--board", f"{path} ({len(tags)} tags)", allowed)
        return cls(
            {
                number: Tag(size, Pose.of_numbers(pose.tolist()))
                for number, (size, pose) in tags.items()
            }
        )

    def camera(self, left: Picture, right: Picture, lens: Lens) -> Pose | None:
        """The camera between the lenses, in the scene; ``None`` where a lens misses the tags."""
        places = [self.lens(picture, lens) for picture in (left, right)]
        if places[0] is None or places[1] is None:
            return None
        return between(places[0], places[1], 0.5)

    def lens(self, picture: Picture, lens: Lens) -> Pose | None:
        """Where the lens of a picture is in the scene; ``None`` where it sees too few tags."""
        corners, found, _ = self._detector.detectMarkers(picture)
        seen = [] if found is None else found.ravel().tolist()
        pairs = [pair for pair in zip(seen, corners, strict=True) if pair[0] in self.tags]
        if len(pairs) < LEAST_TAGS:
            return None
        scene = np.concatenate([self.tags[number].corners() for number, _ in pairs])
        image = np.concatenate([at.reshape(4, 2) for _, at in pairs]).astype(np.float64)
        image -= HALF_PIXEL
        height, width = picture.shape[:2]
        focal = 0.5 * height / lens.tangent
        matrix = np.array(
            [[focal, 0.0, 0.5 * width - 0.5], [0.0, focal, 0.5 * height - 0.5], [0.0, 0.0, 1.0]]
        )
        is_solved, turn, step = self._cv.solvePnP(
            scene, image, matrix, None, flags=self._cv.SOLVEPNP_SQPNP
        )
        if not is_solved:
            return None
        turn, step = self._cv.solvePnPRefineLM(scene, image, matrix, None, turn, step)
        cv_from_scene = Pose(self._cv.Rodrigues(turn)[0], step.ravel())
        return cv_from_scene.inverse() @ Pose(CV_FROM_CAMERA, np.zeros(3))


def sheet(at: Numbers, apart: tuple[float, float], size: float) -> dict[str, Any]:
    """Four tags that lie flat around a point of the scene, as a file of :meth:`Board.read`.

    Args:
        at: The point, m, shape (3,).
        apart: How far apart their middles are in x and y, m.
        size: Of each, m.
    """
    signs = np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]])
    middles = np.round(at + 0.5 * signs * [*apart, 0.0], 6).tolist()
    tags = [
        {"id": number, "size": size, "pose": [*middle, 0.0, 0.0, 0.0, 1.0]}
        for number, middle in enumerate(middles)
    ]
    return {"family": FAMILY, "tags": tags}


def drawn(tags: Mapping[int, Tag], dots: float = DOTS) -> Picture:
    """A sheet with tags that lie flat and unturned, seen from above: uint8 (H, W), y upwards.

    White is around each tag: as much as two of the eight cells of its side.
    """
    cv = _opencv()
    corners = np.concatenate([tag.corners() for tag in tags.values()])[:, :2]
    margin = max(tag.size for tag in tags.values()) / 4.0
    low, high = corners.min(axis=0) - margin, corners.max(axis=0) + margin
    width, height = np.round((high - low) * dots).astype(int).tolist()
    paper = np.full((height, width), 255, np.uint8)
    for number, tag in tags.items():
        side = round(tag.size * dots)
        left, top = tag.corners()[0, :2]
        column, row = round((left - low[0]) * dots), round((high[1] - top) * dots)
        mark = cv.aruco.generateImageMarker(_family(cv.aruco), number, side)
        paper[row : row + side, column : column + side] = mark
    return paper


def main(arguments: Sequence[str] | None = None) -> int:
    """Writes ``OUT.png`` and ``OUT.json``; the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m trocar.dvrk.deploy.board",
        description="A sheet of four AprilTags to print, and where they are in the scene.",
    )
    parser.add_argument(
        "--at", type=numbers, required=True, help="its middle in the scene: x,y,z m"
    )
    parser.add_argument("--apart", type=numbers, default=(0.12, 0.1), help="x,y m (%(default)s)")
    parser.add_argument("--size", type=float, default=0.018, help="of a tag, m (%(default)s)")
    parser.add_argument("--out", type=Path, required=True, help="the files' name")
    given = parser.parse_args(arguments)
    try:
        if len(given.at) != 3 or len(given.apart) != 2:
            raise refuse(InvalidOption, "--at, --apart", (given.at, given.apart), "3 and 2 numbers")
        if not 0.0 < given.size < 0.8 * min(given.apart):
            raise refuse(InvalidOption, "--size", given.size, "above 0, below 0.8 of --apart")
        opencv = _opencv()
        file = given.out.with_suffix(".json")
        file.write_text(json.dumps(sheet(np.array(given.at), given.apart, given.size), indent=1))
        paper = drawn(Board.read(file).tags)
        opencv.imwrite(str(given.out.with_suffix(".png")), paper)
    except (TrocarError, LaunchError, OSError) as error:
        print(f"trocar.dvrk.deploy.board: {error}", file=sys.stderr)
        return 2
    high, wide = (1e3 * pixels / DOTS for pixels in paper.shape)
    print(f"print {given.out}.png {wide:.1f} mm wide and {high:.1f} mm high, and measure a tag")
    return 0


def _opencv() -> Any:
    try:
        import cv2
    except ImportError as error:
        raise Unsupported(f"a board of tags needs OpenCV: {install_command('deploy')}") from error
    return cv2


def _family(aruco: Any) -> Any:
    return aruco.getPredefinedDictionary(aruco.DICT_APRILTAG_36h11)


if __name__ == "__main__":
    sys.exit(main())
