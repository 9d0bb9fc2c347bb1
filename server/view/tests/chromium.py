"""A headless Chromium, driven through a pipe by its DevTools protocol. Nothing else is needed.

The messages are JSON with a zero byte at the end, written to the browser's descriptor 3 and read
from 4: https://chromedevtools.github.io/devtools-protocol/.
"""

from __future__ import annotations

import base64
import contextlib
import json
import os
import select
import shutil
import struct
import subprocess
import tempfile
import time
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

#: How long anything may take that takes a second on an idle machine, s.
PATIENCE = 90.0

#: Without a display, a GPU, and anything that it would do on its own.
ARGUMENTS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-dev-shm-usage",
    "--disable-quic",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-default-apps",
    "--disable-extensions",
    "--disable-sync",
    "--no-first-run",
    "--no-default-browser-check",
    "--no-proxy-server",
    "--hide-scrollbars",
    "--mute-audio",
    "--remote-debugging-pipe",
]


def program() -> str:
    """The browser: ``$TROCAR_CHROMIUM``, else Debian's on the path."""
    found = os.environ.get("TROCAR_CHROMIUM") or shutil.which("chromium")
    if not found:
        raise RuntimeError("no chromium: apt-get install chromium, or set TROCAR_CHROMIUM")
    return found


class ProtocolError(Exception):
    """The browser refused a command, or a script of the page failed."""


