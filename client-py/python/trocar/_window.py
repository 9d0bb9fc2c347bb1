"""``render_mode="human"``: environments in the server's live viewer, in the user's browser."""

from __future__ import annotations

import logging
import os
import time
import webbrowser

from trocar._connection import Connection

_log = logging.getLogger("trocar")


class Window:
    """The page that shows a session; it is opened once, and where there is a display.

    Args:
        seconds: Simulated time of a step, s, below which :meth:`step` does not return; 0 not to
            wait.
    """

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self._session: int | None = None
        self._is_open = False
        self._due = 0.0

    def begin(self, connection: Connection) -> None:
        """Shows the session of a connection, unless it does already."""
        session = connection.session_id()
        if session == self._session:
            return
        self._session, address = session, connection.viewer()
        self._is_open = has_display() and webbrowser.open(address)
        if not self._is_open:
            _log.warning("there is no display; watch at %s", address)

    def step(self) -> None:
        """Waits until as much time has passed as was simulated, where a page watches."""
        if not self._is_open:
            return
        now = time.monotonic()
        self._due = max(self._due + self._seconds, now)
        time.sleep(self._due - now)


def has_display() -> bool:
    """Whether a browser would be seen, and not take the terminal that a program runs in."""
    return any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"))
