"""Saved states of environments."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from weakref import WeakKeyDictionary

from numpy.typing import ArrayLike

from trocar import _trocar
from trocar._arrays import octets, selected
from trocar.errors import UnknownSnapshot


class Snapshot:
    """The states of some environments, in the order in which they were named.

    What follows a restored state has the same bits as what followed the snapshot. The states stay
    in the server, which counts their memory, until the snapshot is deleted or its environment is
    closed. :meth:`to_bytes` and pickling take them along: some hundred bytes for each environment,
    good for the same task and options under the same release of Trocar. Such a state is rebuilt
    where it is first restored, which takes as long as its episode took up to there.

    Indices select states, as in ``snapshot[0]``, ``snapshot[2:4]``, ``snapshot[[0, 0, 3]]`` or, by
    a truth value for each state, ``snapshot[succeeded]``.
    """

    def __init__(
        self,
        session: _trocar.Session | None = None,
        states: _trocar.Snapshot | None = None,
        parts: Sequence[bytes] = (),
    ) -> None:
        """Made by ``snapshot()`` of environments, and by :meth:`from_bytes`.

        Args:
            session: The session that keeps the states.
            states: Its states.
            parts: Or else the states as bytes.
        """
        self._parts = list(parts)
        self._kept: WeakKeyDictionary[_trocar.Session, _trocar.Snapshot] = WeakKeyDictionary()
        if session is not None and states is not None:
            self._kept[session] = states
        self._length = len(parts) if states is None else len(states)

    @classmethod
    def from_bytes(cls, data: ArrayLike) -> Snapshot:
        """The snapshot that :meth:`to_bytes` wrote.

        Args:
            data: The bytes, or one row of one-byte elements: a bytearray, memoryview or array.
        """
        return cls(parts=_trocar.split_snapshot(octets(data, "data")))

    def to_bytes(self) -> bytes:
        """The states as bytes; for the first time, while the environment is open."""
        if not self._parts:
            kept = next(iter(self._kept.items()), None)
            if kept is None:
                raise UnknownSnapshot("the snapshot ended with its environment")
            session, states = kept
            self._parts = _trocar.split_snapshot(session.export_snapshot(states))
        return b"".join(self._parts)

    def states_in(self, session: _trocar.Session) -> _trocar.Snapshot:
        """The states in the server of ``session``, where they are brought if they are not there."""
        if session not in self._kept:
            self._kept[session] = session.import_snapshot(self.to_bytes())
        return self._kept[session]

    def __len__(self) -> int:
        """Number of states."""
        return self._length

    def __getitem__(self, index: slice | ArrayLike) -> Snapshot:
        """A snapshot of some of the states."""
        chosen = selected(index, len(self))
        if not chosen:
            raise IndexError("a snapshot has at least one state")
        part = Snapshot(parts=[self._parts[number] for number in chosen] if self._parts else ())
        part._length = len(chosen)
        for session, states in self._kept.items():
            part._kept[session] = states.select(chosen)
        return part

    def __reduce__(self) -> tuple[Callable[[bytes], Snapshot], tuple[bytes]]:
        return Snapshot.from_bytes, (self.to_bytes(),)

    def __repr__(self) -> str:
        return f"<trocar snapshot of {len(self)} environments>"
