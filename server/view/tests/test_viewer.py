"""The live viewer in a real browser: ``make test-browser``.

The server is ``$TROCAR_BINARY``; trainers are ``trocar rollout --server``. Run as a program with a
file's name, it writes the README's picture of the page.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
from chromium import PATIENCE, Chromium, changed, pixels

BINARY = os.environ.get("TROCAR_BINARY", "trocar")


class Server:
    """A server with a viewer, and trainers in it."""

    def __init__(self, *trainers: tuple[str, ...], port: str = "0") -> None:
        self.name = f"view-{os.getpid() % 10**5}-{time.monotonic_ns() % 10**6}"
        self._log = tempfile.NamedTemporaryFile(mode="w+")
        # One core is for the browser, which draws without a graphics processor here.
        serve = [BINARY, "serve", "--name", self.name, "--threads", "1"]
        command = [*serve, "--view", port, "--log-format", "json"]
        self.process = subprocess.Popen(command, stderr=self._log)
        self._trainers: list[subprocess.Popen[bytes]] = []
        try:
            self.address = self._serving()["view"]
            for arguments in trainers:
                self.train(*arguments)
        except BaseException:
            self.end()
            raise

    def _serving(self) -> dict[str, Any]:
        deadline = time.monotonic() + PATIENCE
        while time.monotonic() < deadline and self.process.poll() is None:
            for line in Path(self._log.name).read_text().splitlines():
                entry: dict[str, Any] = json.loads(line)
                if entry.get("message") == "serving":
                    return entry
            time.sleep(0.05)
        raise RuntimeError(Path(self._log.name).read_text())

    def train(self, *arguments: str) -> None:
        """Starts a trainer, which goes on until the server ends; the browser goes before it."""
        rollout = [BINARY, "rollout", "--server", self.name, "--episodes", "1000000"]
        command = ["nice", *rollout, *arguments]
        trainer = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        self._trainers.append(trainer)

    def pause(self, stops: bool) -> None:
        """Stops all trainers, or lets them go on."""
        for trainer in self._trainers:
            trainer.send_signal(signal.SIGSTOP if stops else signal.SIGCONT)

    def end(self, how: signal.Signals = signal.SIGTERM) -> None:
        """Ends the server and its trainers."""
        for process in (self.process, *self._trainers):
            if process.poll() is None:
                process.send_signal(signal.SIGCONT)
                process.send_signal(how if process is self.process else signal.SIGKILL)
        for process in (self.process, *self._trainers):
            process.wait(PATIENCE)
        self._log.close()
        if how == signal.SIGKILL:
            subprocess.run([BINARY, "clean", "--name", self.name], capture_output=True, check=False)

    def __enter__(self) -> Server:
        return self

    def __exit__(self, *_: object) -> None:
        self.end()


PICK = ("--task", "NeedlePick-v0", "--envs", "4")
TRACK = ("--task", "ActiveTrack-v0", "--envs", "2")

#: Goes to a place in a recording.
SLIDE = (
    "((at) => { const slider = document.querySelector('#slider');"
    " slider.value = at; slider.dispatchEvent(new Event('input')); })"
)

#: Which camera's button is pressed.
CAMERA = "document.querySelector('#cameras [aria-pressed=true]')?.textContent"

#: Whatever does not fit into its place and is neither cut short nor scrolled.
OVERFLOWING = (
    "[...document.querySelectorAll('#side *, .panel, .panel *')].filter((each) =>"
    " each.clientWidth > 0 && each.scrollWidth > each.clientWidth + 1"
    " && getComputedStyle(each).overflowX === 'visible'"
    ").map((each) => each.id || each.className || each.tagName)"
)

#: Panels that stick out of the theatre, or cover another one.
MISPLACED = (
    "[...document.querySelectorAll('main > .panel')].filter((panel, index, panels) => {"
    " const main = document.querySelector('main').getBoundingClientRect();"
    " const box = panel.getBoundingClientRect();"
    " const covers = (other) => { const there = other.getBoundingClientRect();"
    "   return other !== panel && box.left < there.right && there.left < box.right"
    "     && box.top < there.bottom && there.top < box.bottom; };"
    " return box.width > 0 && (box.left < main.left || box.right > main.right"
    "   || box.top < main.top || box.bottom > main.bottom || panels.some(covers));"
    "}).map((panel) => panel.id)"
)

#: Shows nothing but the theatre, so that pixels that change are the arm's.
BARE = (
    "document.head.insertAdjacentHTML('beforeend',"
    " '<style>main > :not(canvas), #side > * { visibility: hidden !important }</style>')"
)


def watch(browser: Chromium, server: Server, task: str) -> None:
    """Opens the page and clicks on the session of a task."""
    browser.open(f"http://{server.address}/")
    browser.wait_for("document.body?.dataset.link === 'open'")
    cards = "[...document.querySelectorAll('.session')]"
    find = f"{cards}.find((card) => card.innerText.includes('{task}'))"
    browser.wait_for(f"!!{find}")
    browser.run(f"{find}.setAttribute('data-wanted', '')")
    browser.click("[data-wanted]")
    browser.wait_for("Number(document.body.dataset.frames) > 3")


def stands_still(browser: Chromium) -> bool:
    """Whether nothing changes in what a browser shows for a while."""
    first = browser.picture()
    time.sleep(0.5)
    return changed(first, browser.picture()) < 20


def test_it_lists_sessions_and_shows_a_moving_arm() -> None:
    """Tasks, rates, numbers, the endoscope, and pixels that change until the view is paused."""
    with Server(PICK, TRACK) as server, Chromium(900, 600) as browser:
        browser.open(f"http://{server.address}/")
        browser.wait_for("document.querySelectorAll('.session').length === 2")
        text = browser.run("document.querySelector('#sessions').innerText")
        for part in ("NeedlePick", "4 envs", "ActiveTrack", "2 envs", "steps/s", "p99"):
            assert part in text
        assert server.name in browser.run("document.querySelector('#server').innerText")
        watch(browser, server, "NeedlePick")
        # Its numbers: the task, the jaws, the endoscope's picture, the reward.
        browser.wait_for("document.querySelector('#step').innerText.includes('/ 50')")
        assert browser.run("document.querySelector('#task').innerText") == "NeedlePick-v0"
        assert "PSM1" in browser.run("document.querySelector('#jaws').innerText")
        browser.wait_for("document.querySelector('#reward').innerText !== '\u2013'")
        browser.wait_for("!document.querySelector('#endoscope').hidden")
        sample = (
            "new Set(document.querySelector('#endoscope canvas').getContext('2d')"
            ".getImageData(0, 0, 192, 192).data).size"
        )
        assert browser.run(sample) > 50
        # It moves, and stands still while it is paused though the trainer goes on.
        browser.run(BARE)
        browser.press("2")
        first = browser.picture()
        browser.wait("the arm moves", lambda: changed(first, browser.picture()) > 300)
        browser.press(" ")
        # The camera may still be on its way.
        browser.wait("the picture stands still", lambda: stands_still(browser))
        frames = browser.run("document.body.dataset.frames")
        still = browser.picture()
        steps = "document.querySelector('[data-wanted] .speed').textContent"
        time.sleep(1.5)
        assert browser.run("document.body.dataset.frames") == frames
        assert changed(still, browser.picture()) < 20
        assert browser.run(steps) != "0 steps/s"
        browser.press(" ")
        browser.wait_for(f"Number(document.body.dataset.frames) > {frames}")
        assert browser.errors == []


def test_environments_paces_and_cameras_are_chosen_by_keys() -> None:
    """Every key does what the help says."""
    with Server(PICK) as server, Chromium() as browser:
        watch(browser, server, "NeedlePick")
        browser.press("ArrowRight")
        browser.wait_for("document.querySelector('#env').value === '1'")
        browser.wait_for("Number(document.body.dataset.frames) > 3")
        browser.press("ArrowLeft")
        browser.press("ArrowLeft")
        browser.wait_for("document.querySelector('#env').value === '3'")
        for key in "lll":
            browser.press(key)
            frames = browser.run("document.body.dataset.frames")
            browser.wait_for(f"document.body.dataset.frames !== '{frames}'")
        for key in "1233":
            browser.press(key)
        assert browser.run(CAMERA) == "Endoscope"
        for key in "ce?":
            browser.press(key)
        assert browser.run("document.querySelector('#help').open")
        assert browser.run("location.hash").endswith("env=3")
        assert browser.errors == []


def test_it_loads_nothing_from_any_other_host() -> None:
    """Neither does it try, nor would it succeed."""
    with Server(PICK) as server, Chromium() as browser:
        watch(browser, server, "NeedlePick")
        hosts = {urlsplit(address).netloc for address in browser.requests if "://" in address}
        assert hosts == {server.address}
        live = [address for address in browser.requests if address.startswith("ws:")]
        assert set(live) == {f"ws://{server.address}/live"}
        # And could not if it would.
        browser.run("fetch('http://127.0.0.2:9/').catch((error) => (window.refused = `${error}`))")
        browser.wait_for("window.refused")
        assert any("Content Security Policy" in line for line in browser.errors)


@pytest.mark.parametrize(
    ("how", "message", "link"),
    [(signal.SIGTERM, "has ended", "ended"), (signal.SIGKILL, "is lost", "lost")],
)
def test_the_end_of_the_server_is_said_and_survived(
    how: signal.Signals, message: str, link: str
) -> None:
    """However it ended: with a clear message, and the page finds the next server by itself."""
    with Chromium() as browser:
        server = Server(PICK)
        try:
            watch(browser, server, "NeedlePick")
        finally:
            server.end(how)
        browser.wait_for("document.body.dataset.link !== 'open'")
        notice = browser.run("document.querySelector('#notice').innerText")
        assert message in notice
        assert server.name in notice
        assert browser.run("document.body.dataset.link") == link
        assert not browser.run("document.querySelector('#notice').hidden")
        # The next server at that address is found without the user's help.
        port = server.address.rsplit(":", 1)[1]
        with Server(TRACK, port=port):
            browser.wait_for("document.body.dataset.link === 'open'")
            browser.wait_for(
                "document.querySelector('#sessions').innerText.includes('ActiveTrack')"
            )
            assert browser.run("document.querySelector('#notice').hidden")


@contextlib.contextmanager
def replayed(task: str) -> Iterator[str]:
    """The address of a recording of two episodes of a task, ``trocar replay --view``."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "recorded.trocar"
        record = ("record", "--task", task, "--episodes", "2", "--out", str(file))
        subprocess.run([BINARY, *record], check=True, capture_output=True)
        command = [BINARY, "replay", str(file), "--view", "0"]
        with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as replay:
            try:
                assert replay.stderr is not None
                line = next(line for line in replay.stderr if "watch it at" in line)
                yield line.split()[3].rstrip(";")
            finally:
                replay.send_signal(signal.SIGINT)
        assert replay.returncode == 0


