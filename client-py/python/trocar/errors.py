"""What can go wrong; the names are those of the Rust client and of the protocol.

Messages name the field, the value it had, and what is allowed. A refused request changes nothing:
the session goes on as before.
"""

from __future__ import annotations

from typing import Any

import gymnasium.error


class TrocarError(RuntimeError):
    """Base of all errors of this package."""

    field: str | None = None
    """Which part of a request was refused, e.g. ``options.reward``; ``None`` for other errors."""
    value: str | None = None
    """The value that it had."""
    allowed: str | None = None
    """What would have been accepted."""


class InvalidRequest(TrocarError, ValueError):
    """An argument is not allowed."""


class UnknownTask(InvalidRequest):
    """The server knows no task of that name."""


class UnknownOption(InvalidRequest, TypeError):
    """The task has no option of that name.

    A ``TypeError`` too, with Python's words: libraries that try a keyword then go on without it.
    """


class InvalidOption(InvalidRequest):
    """An option or argument has a value that is not allowed."""


class InvalidEnvCount(InvalidRequest):
    """The number of environments is zero or above the server's limit."""


class InvalidAction(InvalidRequest):
    """An action has the wrong shape, or is not finite."""


class InvalidEnvIds(InvalidRequest):
    """Environment numbers are out of range, out of order, repeated or busy."""


class UnknownSnapshot(InvalidRequest):
    """The session has no such snapshot."""


class UnknownArm(InvalidRequest):
    """A live world has no such arm."""


class InvalidCommand(InvalidRequest):
    """A command to an arm of a live world is malformed."""


class ArmIsDriven(InvalidRequest):
    """Another client drives the arm."""


class InvalidSnapshot(InvalidRequest):
    """The bytes are no snapshot, or none of this task and these options."""


class ResetNeeded(TrocarError, gymnasium.error.ResetNeeded):
    """An environment was stepped before its first reset, or after its episode ended."""


class Closed(TrocarError, gymnasium.error.ClosedEnvironmentError):
    """The environment was closed."""


class MemoryBudget(TrocarError, MemoryError):
    """The session would not fit into the server's memory budget."""


class TooManySessions(TrocarError):
    """The server takes no more sessions."""


class NoServer(TrocarError):
    """No server of that name runs for this user."""


class ConnectTimeout(TrocarError, TimeoutError):
    """A server is there but does not answer."""


class CallTimeout(TrocarError, TimeoutError):
    """A connected server does not answer: it is stopped, starved, or waits itself.

    A step that was under way still is: its reply can be received once the server goes on.
    """


class LaunchError(TrocarError):
    """A server could not be started."""


class ServerLost(TrocarError):
    """The server died or was shut down, and the session with it; a reset opens a new one."""


class Reconnected(ServerLost):
    """The server was lost and found again (``reconnect=…``): the environment can be used at once.

    What was asked for was *not* carried out: where the environments are now, this tells.
    """

    resumed: str = "reset"
    """``"snapshot"``: they go on from the latest ``checkpoint()``. ``"reset"``: they begin anew,
    with the latest seeds that all of them were given, since there was no checkpoint."""
    observation: Any = None
    """What is observed there, as ``reset`` returns it."""
    info: dict[str, Any] | None = None
    """Which episodes these are, as ``reset`` tells."""


class StaleSession(ServerLost):
    """The session belongs to an earlier run of the server."""


class ShuttingDown(ServerLost):
    """The server is about to end."""


class UnknownSession(TrocarError):
    """The server has no such session any more, e.g. because it was idle for too long."""


class ForkedError(TrocarError):
    """This process was forked after the session was opened; a reset opens one of its own."""


class VersionMismatch(TrocarError):
    """Client and server speak different protocol versions."""


class SimulationError(TrocarError):
    """The simulation of an environment failed."""


class NothingInFlight(TrocarError):
    """A reply was asked for, but no request is in flight."""


class TooManyInFlight(TrocarError):
    """More requests are in flight than is allowed here; receive a reply first."""


class TooManyHeld(TrocarError):
    """Views of too many replies are held on to (``copy=False``); drop some, or copy them."""


class Busy(TrocarError):
    """Another thread waits for this session."""


class Unsupported(TrocarError):
    """The server, or the task, does not offer this."""


class Malformed(TrocarError):
    """A message did not look like this protocol."""


class TransportError(TrocarError):
    """Shared memory or its bookkeeping failed."""


class Internal(TrocarError):
    """A fault of Trocar's own; please report it."""


def refuse(
    error: type[InvalidRequest], field: str, value: object, allowed: str, words: str | None = None
) -> InvalidRequest:
    """An error that names the field, the value it had, or words for it, and what is allowed."""
    words = repr(value) if words is None else words
    refusal = error(f"{field} = {words}: {allowed}")
    refusal.field, refusal.value, refusal.allowed = field, words, allowed
    return refusal
