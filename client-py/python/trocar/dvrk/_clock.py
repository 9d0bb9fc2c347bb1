"""One clock for all threads of a script in lock-step.

Time passes only while every counted thread waits for the clock. It advances to the earliest
wake-up. A thread counts from its start to its end. A thread that waits for another event, such as a
socket, stops the clock for :data:`STALL` of real time.
"""

from __future__ import annotations

import contextlib
import datetime
import math
import queue
import selectors
import threading
import time
from _thread import RLock, allocate_lock, get_ident
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from trocar.dvrk._world import World

STALL = 0.5
"""Real time without work, s, after which a thread that waits for another event is left out."""

POLL = 0.002
"""Real time between two checks for ended threads, s."""

_real = time.monotonic


class Waiter:
    """A thread that waits: until a moment, a condition or a call of :meth:`release`."""

    def __init__(self, clock: Clock, holds: Callable[[], bool] | None, on_events: bool) -> None:
        self.clock, self.holds, self.on_events = clock, holds, on_events
        self.due = math.inf
        self.is_awake = self.is_notified = False
        self.gate = allocate_lock()
        self.gate.acquire()

    def wake(self) -> None:
        """Lets the thread go on, once."""
        if not self.is_awake:
            self.is_awake = True
            self.gate.release()

    def release(self) -> None:
        """Lets the thread go on, as ``Condition.notify`` does with locks."""
        with self.clock.mutex:
            if self.is_awake:
                raise RuntimeError("no thread waits here any more")
            self.is_notified = True
            self.wake()


