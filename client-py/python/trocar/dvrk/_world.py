"""The live world of a script, and the script's clock."""

from __future__ import annotations

import math
import threading
import time as _time
from collections.abc import Callable, Mapping
from typing import Any

from trocar import _trocar
from trocar._connection import connect
from trocar.dvrk._clock import Clock
from trocar.errors import TrocarError

TICKS = 240
"""Ticks in a second of the world."""

LONGEST = 240
"""Most ticks that are waited for at once, so that every message is short."""

PATIENT_READS = 200
"""Readings without a pause after which a tick passes.

A script that asks again and again without sleeping would otherwise wait without end in lock-step.
"""

FRESH = 0.002
"""How old a reading of a world at its own pace may be, s."""

_clock = _time.monotonic
_sleep = _time.sleep


class Feed:
    """What an arm told of its operating state, as far as this process has heard."""

    def __init__(self) -> None:
        self.state = ""
        self.is_homed = False
        self.is_busy = False
        self.stamp = 0.0
        self.count = 0
        self.busy_count = 0
        """Messages that said that the arm is busy."""
        self.goal_reached: bool | None = None

    def note(self, stamp: float, topic: str, value: Any) -> None:
        """Takes note of an event."""
        if topic == "operating_state":
            self.state, self.is_homed, self.is_busy = value
            self.stamp = stamp
            self.count += 1
            self.busy_count += self.is_busy
        elif topic == "goal_reached":
            self.goal_reached = value


