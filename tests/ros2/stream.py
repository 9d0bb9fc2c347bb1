"""Servoes arms at 1 kHz in a process of its own; the pose says when it was sent.

``python stream.py DOMAIN SECONDS ARM X Y Z QX QY QZ QW [ARM X Y ...]``
"""

from __future__ import annotations

import sys
import time

import rclpy
from geometry_msgs.msg import PoseStamped

HERTZ = 1000.0

PERIOD = 2.0
"""After so many s, the way along x begins anew."""

SPEED = 0.01
"""Along x, m/s."""


def sent(x: float, start: float, now: float) -> float:
    """When a pose was sent, as of its x; it was at most a period before `now`."""
    return now - (now - (x - start) / SPEED) % PERIOD


def main() -> None:
    """Runs the program."""
    domain, length, *arms = sys.argv[1:]
    rclpy.init(domain_id=int(domain))
    node = rclpy.create_node("stream")
    streams = []
    for at in range(0, len(arms), 8):
        name, *numbers = arms[at : at + 8]
        message = PoseStamped()
        place, turn = message.pose.position, message.pose.orientation
        place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w = map(float, numbers)
        publisher = node.create_publisher(PoseStamped, f"{name}/servo_cp", 10)
        while publisher.get_subscription_count() == 0:
            time.sleep(0.01)
        streams.append((publisher, message, place.x))
    began, count = time.monotonic(), 0
    while (passed := time.monotonic() - began) < float(length):
        for publisher, message, start in streams:
            message.pose.position.x = start + SPEED * (time.time() % PERIOD)
            publisher.publish(message)
        count += 1
        time.sleep(max(0.0, began + count / HERTZ - time.monotonic()))
    print(count / passed)
    rclpy.shutdown()


if __name__ == "__main__":
    main()
