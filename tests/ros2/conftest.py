"""Starts `trocar dvrk` for the tests, each with a domain of ROS 2 of its own."""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import threading
from collections.abc import Iterator
from typing import Any

import pytest
from crtk_client import Arm, Ros

BINARY = os.environ["TROCAR_DVRK"]

IS_SOAK = bool(os.environ.get("TROCAR_SOAK"))
"""Whether real time is judged: only where the machine has nothing else to do."""

_domains = itertools.count(1)


def _stop(process: subprocess.Popen[str]) -> None:
    process.send_signal(signal.SIGINT)
    try:
        assert process.wait(20) == 0, f"trocar dvrk ended with {process.returncode}"
    except subprocess.TimeoutExpired:
        process.kill()
        raise


def _drain(process: subprocess.Popen[str]) -> None:
    for _ in process.stderr or []:
        pass


class Start:
    """Starts the program with arguments, and connects to it."""

    def __init__(self) -> None:
        self.started: list[tuple[subprocess.Popen[str], Ros]] = []

    def __call__(self, *arguments: str) -> Ros:
        domain = next(_domains)
        process = subprocess.Popen(
            [BINARY, "--domain", str(domain), *arguments], stderr=subprocess.PIPE, text=True
        )
        for line in process.stderr or []:
            if "ready" in line:
                break
        else:
            raise AssertionError(f"trocar dvrk did not start: {process.wait()}")
        # What it says from now on must not fill the pipe.
        threading.Thread(target=_drain, args=[process], daemon=True).start()
        ros = Ros(domain)
        self.started.append((process, ros))
        return ros

    def stop(self, ros: Ros) -> None:
        """Ends the program that this is connected to."""
        process = next(process for process, known in self.started if known is ros)
        if process.poll() is None:
            _stop(process)

    def close(self) -> None:
        """Ends all."""
        for _, ros in self.started:
            ros.close()
            self.stop(ros)


@pytest.fixture(scope="module")
def start() -> Iterator[Start]:
    """Starts the program with these arguments, and connects to it."""
    start = Start()
    yield start
    start.close()


@pytest.fixture(scope="module")
def ros(start: Start) -> Ros:
    """A world with PSM1, in which arms move as dVRK's kinematic simulation does."""
    return start("--task", "NeedleReach-v0")


@pytest.fixture(scope="module")
def psm(ros: Ros) -> Arm:
    """Its PSM1, connected."""
    arm = Arm(ros, "PSM1")
    arm.check_connections()
    return arm


@pytest.fixture
def homed(psm: Arm) -> Arm:
    """PSM1 at zero, its jaw closed."""
    if psm.state is None or psm.state.state != "ENABLED":
        assert psm.enable(10)
    assert psm.home(10)
    psm.told["goal_reached"].clear()
    assert psm.move_jp([0.0, 0.0, 0.12, 0.0, 0.0, 0.0]).wait()
    assert psm.jaw(0.0).wait()
    # Topics have no order among each other: what is told of a move may come after its state.
    assert psm.ros.until(lambda: len(psm.told["goal_reached"]) >= 2, 5.0)
    psm.told["goal_reached"].clear()
    psm.told["warning"].clear()
    psm.told["error"].clear()
    return psm


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """Prints what was measured."""
    figures = [
        value
        for report in terminalreporter.stats.get("passed", [])
        for key, value in report.user_properties
        if key == "figure"
    ]
    for figure in figures:
        terminalreporter.write_line(figure)