def test_a_recording_plays_and_the_slider_goes_anywhere_in_it() -> None:
    """``trocar replay --view``: from its beginning to its end, again, and step by step."""
    with replayed("NeedleReach-v0") as address:
        play(address)


def play(address: str) -> None:
    """Plays the recording at an address in all ways that there are."""
    step = "document.querySelector('#step').textContent"
    with Chromium(720, 480) as browser:
        browser.open(address)
        browser.wait_for("document.querySelector('#slider')?.max === '50'")
        assert "recorded.trocar" in browser.run("document.querySelector('#sessions').innerText")
        for _ in range(3):
            browser.press("+")
        browser.wait_for(f"{step} === '50 / 50'")
        button = "document.querySelector('#pause').textContent"
        assert browser.run(button) == "Again"
        total = browser.run("document.querySelector('#return').textContent")
        browser.run(f"{SLIDE}(7)")
        assert browser.run(step) == "7 / 50"
        browser.press(".")
        assert browser.run(step) == "8 / 50"
        browser.press(",")
        browser.press(",")
        assert browser.run(step) == "6 / 50"
        # What is shown differs from place to place, and is the same at the same place: unless the
        # page has just become coarser because the machine is slow, which it does at most thrice.
        browser.run(BARE)

        def at(place: int) -> bytes:
            browser.run(f"{SLIDE}({place})")
            return browser.picture()

        def there_and_back() -> bool:
            early, late, again = at(6), at(30), at(6)
            return changed(early, late) > 200 and changed(early, again) < 20

        browser.wait("the same place looks the same", there_and_back)
        # To the end again, with the same sum of rewards; then the other episode.
        browser.press(" ")
        browser.wait_for(f"{step} === '50 / 50'")
        assert browser.run("document.querySelector('#return').textContent") == total
        browser.press("ArrowRight")
        browser.wait_for("document.querySelector('#seed').textContent === '1'")
        assert browser.errors == []


