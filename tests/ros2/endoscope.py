"""Pictures of the endoscope over ROS 2.

For ``python -m trocar.dvrk.deploy StaticTrack --poses pictures --pictures endoscope:pictures``.
"""

from __future__ import annotations

import atexit
import os
import struct
import zlib
from functools import cache
from typing import Any

import numpy as np
from crtk_client import Ros, seconds
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CompressedImage

PATIENCE = 10.0
"""How long the first pair may take, s."""

KEPT = 16
"""How many pictures of a lens wait for the other's."""


def unpacked(png: bytes) -> Any:
    """A PNG file of 8-bit RGB, as uint8 (H, W, 3)."""
    assert png[:8] == b"\x89PNG\r\n\x1a\n"
    at, data, width, height = 8, b"", 0, 0
    while at < len(png):
        length, kind = struct.unpack(">I4s", png[at : at + 8])
        if kind == b"IHDR":
            width, height = struct.unpack(">II", png[at + 8 : at + 16])
        if kind == b"IDAT":
            data += png[at + 8 : at + 8 + length]
        at += length + 12
    rows = np.frombuffer(zlib.decompress(data), np.uint8).reshape(height, 1 + 3 * width)
    # The program gives the difference to the row above: PNG's filter 2.
    assert set(rows[:, 0].tolist()) == {2}
    return np.cumsum(rows[:, 1:], axis=0, dtype=np.uint8).reshape(height, width, 3)


class Endoscope:
    """The latest pair of pictures."""

    def __init__(self) -> None:
        self._ros = Ros(int(os.environ["ROS_DOMAIN_ID"]), "eyes")
        atexit.register(self._ros.close)
        self._halves: dict[str, dict[float, bytes]] = {"left": {}, "right": {}}
        self._pair: tuple[bytes, bytes, float] | None = None
        self._subscriptions = [
            self._ros.node.create_subscription(
                CompressedImage,
                f"endoscope/{side}/image_raw/compressed",
                lambda message, side=side: self._keep(side, message),
                qos_profile_sensor_data,
            )
            for side in ("left", "right")
        ]

    def _keep(self, side: str, message: Any) -> None:
        """Where a script is slow, each topic drops other pictures: pairs are found by stamps."""
        with self._ros.changed:
            self._halves[side][seconds(message.header)] = bytes(message.data)
            left, right = (self._halves[side] for side in ("left", "right"))
            pairs = left.keys() & right.keys()
            if pairs:
                stamp = max(pairs)
                self._pair = (left[stamp], right[stamp], stamp)
                self._ros.changed.notify_all()
            for half in (left, right):
                for old in sorted(half)[:-KEPT]:
                    del half[old]

    def pictures(self) -> tuple[Any, Any, float, None]:
        """Of both lenses, and their stamp."""
        if not self._ros.until(lambda: self._pair is not None, PATIENCE):
            raise TimeoutError("endoscope: no pictures")
        assert self._pair is not None
        left, right, stamp = self._pair
        return unpacked(left), unpacked(right), stamp, None


@cache
def endoscope() -> Endoscope:
    """The only one of this process."""
    return Endoscope()


def pictures() -> tuple[Any, Any, float, None]:
    """The latest pictures of both lenses."""
    return endoscope().pictures()
