"""What keeps an arm safe from a policy: limits, and the watchdog that stops it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from trocar.dvrk.deploy.geometry import Numbers, Pose, rotation_matrix, rotation_vector
from trocar.errors import InvalidOption, TrocarError, refuse


class Stopped(TrocarError):
    """The runner stopped: the arms hold. The message names what was wrong."""


@dataclass(frozen=True)
class Limits:
    """Limits of a run; what leaves them is clipped, or stops the arms.

    Attributes:
        rate: Set-points in a second, Hz.
        stale: Longest time without a new stamp of a topic, s. Longer: the arms hold, the run ends.
        jump: Farthest that an object's pose may move from one step to the next, m. Farther: the
            arms hold until two readings agree.
        patience: How long poses may jump, and how long topics may take to begin, s.
        step: Farthest that a wrist, or the ECM's insertion, is sent in a step of the task, m;
            ``None``: as the action asks.
        turn: Farthest that a wrist, or a joint of the ECM, is turned in a step, rad; ``None``: as
            the action asks.
        held_up: How far from its set-point an arm counts as held up, m, unless it would be there
            within a step at its speed: increments then count from where it is measured to be.
        box: Where wrists may be sent, in the scene, m: x, y, z of the lower corner, then of the
            upper one; ``None``: the task's.
    """

    rate: float = 120.0
    stale: float = 0.1
    jump: float = 0.03
    patience: float = 2.0
    step: float | None = None
    turn: float | None = None
    held_up: float = 1e-3
    box: tuple[float, float, float, float, float, float] | None = None

    def __post_init__(self) -> None:
        for name in ("rate", "stale", "jump", "patience", "step", "turn", "held_up"):
            value = getattr(self, name)
            if value is not None and not 0.0 < value < np.inf:
                raise refuse(InvalidOption, name, value, "allowed are finite numbers above 0")
        if self.box is not None:
            low, high = np.reshape(self.box, (2, 3))
            if not (np.isfinite(self.box).all() and (low < high).all()):
                allowed = "x0,y0,z0,x1,y1,z1 with each of the first three below its counterpart"
                raise refuse(InvalidOption, "box", self.box, allowed)

    def confine(self, target: Pose, start: Pose, box: Numbers) -> Pose:
        """A target within the box, no farther from the start than a step goes."""
        position = np.clip(target.position, *box)
        way = position - start.position
        length = float(np.linalg.norm(way))
        if self.step is not None and length > self.step:
            position = start.position + way * (self.step / length)
        if self.turn is None:
            return Pose(target.rotation, position)
        turn = rotation_vector(target.rotation @ start.rotation.T)
        angle = float(np.linalg.norm(turn))
        if angle <= self.turn:
            return Pose(target.rotation, position)
        return Pose(rotation_matrix(turn * (self.turn / angle)) @ start.rotation, position)

    def confine_joints(self, target: Numbers, start: Numbers) -> Numbers:
        """Joints of the ECM, rad and at index 2 m, no farther from the start than a step goes."""
        turn, step = self.turn or np.inf, self.step or np.inf
        most = np.array([turn, turn, step, turn])
        return np.asarray(start + np.clip(target - start, -most, most))


def outside(what: str, place: Numbers, box: Numbers) -> str:
    """Says that a place is outside of a box, and of which; empty where it is inside."""
    low, high = box
    if bool(((place >= low) & (place <= high)).all()):
        return ""
    words = " to ".join(_mm(corner) for corner in (low, high))
    return f"{what} is at {_mm(place)}, outside of the box {words} (m, scene frame)"


def _mm(place: Numbers) -> str:
    return "(" + ", ".join(f"{number:.4f}" for number in place) + ")"


class Watchdog:
    """Tells when topics fall silent: by the runner's own clock, so that clocks need not agree."""

    def __init__(self, stale: float) -> None:
        self._stale = stale
        self._latest: dict[str, tuple[float, float]] = {}

    def check(self, stamps: Mapping[str, float], now: float) -> None:
        """Takes note of stamps.

        Args:
            stamps: The latest stamp of each topic, s.
            now: The runner's time, s.

        Raises:
            Stopped: A topic had no new stamp for too long; it is named.
        """
        for topic, stamp in stamps.items():
            latest, since = self._latest.get(topic, (-np.inf, now))
            if stamp > latest:
                self._latest[topic] = (stamp, now)
            elif now - since > self._stale:
                raise Stopped(
                    f"{topic} is stale: no new stamp for {now - since:.3f} s, allowed are "
                    f"{self._stale} s"
                )


class JumpFilter:
    """Tells whether poses of objects can be believed: what moves too far is looked at again."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._latest: dict[str, Numbers] = {}
        self._since: float | None = None

    def check(self, objects: Mapping[str, Pose], now: float) -> str:
        """What jumped since the last call, in words; empty where nothing did.

        Raises:
            Stopped: Poses jump for longer than the limits allow, or are not finite.
        """
        words = []
        for name, pose in objects.items():
            if not (np.isfinite(pose.position).all() and np.isfinite(pose.rotation).all()):
                raise Stopped(f"{name}/measured_cp is not finite: {pose.position.tolist()}")
            before = self._latest.get(name, pose.position)
            far = float(np.linalg.norm(pose.position - before))
            if far > self._limits.jump:
                allowed = f"allowed are {1e3 * self._limits.jump:.0f} mm a step"
                words.append(f"{name}/measured_cp jumped by {1e3 * far:.0f} mm, {allowed}")
            self._latest[name] = pose.position
        if not words:
            self._since = None
            return ""
        self._since = now if self._since is None else self._since
        if now - self._since > self._limits.patience:
            raise Stopped(f"{'; '.join(words)}, for more than {self._limits.patience} s")
        return "; ".join(words)