def test_what_is_soft_bends() -> None:
    """A blue disk under a sheet is hidden at first, and is seen once the sheet is lifted."""
    blue = (
        "(() => { const { data } = document.querySelector('#endoscope canvas').getContext('2d')"
        ".getImageData(0, 0, 192, 192); let count = 0;"
        " for (let at = 0; at < data.length; at += 4)"
        " count += data[at] < 60 && data[at + 2] > 150;"
        " return count; })()"
    )
    with replayed("TissueRetract-v0") as address, Chromium() as browser:
        browser.open(address)
        browser.wait_for("document.querySelector('#slider')?.max === '60'")
        browser.run(f"{SLIDE}(30)")
        browser.wait_for(f"{blue} > 15")
        browser.run(f"{SLIDE}(0)")
        browser.wait_for(f"{blue} === 0")
        assert browser.errors == []


def test_it_works_in_narrow_windows() -> None:
    """Nothing sticks out of the window of a telephone."""
    with Server(PICK) as server, Chromium() as browser:
        browser.resize(390, 844)
        watch(browser, server, "NeedlePick")
        browser.wait_for("!document.querySelector('#endoscope').hidden")
        outside = (
            "[...document.querySelectorAll('main > .panel')].filter((panel) => {"
            " const box = panel.getBoundingClientRect();"
            " return box.left < 0 || box.right > innerWidth || box.bottom > innerHeight;"
            "}).map((panel) => panel.id)"
        )
        assert browser.run(outside) == []
        assert browser.run("document.documentElement.scrollWidth") <= 390


