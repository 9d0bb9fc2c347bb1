"""Connections to servers, shared by all environments of a process, and the sessions over them."""

from __future__ import annotations

import atexit
import contextlib
import os
import secrets
import threading
import time
import weakref
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from trocar import _trocar
from trocar._arrays import described, refused, truth
from trocar._reset import Placement
from trocar.errors import (
    Closed,
    InvalidOption,
    InvalidSnapshot,
    NoServer,
    Reconnected,
    ResetNeeded,
    ServerLost,
    UnknownSession,
    refuse,
)
from trocar.server import binary
from trocar.snapshot import Snapshot

SERVER = "TROCAR_SERVER"
"""The environment variable that names the server to use where an environment names none.

An empty variable is none.
"""

PATIENCE = 60.0
"""How long ``reconnect=True`` waits for a server that is to come back, s."""

LONGEST_PAUSE = 1.0
"""The longest pause between two looks for it, s."""

Episodes = tuple[NDArray[np.uint64], NDArray[np.uint64]]
"""An episode for each environment: its seed, and its number under that seed."""

_T = TypeVar("_T")

_lock = threading.Lock()
_clients: weakref.WeakValueDictionary[str, _trocar.Client] = weakref.WeakValueDictionary()
_connections: weakref.WeakSet[Connection] = weakref.WeakSet()


def connect(server: str | None = None) -> _trocar.Client:
    """The connection of this process to a server; it ends with its last user.

    Args:
        server: Its name; ``None`` for ``$TROCAR_SERVER``, else the private server of this process
            tree, which is started if it does not run.
    """
    if not isinstance(server, str | None):
        raise refused(InvalidOption, "server", server, "the name of a server, or None")
    name = server if server is not None else os.environ.get(SERVER) or None
    key = f"name {name}" if name is not None else f"private {_private_name()}"
    with _lock:
        client = _clients.get(key)
        if client is None:
            if name is not None:
                try:
                    client = _trocar.Client.connect(name)
                except InvalidOption as error:
                    field = "server" if server is not None else f"${SERVER}"
                    raise refuse(InvalidOption, field, name, error.allowed or "") from None
            else:
                client = _trocar.Client.launch(_private_name(), binary())
            _clients[key] = client
        return client


def status(server: str | None = None) -> dict[str, Any]:
    """A server's clients and sessions, and its speed, as ``trocar status --json`` prints it."""
    return connect(server).status()


def _forget(client: _trocar.Client) -> None:
    """The next to connect shall not get this connection any more."""
    with _lock:
        for key in [key for key, known in _clients.items() if known is client]:
            del _clients[key]


def _private_name() -> str:
    """What the private server of this process tree is called; child processes inherit it."""
    name = os.environ.get(_trocar.PRIVATE_SERVER)
    if not name:
        name = os.environ[_trocar.PRIVATE_SERVER] = _trocar.unique_name()
    return name