class World:
    """A live world that a script drives.

    Time is the script's: in lock-step it passes only while the script sleeps or waits, else at the
    world's pace. Stamps and :meth:`now` count from the moment at which the world was opened.

    Args:
        task: Id of the task whose world it is.
        server: Name of the server; ``None`` for ``$TROCAR_SERVER``, else a private one.
        seed: Which episode it is.
        speed: How many times as fast as life; ``None`` for lock-step.
        options: Options of the task.
        homing: ``to_zero`` or ``in_place``.
        world: Number of the session whose world is shared; task, options and speed must be its own.
            Another script drives the arms that it commanded first.
        in_world: Whether the arms' poses are in the frame of the world, and not of their remote
            centres.
        complain: What is told of warnings and errors of arms: the arm, and the words.
        view: How ``world.live.render()`` draws the world, as ``render_options`` of environments.
        live: A world that another engine simulates: an object with the methods of
            :class:`trocar._trocar.LiveWorld`. No server is asked for one then.
    """

    def __init__(
        self,
        task: str = "NeedlePick-v0",
        *,
        server: str | None = None,
        seed: int = 0,
        speed: float | None = None,
        options: Mapping[str, Any] | None = None,
        homing: str = "to_zero",
        world: int | None = None,
        in_world: bool = False,
        complain: Callable[[str, str], object] | None = None,
        view: Mapping[str, Any] | None = None,
        live: Any = None,
    ) -> None:
        self.live: _trocar.LiveWorld = live or connect(server).open_live(
            task, seed=seed, options=options, homing=homing, speed=speed, world=world, view=view
        )
        self.feeds = {name: Feed() for name in self.live.arms}
        self.objects = {name.replace(" ", "_"): name for name in self.live.objects}
        """Names of the objects, by those that they have as namespaces."""
        self.clock: Clock | None = None
        """The clock that the threads of a script share in lock-step, once it is in place."""
        self._complain = complain
        self._speed = speed
        self._lock = threading.RLock()
        self._commanded = False
        self._reads = 0
        self._began = _time.time()
        self._passed = 0.0
        self._looked = (_clock(), self.live.ticks)
        if in_world:
            for arm in self.live.arms:
                *_, base = self.live.describe(arm)
                self.command(arm, "set_base_frame", base[:3], base[3:], "world")
            self.look()

    # ---- Time ----

    def now(self) -> float:
        """The script's time, s since 1970 at the beginning and at the world's pace from there."""
        return self._began + self.elapsed()

    def elapsed(self) -> float:
        """The script's time since the world was opened, s: more exact than :meth:`now`."""
        if self._speed is not None:
            # Where the server had no time for the world, the script's time waits for it.
            seen, ticks = self._looked
            present = ticks / TICKS + (_clock() - seen) * self._speed
            self._passed = max(self._passed, present)
        return self._passed

    def stamped(self, stamp: float) -> float:
        """A stamp of the world in the script's time; 0, which says that there is nothing, stays."""
        return self._began + stamp if stamp > 0.0 else 0.0

    def sleep(self, seconds: float) -> None:
        """Lets time pass."""
        if seconds < 0.0:
            raise ValueError("sleep length must be non-negative")
        if self.clock is not None:
            self.clock.sleep(seconds)
            return
        with self._lock:
            if self._speed is None:
                due = self._passed + seconds
                while self._passed < due:
                    self.come_to(due)
                return
            if self._commanded:
                self.look()
        _sleep(seconds / self._speed)

    def wait(self, holds: Callable[[], bool], timeout: float) -> bool:
        """Lets time pass until something holds, at most for so many seconds; whether it does."""
        deadline = self.elapsed() + timeout
        self.look()
        if self.clock is not None:
            return holds() or self.clock.until(holds, timeout, on_events=True)
        while not holds():
            if self.elapsed() >= deadline:
                return False
            self.come_to(deadline, until_event=True, exactly=False)
        return True

    def come_to(self, moment: float, until_event: bool = False, exactly: bool = True) -> None:
        """Lets time pass as far as one message goes, until a moment of :meth:`elapsed` at most.

        Args:
            moment: When it ends.
            until_event: Whether it ends with an arm's event before.
            exactly: Whether the last tick is the one before the moment, and not the one after.
        """
        with self._lock:
            if exactly:
                # A hair more, so that sums of decimal fractions come to their ticks.
                due = math.floor(moment * TICKS + 1e-6) - self.live.ticks
            else:
                due = max(1, math.ceil((moment - self.elapsed()) * TICKS))
            if due > 0:
                due -= self._advance(min(due, LONGEST), until_event)
            if exactly and due <= 0:
                self._passed = max(self._passed, moment)
            else:
                self._passed = max(self._passed, self.live.ticks / TICKS)

    def _advance(self, ticks: int, until_event: bool = False) -> int:
        self._commanded = False
        if ticks > 0:
            self._reads = 0
        passed = self.live.advance(ticks, until_event)
        self._listen()
        return passed

    # ---- Arms ----

    def command(
        self, arm: str, topic: str, numbers: Any = (), more: Any = (), text: str = ""
    ) -> None:
        """Gives an arm a command, which it takes with the next tick or look."""
        self._use_clock()
        with self._lock:
            self.live.command(arm, topic, numbers, more, text)
            self._commanded = True

    def look(self) -> None:
        """Gives the commands and hears what arms have told; no time passes in lock-step."""
        with self._lock:
            self._advance(0)

    def hear(self) -> None:
        """Hears what commands that were given have led to."""
        with self._lock:
            if self._commanded:
                self.look()
            self.read()

    def read(self) -> None:
        """Sees to it that what is read next is as new as it can be."""
        self._use_clock()
        with self._lock:
            if self._speed is not None:
                if self._commanded or _clock() - self._looked[0] > FRESH:
                    self.look()
                return
            self._reads += 1
            if self._reads > PATIENT_READS:
                self._advance(1)
                self._passed = max(self._passed, self.live.ticks / TICKS)

    def _use_clock(self) -> None:
        if self.clock is not None:
            self.clock.use()

    def _listen(self) -> None:
        self._looked = (_clock(), self.live.ticks)
        for arm, stamp, topic, value in self.live.events():
            if topic in ("warning", "error"):
                if self._complain is not None:
                    self._complain(arm, f"{topic}: {value}")
            else:
                self.feeds[arm].note(stamp, topic, value)

    def ask(self, arm: str, question: str, numbers: Any, more: Any = ()) -> tuple[list[float], str]:
        """Asks a service of an arm: numbers and an empty text, or none and why."""
        with self._lock:
            return self.live.ask(arm, question, numbers, more)

    def close(self) -> None:
        """Ends the world; the arms stop."""
        self.live.close()


_current: World | None = None


def current() -> World:
    """The world of this process's script.

    Raises:
        TrocarError: There is none: ``python -m trocar.dvrk`` and :func:`use` make one.
    """
    if _current is None:
        raise TrocarError("no live world: run the script by `python -m trocar.dvrk script.py`")
    return _current


def use(world: World | None) -> None:
    """Makes a world the one that the classes of ``crtk`` and ``dvrk`` drive."""
    global _current
    _current = world
