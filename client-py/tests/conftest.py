"""One server for all tests of a session, and scripts that run in processes of their own."""

from __future__ import annotations

import contextlib
import gc
import os
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest

import trocar
from trocar.registration import TAGS, TASKS

WATCHDOG = 60.0
"""Seconds after which a test that waits has failed; nothing here takes that long."""

WITHOUT_GOALS = tuple(task for task in TASKS if "endless" in TAGS[task])
"""Tasks whose observations are one array."""

SLOW = [task for task in TASKS if "tissue" in TAGS[task]]
"""Tasks whose steps take long; what all tasks share is tested with the first of them."""

TRIED = tuple(task for task in TASKS if task not in SLOW[1:])
"""Tasks that most tests are run with."""

Script = Callable[..., subprocess.Popen[str]]

Interrupted = Callable[[Callable[[], object]], None]

# A shell that runs the tests in the background has Ctrl-C ignored, and what ignores a signal hands
# that down to the processes it starts.
signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_configure(config: pytest.Config) -> None:
    """Tags of tasks are markers."""
    for tag in sorted(frozenset().union(*TAGS.values())):
        config.addinivalue_line("markers", f"{tag}: of a task with this tag")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """A test of a task has the task's tags as markers: ``-m "not grasp"`` leaves some out."""
    for item in items:
        parameters = getattr(item, "callspec", None)
        for value in parameters.params.values() if parameters else ():
            for tag in TAGS.get(value, ()) if isinstance(value, str) else ():
                item.add_marker(tag)


@pytest.fixture(scope="session")
def server() -> Iterator[str]:
    """The name of a server that all tests share."""
    with trocar.Server(name=f"pytest-{os.getpid()}", threads=2) as running:
        yield running.name
        gc.collect()  # errors that were caught have frames with connections
    assert left_behind(running.name) == []


@pytest.fixture
def own_server() -> Iterator[trocar.Server]:
    """A server that a test may stop, pause and kill."""
    with trocar.Server(threads=1) as running:
        yield running


@pytest.fixture(params=TRIED)
def task(request: pytest.FixtureRequest) -> str:
    """Every task, of the slow ones one."""
    return str(request.param)


@pytest.fixture(params=[task for task in TRIED if task not in WITHOUT_GOALS])
def goal_task(request: pytest.FixtureRequest) -> str:
    """Every task with goals, of the slow ones one."""
    return str(request.param)


@pytest.fixture
def script(tmp_path: Path) -> Iterator[Script]:
    """Starts Python code as a process tree of its own, which is killed when the test ends."""
    started: list[subprocess.Popen[str]] = []

    def start(code: str, **variables: str) -> subprocess.Popen[str]:
        path = tmp_path / f"script{len(started)}.py"
        path.write_text(textwrap.dedent(code))
        inherited = {
            name: value
            for name, value in os.environ.items()
            if name not in ("TROCAR_SERVER", "TROCAR_PRIVATE_SERVER")
        }
        process = subprocess.Popen(
            [sys.executable, "-W", "error", str(path)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            bufsize=1,
            env={**inherited, **variables},
            start_new_session=True,
        )
        started.append(process)
        return process

    yield start
    for process in started:
        # Its children are in its group, and hold on to its output.
        for pid in in_group(process.pid):
            if not tracks_resources(pid):
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
        process.communicate()
        # Python's own tracker ends by itself, after it has removed what the killed ones left.
        eventually(partial(is_gone, process.pid))


@pytest.fixture
def interrupted(own_server: trocar.Server) -> Iterator[Interrupted]:
    """Interrupts, as Ctrl-C does, what waits for the server, which then goes on."""

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    def run(wait: Callable[[], object]) -> None:
        assert own_server.pid is not None
        os.kill(own_server.pid, signal.SIGSTOP)
        threads = Path(f"/proc/{own_server.pid}/task")
        eventually(lambda: all(state(thread) == "T" for thread in threads.iterdir()))
        signal.setitimer(signal.ITIMER_REAL, 0.05)
        try:
            with pytest.raises(KeyboardInterrupt):
                wait()
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0)
            os.kill(own_server.pid, signal.SIGCONT)

    before = signal.signal(signal.SIGALRM, interrupt)
    yield run
    signal.signal(signal.SIGALRM, before)


def is_gone(group: int) -> bool:
    """Whether all processes of a process group have ended."""
    return not any(alive(pid) for pid in in_group(group))


def in_group(group: int) -> list[int]:
    """The processes of a process group."""
    found = []
    for entry in Path("/proc").iterdir():
        with contextlib.suppress(OSError, ValueError):
            if os.getpgid(int(entry.name)) == group:
                found.append(int(entry.name))
    return found


def tracks_resources(pid: int) -> bool:
    """Whether a process is the one in which ``multiprocessing`` tracks shared memory."""
    try:
        return b"resource_tracker" in Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return False


def say(process: subprocess.Popen[str], line: str = "") -> None:
    """Sends a line to a script, which waits for it with ``input()``."""
    assert process.stdin is not None
    process.stdin.write(line + "\n")
    process.stdin.flush()


def hear(process: subprocess.Popen[str]) -> str:
    """The next line that a script prints, under the watchdog."""
    assert process.stdout is not None
    os.set_blocking(process.stdout.fileno(), False)
    heard = ""
    deadline = time.monotonic() + WATCHDOG
    while not heard.endswith("\n"):
        part = process.stdout.readline()
        heard += part
        if not part:
            assert process.poll() is None or heard, f"the script ended with {process.returncode}"
            assert time.monotonic() < deadline, f"the script is stuck after {heard!r}"
            time.sleep(0.005)
    return heard.strip()


def eventually(condition: Callable[[], bool]) -> None:
    """Waits under the watchdog until something holds."""
    deadline = time.monotonic() + WATCHDOG
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def alive(pid: int) -> bool:
    """Whether a process runs; one that ended and was not collected yet does not."""
    try:
        return state(Path(f"/proc/{pid}")) != "Z"
    except FileNotFoundError:
        return False


def state(process: Path) -> str:
    """The letter that the kernel has for the state of a process or thread under /proc."""
    return (process / "stat").read_text().rpartition(")")[2].split()[0]


def left_behind(name: str) -> list[str]:
    """What is left of a server of that name and of its clients in shared memory."""
    folder = f"trocar.{os.getuid()}.{name}"
    number = 0x811C9DC5
    for byte in folder.encode():
        number = (number ^ byte) * 0x01000193 % 2**32
    prefix = f"trocar-{number:08x}."
    return [
        entry for entry in os.listdir("/dev/shm") if entry == folder or entry.startswith(prefix)
    ]