def test_the_only_session_opens_by_itself() -> None:
    """At once where it is there already, else as soon as it is."""
    watched = "document.querySelector('[aria-current=true]')?.innerText.includes('ActiveTrack')"
    shown = "Number(document.body?.dataset.frames) > 3"
    with Server() as server, Chromium() as browser:
        browser.open(f"http://{server.address}/")
        browser.wait_for("document.querySelector('#empty')?.innerText.includes('Nobody')")
        server.train(*TRACK)
        browser.wait_for(shown)
        assert browser.run(watched)
        browser.open("about:blank")
        browser.open(f"http://{server.address}/")
        browser.wait_for(shown)
        assert browser.run(watched)
        # Without jaws, it is seen from its overview.
        assert browser.run(CAMERA) == "Overview"
        assert browser.errors == []


def test_nothing_overflows_on_a_small_laptop() -> None:
    """Not even with two arms and the largest seeds."""
    trainer = ("--task", "BiPegTransfer-v0", "--envs", "4", "--seed", str(2**63 - 10))
    with Server(trainer) as server, Chromium(1024, 640) as browser:
        browser.resize(1024, 640)
        watch(browser, server, "BiPegTransfer")
        browser.wait_for("!document.querySelector('#endoscope').hidden")
        browser.wait_for("document.querySelectorAll('.jaw').length > 0")
        assert browser.run(OVERFLOWING) == []
        assert browser.run(MISPLACED) == []
        assert browser.run("document.documentElement.scrollWidth") == 1024


def test_it_starts_where_jaws_and_object_fill_the_picture() -> None:
    """The goal is many times as large as from the overview, and the grasp stays in the picture."""

    def is_green(red: int, green: int, blue: int) -> bool:
        return green > red + 60 and green > blue + 60

    def is_orange(red: int, green: int, blue: int) -> bool:
        return red > green + 50 and green > blue + 60

    with replayed("NeedlePick-v0") as address, Chromium(1024, 640) as browser:
        browser.resize(1024, 640)
        browser.open(address)
        browser.wait_for("document.querySelector('#slider')?.max === '50'")
        browser.wait_for("Number(document.body.dataset.frames) > 0")
        assert browser.run(CAMERA) == "Close"
        browser.run(BARE)

        def count(place: int, colour: Callable[[int, int, int], bool]) -> int:
            browser.run(f"{SLIDE}({place})")
            width, each, rows = pixels(browser.picture())
            return sum(
                colour(*row[at : at + 3]) for row in rows for at in range(0, each * width, each)
            )

        # Arrows of the forces between jaws and needle.
        assert all(count(place, is_orange) > 50 for place in (14, 20, 50))
        near = count(12, is_green)
        browser.press("1")
        assert browser.run(CAMERA) == "Overview"
        far = count(12, is_green)
        assert near > 8 * far > 0


def take_picture(path: str) -> None:
    """The README's picture: an expert at work, seen from near by."""
    regrasp = ("--task", "NeedleRegrasp-v0", "--envs", "2")
    with Server(regrasp, PICK, TRACK) as server, Chromium(1280, 760) as browser:
        browser.resize(1280, 760)
        watch(browser, server, "NeedleRegrasp")
        browser.press("2")
        browser.wait_for("!document.querySelector('#endoscope').hidden")
        browser.wait_for("document.querySelector('#stage').innerText === 'hand over'")
        browser.wait_for("document.querySelectorAll('.session .rate').length === 3")
        Path(path).write_bytes(browser.picture())


if __name__ == "__main__":
    take_picture(sys.argv[1])