class Clock:
    """The clock of a world in lock-step."""

    def __init__(self, world: World) -> None:
        self.mutex = RLock()
        self._world = world
        self._threads: dict[int, threading.Thread] = {}
        self._started: set[threading.Thread] = set()
        """Threads that have not used the clock yet."""
        self._starting: set[threading.Thread] = set()
        self._waiters: dict[int, Waiter] = {}
        self._stalled: tuple[dict[int, str], float] = ({}, 0.0)
        self._base = _real()
        self._is_over = False
        """True after the end of the script: sleeping threads then end without an error."""

    # ---- Readings ----

    def time(self) -> float:
        """``time.time``."""
        self.use()
        return self._world.now()

    def monotonic(self) -> float:
        """``time.monotonic`` and ``time.perf_counter``."""
        self.use()
        return self._base + self._world.elapsed()

    def use(self) -> None:
        """Counts the calling thread."""
        ident, thread = get_ident(), threading.current_thread()
        if self._threads.get(ident) is not thread:
            self._threads[ident] = thread
        self._started.discard(thread)

    def leave(self) -> None:
        """Removes the calling thread from the count."""
        self._threads.pop(get_ident(), None)

    # ---- Waits ----

    def sleep(self, seconds: float) -> None:
        """``time.sleep``."""
        if seconds < 0.0:
            raise ValueError("sleep length must be non-negative")
        self.wait(Waiter(self, None, False), seconds)

    def wait(self, waiter: Waiter, seconds: float | None) -> bool:
        """Waits for at most `seconds`; true if a notification ended the wait."""
        self.use()
        ident = get_ident()
        if seconds is not None:
            waiter.due = self._world.elapsed() + seconds
        with self.mutex:
            self._waiters[ident] = waiter
            self._stalled = ({}, 0.0)
        try:
            while not waiter.is_awake:
                if self._is_over:
                    raise SystemExit
                with self.mutex:
                    self._pass_time(waiter)
                if not waiter.is_awake and waiter.gate.acquire(timeout=POLL):
                    break
        finally:
            with self.mutex:
                waiter.is_awake = True
                del self._waiters[ident]
        return waiter.is_notified

    def until(
        self, holds: Callable[[], bool], seconds: float | None, on_events: bool = False
    ) -> bool:
        """Waits for at most `seconds` until `holds()` is true; returns the last `holds()`."""
        self.wait(Waiter(self, holds, on_events), seconds)
        return holds()

    def _pass_time(self, own: Waiter) -> None:
        """Lets time pass while all threads wait and this one is not awake."""
        while not own.is_awake:
            asleep = list(self._waiters.values())
            for waiter in asleep:
                is_due = waiter.due <= self._world.elapsed()
                if not waiter.is_awake and (is_due or (waiter.holds and waiter.holds())):
                    waiter.wake()
            if own.is_awake or self._is_over or not self._all_wait():
                return
            first = min(asleep, key=lambda waiter: waiter.due)
            on_events = any(waiter.on_events for waiter in asleep)
            if first.due == math.inf:
                return
            self._world.come_to(first.due, on_events, exactly=not first.on_events)

    def _all_wait(self) -> bool:
        if self._starting:
            return False
        active = {}
        for ident, thread in list(self._threads.items()):
            waiter = self._waiters.get(ident)
            if not thread.is_alive():
                if self._threads.get(ident) is thread:
                    del self._threads[ident]
            elif waiter is None or waiter.is_awake:
                active[ident] = work_of(thread)
        if not active:
            return True
        before, since = self._stalled
        if any(waiter.is_awake for waiter in self._waiters.values()) or before != active:
            self._stalled = (active, _real())
            return False
        if _real() - since < STALL:
            return False
        # A thread that never used the clock no longer counts.
        for ident in active:
            if self._threads[ident] in self._started:
                self._started.discard(self._threads.pop(ident))
        self._stalled = ({}, 0.0)
        return True

    # ---- In place of Python's ----

    @contextlib.contextmanager
    def in_place(self) -> Iterator[None]:
        """Puts the clock in the place of Python's, for this process."""
        kept = [(owner, name, getattr(owner, name)) for owner, name, _ in self._patches()]
        for owner, name, new in self._patches():
            setattr(owner, name, new)
        self.use()
        try:
            yield
        finally:
            try:
                self._join()
            finally:
                self._is_over = True
                for owner, name, old in kept:
                    setattr(owner, name, old)
                self.leave()

    def _join(self) -> None:
        """Waits for threads that a script leaves behind, as Python does."""
        own = threading.current_thread()
        while left := [
            thread
            for thread in list(self._threads.values())
            if thread is not own and not thread.daemon and thread.is_alive()
        ]:
            for thread in left:
                thread.join()

    def _patches(self) -> list[tuple[Any, str, Any]]:
        monotonic = self.monotonic
        start, join = threading.Thread.start, threading.Thread.join
        select = selectors.DefaultSelector.select

        def wait(condition: Any, timeout: float | None = None) -> bool:
            if not condition._is_owned():
                raise RuntimeError("cannot wait on un-acquired lock")
            waiter = Waiter(self, None, False)
            condition._waiters.append(waiter)
            saved = condition._release_save()
            is_notified = False
            try:
                is_notified = self.wait(waiter, None if timeout is None else max(timeout, 0.0))
            finally:
                condition._acquire_restore(saved)
                if not is_notified:
                    with contextlib.suppress(ValueError):
                        condition._waiters.remove(waiter)
            return is_notified

        def start_counted(thread: threading.Thread) -> None:
            self._starting.add(thread)
            try:
                start(thread)
                ident = thread.ident
                if ident is not None and self._threads.get(ident) is not thread:
                    self._started.add(thread)
                    self._threads[ident] = thread
            finally:
                self._starting.discard(thread)

        def join_counted(thread: threading.Thread, timeout: float | None = None) -> None:
            if thread is not threading.current_thread() and thread.ident is not None:
                limit = None if timeout is None else max(timeout, 0.0)
                if not self.until(lambda: not thread.is_alive(), limit):
                    return
            join(thread, timeout)

        def select_counted(selector: Any, timeout: float | None = None) -> Any:
            ready = select(selector, 0)
            if not ready and (timeout is None or timeout > 0):
                self.until(lambda: bool(select(selector, 0)), timeout)
                ready = select(selector, 0)
            return ready

        return [
            (time, "sleep", self.sleep),
            (time, "time", self.time),
            (time, "time_ns", lambda: round(self.time() * 1e9)),
            *((time, name, monotonic) for name in ("monotonic", "perf_counter")),
            *(
                (time, f"{name}_ns", lambda: round(monotonic() * 1e9))
                for name in ("monotonic", "perf_counter")
            ),
            (datetime, "datetime", datetime_of(self.time)),
            (threading, "_time", monotonic),
            (queue, "time", monotonic),
            (threading.Condition, "wait", wait),
            (threading.Thread, "start", start_counted),
            (threading.Thread, "join", join_counted),
            (selectors.DefaultSelector, "select", select_counted),
        ]


def work_of(thread: threading.Thread) -> str:
    """CPU time of a thread as text, which differs after each period of work."""
    try:
        text = Path(f"/proc/self/task/{thread.native_id}/stat").read_text()
    except OSError:
        return ""
    fields = text.rpartition(")")[2].split()
    return str(_real()) if fields[0] == "R" else " ".join(fields[11:13])


def datetime_of(now: Callable[[], float]) -> type[datetime.datetime]:
    """``datetime.datetime`` by another clock."""
    real = datetime.datetime

    class Kind(type):
        def __instancecheck__(cls, instance: object) -> bool:
            return isinstance(instance, real)

        def __subclasscheck__(cls, subclass: type) -> bool:
            return issubclass(subclass, real)

    class Clocked(datetime.datetime, metaclass=Kind):
        @classmethod
        def now(cls, tz: Any = None) -> Any:
            return cls.fromtimestamp(now(), tz)

        @classmethod
        def today(cls) -> Any:
            return cls.now()

        @classmethod
        def utcnow(cls) -> Any:
            return cls.now(datetime.timezone.utc).replace(tzinfo=None)

    Clocked.__name__ = Clocked.__qualname__ = "datetime"
    Clocked.__module__ = "datetime"
    return Clocked