@dataclass
class Chromium:
    """A browser with one page. Ends with the ``with`` block, whatever happens there.

    It draws without a graphics processor: the smaller its window (px), the faster.
    """

    width: int = 640
    height: int = 400
    #: Every address that the page asked for, in order.
    requests: list[str] = field(default_factory=list)
    #: Errors, of the page and those that it wrote to its console.
    errors: list[str] = field(default_factory=list)

    def __enter__(self) -> Chromium:
        self._folder = tempfile.mkdtemp(prefix="trocar-chromium-")
        to_browser, self._commands = os.pipe()
        self._answers, from_browser = os.pipe()
        arguments = [
            *ARGUMENTS,
            f"--user-data-dir={self._folder}",
            f"--window-size={self.width},{self.height}",
            "about:blank",
        ]
        # The shell puts the pipes where the browser looks for them.
        script = f'exec "$@" 3<&{to_browser} 4>&{from_browser}'
        self._process = subprocess.Popen(
            ["/bin/bash", "-c", script, "bash", program(), *arguments],
            pass_fds=(to_browser, from_browser),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        os.close(to_browser)
        os.close(from_browser)
        self._number = 0
        self._buffer = b""
        self._session: str | None = None
        try:
            self._attach()
        except BaseException:
            self.__exit__()
            raise
        return self

    def _attach(self) -> None:
        target: dict[str, Any] = {}

        def has_page() -> bool:
            infos = self.call("Target.getTargets")["targetInfos"]
            target.update(next((info for info in infos if info["type"] == "page"), {}))
            return bool(target)

        self.wait("the browser has a page", has_page)
        answer = self.call("Target.attachToTarget", targetId=target["targetId"], flatten=True)
        self._session = answer["sessionId"]
        for domain in ("Page", "Network", "Runtime", "Log"):
            self.call(f"{domain}.enable")

    def __exit__(self, *_: object) -> None:
        os.close(self._commands)
        os.close(self._answers)
        try:
            self._process.wait(10)
        except subprocess.TimeoutExpired:
            # It has a process group of its own.
            os.killpg(self._process.pid, 9)
            self._process.wait()
        shutil.rmtree(self._folder, ignore_errors=True)

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Gives a command and waits for its result."""
        self._number += 1
        number = self._number
        message: dict[str, Any] = {"id": number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._commands, json.dumps(message).encode() + b"\0")
        deadline = time.monotonic() + PATIENCE
        while True:
            answer = self._receive(deadline)
            if answer is None:
                raise TimeoutError(f"{method}: no answer within {PATIENCE} s")
            if answer.get("id") == number:
                break
        if "error" in answer:
            raise ProtocolError(f"{method}: {answer['error']}")
        result: dict[str, Any] = answer["result"]
        return result

    def _receive(self, deadline: float) -> dict[str, Any] | None:
        """The next message; takes note of it where it is an event. ``None`` after the deadline."""
        while b"\0" not in self._buffer:
            left = deadline - time.monotonic()
            if left <= 0 or not select.select([self._answers], [], [], left)[0]:
                return None
            read = os.read(self._answers, 1 << 20)
            if not read:
                raise ProtocolError("the browser has ended")
            self._buffer += read
        text, self._buffer = self._buffer.split(b"\0", 1)
        message: dict[str, Any] = json.loads(text)
        parameters = message.get("params", {})
        match message.get("method"):
            case "Network.requestWillBeSent":
                self.requests.append(parameters["request"]["url"])
            case "Network.webSocketCreated":
                self.requests.append(parameters["url"])
            case "Runtime.consoleAPICalled" if parameters["type"] == "error":
                self.errors.append(" ".join(str(arg.get("value")) for arg in parameters["args"]))
            case "Runtime.exceptionThrown":
                self.errors.append(json.dumps(parameters["exceptionDetails"])[:2000])
            case "Log.entryAdded" if parameters["entry"]["level"] == "error":
                self.errors.append(parameters["entry"]["text"])
        return message

    def open(self, address: str) -> None:
        """Goes to an address."""
        self.call("Page.navigate", url=address)

    def run(self, script: str) -> Any:
        """The value of an expression in the page."""
        answer = self.call("Runtime.evaluate", expression=script, returnByValue=True)
        if "exceptionDetails" in answer:
            raise ProtocolError(f"{script}: {answer['exceptionDetails']}")
        return answer["result"].get("value")

    def wait(self, what: str, holds: Callable[[], object]) -> None:
        """Waits until ``holds`` says so."""
        deadline = time.monotonic() + PATIENCE
        while not holds():
            if time.monotonic() > deadline:
                raise TimeoutError(f"waited {PATIENCE} s in vain until {what}; {self.errors}")
            time.sleep(0.05)

    def wait_for(self, script: str) -> None:
        """Waits until an expression in the page is true."""
        self.wait(script, lambda: self.run(script))

    def click(self, selector: str) -> None:
        """Clicks on the middle of an element, as a mouse does."""
        box = json.loads(
            self.run(
                f"JSON.stringify(document.querySelector({selector!r}).getBoundingClientRect())"
            )
        )
        at = {"x": box["x"] + box["width"] / 2, "y": box["y"] + box["height"] / 2}
        for kind in ("mousePressed", "mouseReleased"):
            self.call("Input.dispatchMouseEvent", type=kind, button="left", clickCount=1, **at)

    def press(self, key: str) -> None:
        """Presses a key and lets it go."""
        self.hold(key)
        self.call("Input.dispatchKeyEvent", type="keyUp", key=key)

    @contextlib.contextmanager
    def holding(self, key: str) -> Iterator[None]:
        """Holds a key down."""
        self.hold(key)
        try:
            yield
        finally:
            self.call("Input.dispatchKeyEvent", type="keyUp", key=key)

    def hold(self, key: str) -> None:
        """Presses a key."""
        text = {"text": key} if len(key) == 1 else {}
        self.call("Input.dispatchKeyEvent", type="keyDown", key=key, **text)

    def resize(self, width: int, height: int) -> None:
        """Gives the page another size, px."""
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=False,
        )

    def picture(self) -> bytes:
        """The page as a PNG, once it has drawn what was asked of it before."""
        drawn = "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"
        self.call("Runtime.evaluate", expression=drawn, awaitPromise=True)
        return base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])


def pixels(png: bytes) -> tuple[int, int, list[bytes]]:
    """Width, bytes per pixel and rows of a PNG with 8 bits per channel."""
    at, data, head = 8, b"", b""
    while at < len(png):
        length, kind = struct.unpack(">I4s", png[at : at + 8])
        body = png[at + 8 : at + 8 + length]
        if kind == b"IHDR":
            head = body
        elif kind == b"IDAT":
            data += body
        at += 12 + length
    width, height, depth, colour = struct.unpack(">IIBB", head[:10])
    if depth != 8 or colour not in (2, 6):
        raise ValueError("not 8 bits of red, green, blue")
    each = 3 if colour == 2 else 4
    raw, rows, above = zlib.decompress(data), [], bytearray(each * width)
    for row in range(height):
        start = row * (each * width + 1)
        kind, line = raw[start], bytearray(raw[start + 1 : start + 1 + each * width])
        for index in range(len(line)):
            left = line[index - each] if index >= each else 0
            corner = above[index - each] if index >= each else 0
            line[index] = (line[index] + _predict(kind, left, above[index], corner)) & 0xFF
        rows.append(bytes(line))
        above = line
    return width, each, rows


def _predict(kind: int, left: int, above: int, corner: int) -> int:
    """What PNG's filters take a byte to be, by its neighbours."""
    if kind == 4:
        guess = left + above - corner
        return min((left, above, corner), key=lambda each: abs(guess - each))
    return (0, left, above, (left + above) // 2)[kind]


def changed(one: bytes, other: bytes) -> int:
    """How many pixels of two pictures of the same size differ visibly."""
    (width, each, rows), (_, _, others) = pixels(one), pixels(other)
    count = 0
    for row, another in zip(rows, others, strict=True):
        if row != another:
            for at in range(0, each * width, each):
                pair = zip(row[at : at + 3], another[at : at + 3], strict=True)
                count += max(abs(a - b) for a, b in pair) > 12
    return count
