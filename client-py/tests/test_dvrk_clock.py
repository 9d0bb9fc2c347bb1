"""Threads, clocks and waits of a script in lock-step share the world's time."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

BEGIN = """
import asyncio, datetime, queue, threading, time
import crtk, dvrk

ral = crtk.ral("clocks")
arm = dvrk.psm(ral, "PSM1")
assert arm.enable(10) and arm.home(10)

def world():
    arm.measured_jp()
    return ral.now().to_sec()

def loop():
    for _ in range(100):
        arm.servo_jp(arm.setpoint_jp()[0])
        time.sleep(0.01)

def told(act):
    begin = world()
    act()
    print(round(world() - begin, 3))
"""


def passed(server: str, folder: Path, script: str) -> list[float]:
    """What a script prints: times that passed."""
    path = folder / "script.py"
    path.write_text(BEGIN + script)
    command = [sys.executable, "-W", "error", "-m", "trocar.dvrk", "--server", server]
    command += ["--task", "NeedleReach-v0", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    return [float(line) for line in done.stdout.splitlines()]


def test_two_threads_that_sleep_for_a_second_take_a_second(server: str, tmp_path: Path) -> None:
    """Also one that starts another, and one that ends before."""
    script = """
def both(*acts):
    threads = [threading.Thread(target=act) for act in acts]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()

told(lambda: both(loop, loop))
told(lambda: both(loop, lambda: time.sleep(0.3)))
told(lambda: both(lambda: both(loop), lambda: time.sleep(2)))
"""
    assert passed(server, tmp_path, script) == pytest.approx([1.0, 1.0, 2.0], abs=2e-3)


def test_a_thread_that_sleeps_moves_nothing_on_while_another_computes(
    server: str, tmp_path: Path
) -> None:
    """Be it for longer than a thread may stand still."""
    script = """
threading.Thread(target=lambda: [time.sleep(0.05) for _ in range(40)], daemon=True).start()
told(lambda: sum(k * k for k in range(15_000_000)))
told(lambda: time.sleep(1))
"""
    assert passed(server, tmp_path, script) == pytest.approx([0.0, 1.0], abs=2e-3)


def test_threads_that_a_script_leaves_behind_come_to_their_ends(
    server: str, tmp_path: Path
) -> None:
    """But for daemons, which end with it."""
    script = """
def count():
    while True:
        time.sleep(0.01)

threading.Thread(target=count, daemon=True).start()
threading.Thread(target=lambda: told(loop)).start()
"""
    assert passed(server, tmp_path, script) == pytest.approx([1.0], abs=2e-3)


def test_a_thread_that_waits_for_something_else_does_not_hold_time_up_for_ever(
    server: str, tmp_path: Path
) -> None:
    """Such as for a lock that one has who sleeps."""
    script = """
lock = threading.Lock()
def keep():
    with lock:
        time.sleep(0.2)
thread = threading.Thread(target=keep)
thread.start()
time.sleep(0.1)
told(lambda: lock.acquire())
"""
    assert passed(server, tmp_path, script) == pytest.approx([0.1], abs=2e-3)


@pytest.mark.parametrize(
    "clock",
    [
        "time.time()",
        "time.monotonic()",
        "time.perf_counter()",
        "time.time_ns() / 1e9",
        "time.monotonic_ns() / 1e9",
        "time.perf_counter_ns() / 1e9",
        "datetime.datetime.now().timestamp()",
        "datetime.datetime.now(datetime.timezone.utc).timestamp()",
    ],
)
def test_all_clocks_tell_the_time_of_the_world(server: str, tmp_path: Path, clock: str) -> None:
    """A loop of half a second at 100 Hz."""
    script = f"""
def clocked():
    begin, turns = {clock}, 0
    while {clock} - begin < 0.5 and turns < 60:
        time.sleep(0.01)
        turns += 1
told(clocked)
"""
    assert passed(server, tmp_path, script) == pytest.approx([0.5], abs=0.0105)


def test_waits_let_the_time_of_the_world_pass(server: str, tmp_path: Path) -> None:
    """Waits of threads, queues and asyncio; a wait that is notified early ends early."""
    script = """
def get():
    try:
        queue.Queue().get(timeout=0.5)
    except queue.Empty:
        pass

def wake_ups():
    event = threading.Event()
    threading.Timer(0.25, event.set).start()
    assert event.wait(5)

def joined():
    thread = threading.Thread(target=lambda: time.sleep(1))
    thread.start()
    thread.join(0.5)
    assert thread.is_alive()
    thread.join()

def holds():
    condition = threading.Condition()
    with condition:
        assert not condition.wait_for(lambda: False, 0.5)

async def several():
    await asyncio.gather(asyncio.sleep(0.5), asyncio.to_thread(time.sleep, 0.3))
    try:
        await asyncio.wait_for(asyncio.Event().wait(), 0.25)
    except asyncio.TimeoutError:
        pass

for act in (lambda: threading.Event().wait(0.5), get, wake_ups, joined, holds):
    told(act)
told(lambda: asyncio.run(several()))
"""
    expected = [0.5, 0.5, 0.25, 1.0, 0.5, 0.75]
    assert passed(server, tmp_path, script) == pytest.approx(expected, abs=5e-3)