class Connection:
    """One session, as wished for: opened, and opened anew after a fork or the loss of the server.

    Args:
        task: Task id without namespace.
        server: Name of the server, or ``None``.
        envs: Number of environments.
        autoreset: ``NextStep``, ``SameStep`` or ``Disabled``.
        expert: Whether replies carry the scripted expert's actions.
        options: The task's options.
        view: How environments are drawn when that is asked for; ``None`` if they are not.
        reconnect: For how many seconds a lost server is waited for; ``True`` for 60.
        shown: What the environments make of the reply that shows where they go on after that:
            observation and info.
        latest: The latest episodes of all environments; ``None`` if they had none.
    """

    def __init__(
        self,
        task: str,
        *,
        server: str | None,
        envs: int,
        autoreset: str,
        expert: bool,
        options: Mapping[str, Any],
        view: Mapping[str, Any] | None,
        reconnect: bool | float,
        shown: Callable[[_trocar.Reply], tuple[Any, dict[str, Any]]],
        latest: Callable[[], Episodes | None],
    ) -> None:
        if not isinstance(task, str):
            raise refused(InvalidOption, "task", task, "the id of a task, e.g. 'NeedleReach-v0'")
        self._patience = _seconds(reconnect)
        # Weakly: an environment ends where no reference to it is left.
        self._shown = weakref.WeakMethod(shown)
        self._latest = weakref.WeakMethod(latest)
        self._episodes: Episodes | None = None
        self._seed: int | None = None
        self._seeds: NDArray[np.uint64] | None = None
        self._checkpoint: Snapshot | None = None
        self.expert = truth(expert, "expert")
        self._server = server
        self._request: dict[str, Any] = {
            "task": task,
            "envs": envs,
            "autoreset": autoreset,
            "options": options,
            "view": view,
        }
        self._closed = False
        self._client: _trocar.Client | None = None
        self._session: _trocar.Session | None = None
        self._process = 0
        self.spec = self._open().spec
        _connections.add(self)

    def reset(
        self,
        env_ids: NDArray[np.uint32] | None = None,
        seeds: NDArray[np.uint64] | None = None,
    ) -> _trocar.Reply:
        """Resets environments; a reset of all opens the session anew where that is needed.

        Without seeds, a session opened anew goes on with the episodes after the latest ones.
        """
        following: Episodes | None = None
        if self._ready(everything=env_ids is None) and seeds is None:
            following = self._following()
        first, which = (seeds, None) if following is None else following
        reply = self._try(lambda session: session.reset(env_ids, first, which))
        if env_ids is None and seeds is not None:
            self._seeds = seeds
        return reply

    def arrange(
        self, env_ids: NDArray[np.uint32] | None, placements: list[Placement]
    ) -> _trocar.Reply:
        """Lets episodes that have only begun begin as placements ask for."""
        return self._try(lambda session: session.arrange(placements, env_ids))

    def step(self, actions: Any, single: bool = False) -> _trocar.Reply:
        """Steps all environments; ``single`` if their action space has no axis of environments."""
        return self._try(lambda session: session.step(actions, single))

    def send(self, actions: Any, env_ids: NDArray[np.uint32]) -> None:
        """Starts a step of some environments."""
        self._try(lambda session: session.send(actions, env_ids))

    def recv(self) -> _trocar.Reply:
        """Waits for the oldest of the steps that were started."""
        return self._try(lambda session: session.recv())

    def snapshot(self, env_ids: NDArray[np.uint32] | None = None) -> Snapshot:
        """Saves the states of environments."""
        return self._try(lambda session: Snapshot(session, session.snapshot(env_ids)))

    def restore(
        self, snapshot: Snapshot, env_ids: NDArray[np.uint32] | None = None
    ) -> _trocar.Reply:
        """Lets environments go on from a snapshot; all of them also in a session opened anew."""
        if not isinstance(snapshot, Snapshot):
            raise refused(InvalidSnapshot, "snapshot", snapshot, "a trocar.Snapshot")
        self._ready(everything=env_ids is None)
        return self._try(lambda session: session.restore(snapshot.states_in(session), env_ids))

    def render(self, env_id: int, mode: str) -> NDArray[Any]:
        """Draws an environment: ``rgb_array`` or ``depth_array``."""
        return self._try(lambda session: session.render(env_id, mode == "depth_array"))

    def session_id(self) -> int:
        """The number of the session, unique in a run of the server."""
        return self._try(lambda session: session.id)

    def viewer(self) -> str:
        """Where the session is in the server's live viewer, which is started if need be."""
        client = self._client or connect(self._server)
        return f"http://{client.viewer()}/#session={self.session_id()}&env=0"

    def fork(
        self, sources: NDArray[np.uint32], env_ids: NDArray[np.uint32] | None = None
    ) -> _trocar.Reply:
        """Lets environments go on from the present states of others."""
        return self._try(lambda session: session.fork(sources, env_ids))

    def checkpoint(self) -> None:
        """Saves the states of all environments here: where they go on after a reconnection."""
        self._checkpoint = Snapshot.from_bytes(self.snapshot().to_bytes())

    def abandon(self) -> None:
        """Gives up on the replies in flight."""
        if self._session is not None and self._process == os.getpid():
            self._session.abandon()

    @property
    def closed(self) -> bool:
        """Whether :meth:`close` was called."""
        return self._closed

    def close(self) -> None:
        """Ends the session; twice does no harm."""
        self._closed = True
        self._drop()

    def _ready(self, *, everything: bool) -> bool:
        """Opens the session anew where a request about everything needs that; whether it did."""
        if self._closed:
            raise Closed("the environment was closed")
        foreign = self._process != os.getpid()
        opens = everything and (self._session is None or foreign)
        if opens:
            self._open()
        return opens

    def _following(self) -> Episodes | None:
        """The episodes after the latest ones; ``None`` if there were none."""
        latest = self._latest()
        episodes = None if latest is None else latest()
        if episodes is None:
            return self._episodes
        seeds, numbers = episodes
        return seeds.astype(np.uint64), numbers.astype(np.uint64) + np.uint64(1)

    def _open(self, seed: int | None = None) -> _trocar.Session:
        """Opens a session. Without a seed, its seed is drawn at random, as Gymnasium wants it."""
        self._drop()
        seed = self._seed = secrets.randbits(62) if seed is None else seed
        for attempt in range(2):
            client = connect(self._server)
            try:
                session = client.open(seed=seed, **self._request)
                break
            except ServerLost:
                # The connection was made before the server was started anew.
                _forget(client)
                if attempt == 1:
                    raise
        session.want_expert(self.expert)
        self._client, self._session, self._process = client, session, os.getpid()
        return session

    def _try(self, request: Callable[[_trocar.Session], _T]) -> _T:
        if self._closed:
            raise Closed("the environment was closed")
        if self._session is None:
            raise ResetNeeded("the environment has no session; reset all of it first")
        try:
            return request(self._session)
        except (ServerLost, UnknownSession) as lost:
            self._lose()
            if self._patience > 0.0:
                raise self._reconnected(lost) from lost
            raise

    def _lose(self) -> None:
        if self._client is not None:
            _forget(self._client)
        self._drop()

    def _reconnected(self, lost: Exception) -> Reconnected:
        """Waits for a server and goes on there; what there is to tell about it."""
        deadline = time.monotonic() + self._patience
        pause = 0.01
        while True:
            try:
                session = self._open(self._seed)
                if self._checkpoint is None:
                    resumed, reply = "reset", session.reset(None, self._seeds)
                else:
                    states = self._checkpoint.states_in(session)
                    resumed, reply = "snapshot", session.restore(states, None)
                break
            except (NoServer, ServerLost):
                self._lose()
                if time.monotonic() + pause > deadline:
                    raise
            time.sleep(pause)
            pause = min(2.0 * pause, LONGEST_PAUSE)
        where = "the latest checkpoint" if resumed == "snapshot" else "a reset"
        told = Reconnected(
            f"{lost}; the session was opened again and goes on from {where}; what was asked for "
            "was not carried out"
        )
        told.resumed = resumed
        shown = self._shown()
        assert shown is not None, "whoever asks is there"
        told.observation, told.info = shown(reply)
        return told

    def _drop(self) -> None:
        session, self._session, self._client = self._session, None, None
        if session is not None and self._process == os.getpid():
            session.close()

    def __getstate__(self) -> dict[str, Any]:
        """What to open, and not what is open: a copy opens a session of its own when reset."""
        closed = {"_session": None, "_client": None, "_process": 0}
        methods = {"_shown": self._shown(), "_latest": self._latest()}
        return {**self.__dict__, **closed, **methods, "_episodes": self._following()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._shown = weakref.WeakMethod(state["_shown"])
        self._latest = weakref.WeakMethod(state["_latest"])
        _connections.add(self)

    def __del__(self) -> None:
        # Attributes are missing where `__init__` failed early.
        if getattr(self, "_session", None) is not None:
            self.close()


def _seconds(reconnect: Any) -> float:
    """For how long a lost server is waited for, s."""
    if isinstance(reconnect, bool | np.bool_):
        return PATIENCE if reconnect else 0.0
    try:
        seconds = float(reconnect)
    except (TypeError, ValueError):
        seconds = -1.0
    if not seconds >= 0.0:
        allowed = "allowed are seconds, or a bool"
        raise refuse(InvalidOption, "reconnect", reconnect, allowed, described(reconnect))
    return seconds


@atexit.register
def _close_all() -> None:
    for connection in list(_connections):
        # Whatever fails here fails because the server is gone, and the session with it.
        with contextlib.suppress(Exception):
            connection.close()


def _after_fork_in_child() -> None:
    """A child shares nothing: not the lock, not the connections, not the duty to close them."""
    global _lock, _clients, _connections
    _lock = threading.Lock()
    _clients = weakref.WeakValueDictionary()
    _connections = weakref.WeakSet()


os.register_at_fork(after_in_child=_after_fork_in_child)

# Now, so that the processes that this one starts agree on the server.
if not os.environ.get(SERVER):
    _private_name()
