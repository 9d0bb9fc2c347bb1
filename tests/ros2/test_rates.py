"""How often states come, and how soon commands act; with TROCAR_SOAK=1 for ten minutes."""

from __future__ import annotations

import itertools
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from conftest import IS_SOAK, Start
from crtk_client import Arm, Ros, seconds
from stream import sent

Record = Callable[[str, object], None]

SECONDS = 600.0 if IS_SOAK else 5.0

GROWTH = 0.05 if IS_SOAK else 1.0
"""By how much a delay may differ between the beginning and the end of a stream, s.

Commands that waited for each other would be late by seconds.
"""


@pytest.fixture(scope="module")
def ros(start: Start) -> Ros:
    return start("--task", "BiPegTransfer-v0")


@pytest.fixture(scope="module")
def arms(ros: Ros) -> list[Arm]:
    arms = [Arm(ros, name) for name in ("PSM1", "PSM2")]
    for arm in arms:
        arm.check_connections()
        assert arm.enable(10)
        assert arm.home(20)
    return arms


def p99(values: list[float]) -> float:
    return sorted(values)[int(0.99 * len(values))]


def test_states_come_at_their_rate(arms: list[Arm], record_property: Record) -> None:
    """Never more often. Less often, where the machine has other things to do: judged in a soak."""
    came: list[float] = []
    arms[0].listeners["measured_js"] = [lambda _: came.append(time.monotonic())]
    time.sleep(5.0)
    arms[0].listeners.clear()
    gaps = [later - earlier for earlier, later in itertools.pairwise(came)]
    rate = len(gaps) / (came[-1] - came[0])
    assert (80 if IS_SOAK else 0) < rate < 110, rate
    record_property(
        "figure",
        f"states: {rate:.1f} Hz, gap p99 {1e3 * p99(gaps):.1f} ms, "
        f"at most {1e3 * max(gaps):.1f} ms",
    )


def test_streams_at_1_khz_are_followed_without_growth_of_delay(
    ros: Ros, arms: list[Arm], record_property: Record
) -> None:
    acted: dict[str, list[float]] = {arm.name: [] for arm in arms}
    heard: list[float] = []
    latest: dict[str, float] = {}
    arguments = []
    for arm in arms:
        arm.fresh("setpoint_cp")
        at, turn = arm.read("setpoint_cp").pose.position, arm.read("setpoint_cp").pose.orientation
        numbers = [at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w]
        arguments += [arm.name, *map(str, numbers)]

        def note(message: Any, arm: Arm = arm, start: float = at.x) -> None:
            now, stamp, x = time.time(), seconds(message.header), message.pose.position.x
            # Before the stream and after it, set-points stay.
            if latest.get(arm.name, start) == x:
                return
            latest[arm.name] = x
            then = sent(x, start, now)
            acted[arm.name].append(stamp - then)
            heard.append(now - then)

        arm.listeners["setpoint_cp"] = [note]
    domain = str(ros.context.get_domain_id())
    program = str(Path(__file__).with_name("stream.py"))
    command = [sys.executable, program, domain, str(SECONDS), *arguments]
    stream = subprocess.run(command, capture_output=True, text=True, check=True)
    for arm in arms:
        arm.listeners.clear()
    rate = float(stream.stdout)
    assert rate > (100 if IS_SOAK else 0)
    for name, ages in acted.items():
        fifth = len(ages) // 5
        assert fifth > 2, name
        first, last = statistics.median(ages[:fifth]), statistics.median(ages[-fifth:])
        assert last < first + GROWTH, name
        record_property(
            "figure",
            f"{name}, servo_cp at {rate:.0f} Hz for {SECONDS:.0f} s: the newest command that a "
            f"set-point shows is {1e3 * statistics.median(ages):.1f} ms old (p99 "
            f"{1e3 * p99(ages):.1f} ms); first and last fifth {1e3 * first:.1f}, {1e3 * last:.1f}",
        )
    record_property(
        "figure", f"until the script has it: {1e3 * statistics.median(heard):.1f} ms (median)"
    )
