"""Vectors, rotations and frames shaped like PyKDL's, for machines that have no PyKDL.

What dVRK's scripts use is here, with PyKDL's names and its rules: reading ``frame.p`` gives a part
of the frame, so that ``frame.p[0] = x`` changes it; assigning ``frame.p = v`` copies.

>>> frame = Frame(Rotation.RPY(0.0, 0.0, 0.5), Vector(1.0, 2.0, 3.0))
>>> (frame * frame.Inverse()).p.Norm() < 1e-12
True
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

EPSILON = 1e-6
"""What counts as the same number, as KDL has it."""

Numbers = NDArray[np.float64]


class Vector:
    """Three numbers."""

    __hash__ = None  # type: ignore[assignment]

    def __init__(self, x: float | Vector = 0.0, y: float = 0.0, z: float = 0.0) -> None:
        self._of: Numbers = (
            x._of.copy() if isinstance(x, Vector) else np.array([x, y, z], dtype=float)
        )

    @staticmethod
    def Zero() -> Vector:  # noqa: N802
        """Three zeros."""
        return Vector()

    @classmethod
    def _with(cls, of: Numbers) -> Vector:
        vector = cls()
        vector._of = of
        return vector

    def x(self, value: float | None = None) -> float | None:
        """The first number, or sets it."""
        return self._part(0, value)

    def y(self, value: float | None = None) -> float | None:
        """The second number, or sets it."""
        return self._part(1, value)

    def z(self, value: float | None = None) -> float | None:
        """The third number, or sets it."""
        return self._part(2, value)

    def _part(self, index: int, value: float | None) -> float | None:
        if value is None:
            return float(self._of[index])
        self._of[index] = value
        return None

    def Norm(self) -> float:  # noqa: N802
        """Its length."""
        return math.sqrt(float(self._of @ self._of))

    def Normalize(self, eps: float = EPSILON) -> float:  # noqa: N802
        """Makes its length 1, and returns what it was; what is too short becomes (1, 0, 0)."""
        length = self.Norm()
        if length < eps:
            self._of[:] = (1.0, 0.0, 0.0)
        else:
            self._of /= length
        return length

    def __getitem__(self, index: int) -> float:
        return float(self._of[index])

    def __setitem__(self, index: int, value: float) -> None:
        self._of[index] = value

    def __len__(self) -> int:
        return 3

    def __iter__(self) -> Iterator[float]:
        return iter(self._of.tolist())

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Numbers:
        return np.array(self._of, dtype=dtype)

    def __add__(self, other: Vector) -> Vector:
        return Vector._with(self._of + other._of)

    def __sub__(self, other: Vector) -> Vector:
        return Vector._with(self._of - other._of)

    def __neg__(self) -> Vector:
        return Vector._with(-self._of)

    @overload
    def __mul__(self, other: Vector) -> Vector: ...
    @overload
    def __mul__(self, other: float) -> Vector: ...
    def __mul__(self, other: Vector | float) -> Vector:
        """The cross product with a vector, or a multiple."""
        if isinstance(other, Vector):
            return Vector._with(np.cross(self._of, other._of))
        return Vector._with(self._of * other)

    def __rmul__(self, other: float) -> Vector:
        return Vector._with(self._of * other)

    def __truediv__(self, other: float) -> Vector:
        return Vector._with(self._of / other)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Vector) and Equal(self, other)

    def __repr__(self) -> str:
        return "[{:12.6g},{:12.6g},{:12.6g}]".format(*self._of)


class Rotation:
    """A rotation matrix."""

    __hash__ = None  # type: ignore[assignment]

    def __init__(self, *of: Any) -> None:
        """From nothing (the identity), nine numbers by rows, three columns, or a rotation."""
        if len(of) == 1 and isinstance(of[0], Rotation):
            self._of: Numbers = of[0]._of.copy()
        elif len(of) == 3:
            self._of = np.column_stack([column._of for column in of])
        elif len(of) == 9:
            self._of = np.array(of, dtype=float).reshape(3, 3)
        elif not of:
            self._of = np.eye(3)
        else:
            raise TypeError(f"Rotation: {len(of)} arguments, expected 0, 1, 3 or 9")

    @classmethod
    def _with(cls, of: Numbers) -> Rotation:
        rotation = cls()
        rotation._of = of
        return rotation

    @staticmethod
    def Identity() -> Rotation:  # noqa: N802
        """No rotation."""
        return Rotation()

    @staticmethod
    def RotX(angle: float) -> Rotation:  # noqa: N802
        """About x."""
        c, s = math.cos(angle), math.sin(angle)
        return Rotation(1, 0, 0, 0, c, -s, 0, s, c)

    @staticmethod
    def RotY(angle: float) -> Rotation:  # noqa: N802
        """About y."""
        c, s = math.cos(angle), math.sin(angle)
        return Rotation(c, 0, s, 0, 1, 0, -s, 0, c)

    @staticmethod
    def RotZ(angle: float) -> Rotation:  # noqa: N802
        """About z."""
        c, s = math.cos(angle), math.sin(angle)
        return Rotation(c, -s, 0, s, c, 0, 0, 0, 1)

    @staticmethod
    def Rot(axis: Vector, angle: float) -> Rotation:  # noqa: N802
        """About an axis of any length."""
        axis = Vector(axis)
        axis.Normalize()
        return Rotation.Rot2(axis, angle)

    @staticmethod
    def Rot2(axis: Vector, angle: float) -> Rotation:  # noqa: N802
        """About an axis of length 1."""
        x, y, z = axis._of.tolist()
        c, s = math.cos(angle), math.sin(angle)
        v = 1.0 - c
        return Rotation(
            *(c + v * x * x, v * x * y - s * z, v * x * z + s * y),
            *(v * x * y + s * z, c + v * y * y, v * y * z - s * x),
            *(v * x * z - s * y, v * y * z + s * x, c + v * z * z),
        )

    @staticmethod
    def RPY(roll: float, pitch: float, yaw: float) -> Rotation:  # noqa: N802
        """About x, then y, then z of the fixed axes."""
        turns = (Rotation.RotZ(yaw), Rotation.RotY(pitch), Rotation.RotX(roll))
        return _product(*turns)

    @staticmethod
    def EulerZYX(alpha: float, beta: float, gamma: float) -> Rotation:  # noqa: N802
        """About z, then y, then x of the moving axes."""
        return Rotation.RPY(gamma, beta, alpha)

    @staticmethod
    def EulerZYZ(alpha: float, beta: float, gamma: float) -> Rotation:  # noqa: N802
        """About z, then y, then z of the moving axes."""
        turns = (Rotation.RotZ(alpha), Rotation.RotY(beta), Rotation.RotZ(gamma))
        return _product(*turns)

    @staticmethod
    def Quaternion(x: float, y: float, z: float, w: float) -> Rotation:  # noqa: N802
        """From a unit quaternion."""
        return Rotation(
            *(w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)),
            *(2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)),
            *(2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z),
        )

    def GetQuaternion(self) -> tuple[float, float, float, float]:  # noqa: N802
        """The quaternion x, y, z, w."""
        (a, b, c), (d, e, f), (g, h, i) = self._of.tolist()
        trace = a + e + i
        if trace > EPSILON:
            s = 0.5 / math.sqrt(trace + 1.0)
            return ((h - f) * s, (c - g) * s, (d - b) * s, 0.25 / s)
        if a > e and a > i:
            s = 2.0 * math.sqrt(1.0 + a - e - i)
            return (0.25 * s, (b + d) / s, (c + g) / s, (h - f) / s)
        if e > i:
            s = 2.0 * math.sqrt(1.0 + e - a - i)
            return ((b + d) / s, 0.25 * s, (f + h) / s, (c - g) / s)
        s = 2.0 * math.sqrt(1.0 + i - a - e)
        return ((c + g) / s, (f + h) / s, 0.25 * s, (d - b) / s)

    def GetRPY(self) -> tuple[float, float, float]:  # noqa: N802
        """Roll, pitch and yaw of :meth:`RPY`."""
        m = self._of
        pitch = math.atan2(-m[2, 0], math.hypot(m[0, 0], m[1, 0]))
        if abs(pitch) > math.pi / 2 - 1e-12:
            return (0.0, pitch, math.atan2(-m[0, 1], m[1, 1]))
        return (math.atan2(m[2, 1], m[2, 2]), pitch, math.atan2(m[1, 0], m[0, 0]))

    def GetEulerZYX(self) -> tuple[float, float, float]:  # noqa: N802
        """Alpha, beta and gamma of :meth:`EulerZYX`."""
        roll, pitch, yaw = self.GetRPY()
        return (yaw, pitch, roll)

    def GetRotAngle(self, eps: float = EPSILON) -> tuple[float, Vector]:  # noqa: N802
        """The angle, from 0 to pi, and the axis; no rotation is about z."""
        x, y, z, w = self.GetQuaternion()
        axis = Vector(x, y, z)
        sine = axis.Norm()
        if sine < eps / 2:
            return (0.0, Vector(0.0, 0.0, 1.0))
        sign = 1.0 if w >= 0.0 else -1.0
        return (2.0 * math.atan2(sine, abs(w)), axis * (sign / sine))

    def GetRot(self) -> Vector:  # noqa: N802
        """The axis, as long as the angle."""
        angle, axis = self.GetRotAngle()
        return axis * angle

    def DoRotX(self, angle: float) -> None:  # noqa: N802
        """Turns it about its own x."""
        self._of = self._of @ Rotation.RotX(angle)._of

    def DoRotY(self, angle: float) -> None:  # noqa: N802
        """Turns it about its own y."""
        self._of = self._of @ Rotation.RotY(angle)._of

    def DoRotZ(self, angle: float) -> None:  # noqa: N802
        """Turns it about its own z."""
        self._of = self._of @ Rotation.RotZ(angle)._of

    def Inverse(self, of: Any = None) -> Any:  # noqa: N802
        """The inverse, or what it makes of a vector, twist or wrench."""
        inverse = Rotation._with(self._of.T.copy())
        return inverse if of is None else inverse * of

    def SetInverse(self) -> None:  # noqa: N802
        """Inverts it."""
        self._of = self._of.T.copy()

    def UnitX(self, column: Vector | None = None) -> Vector | None:  # noqa: N802
        """Its first column, or sets it."""
        return self._unit(0, column)

    def UnitY(self, column: Vector | None = None) -> Vector | None:  # noqa: N802
        """Its second column, or sets it."""
        return self._unit(1, column)

    def UnitZ(self, column: Vector | None = None) -> Vector | None:  # noqa: N802
        """Its third column, or sets it."""
        return self._unit(2, column)

    def _unit(self, index: int, column: Vector | None) -> Vector | None:
        if column is None:
            return Vector._with(self._of[:, index].copy())
        self._of[:, index] = column._of
        return None

    def __getitem__(self, place: tuple[int, int]) -> float:
        return float(self._of[place])

    def __setitem__(self, place: tuple[int, int], value: float) -> None:
        self._of[place] = value

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Numbers:
        return np.array(self._of, dtype=dtype)

    def __mul__(self, other: Any) -> Any:
        if isinstance(other, Rotation):
            return Rotation._with(self._of @ other._of)
        if isinstance(other, Vector):
            return Vector._with(self._of @ other._of)
        if isinstance(other, _Pair):
            return type(other)(*(self * part for part in other._parts))
        return NotImplemented

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Rotation) and Equal(self, other)

    def __repr__(self) -> str:
        rows = (",".join(f"{number:12.6g}" for number in row) for row in self._of)
        return "[" + ";\n ".join(rows) + "]"


def _product(a: Rotation, b: Rotation, c: Rotation) -> Rotation:
    return Rotation._with(a._of @ b._of @ c._of)


class _Pair:
    """Two vectors that belong together."""

    __hash__ = None  # type: ignore[assignment]

    def __init__(self, first: Vector | None = None, second: Vector | None = None) -> None:
        self._parts = (Vector(first or Vector()), Vector(second or Vector()))

    def __getitem__(self, index: int) -> float:
        return self._parts[index // 3][index % 3]

    def __setitem__(self, index: int, value: float) -> None:
        self._parts[index // 3][index % 3] = value

    def __len__(self) -> int:
        return 6

    def __iter__(self) -> Iterator[float]:
        return (number for part in self._parts for number in part)

    def __add__(self, other: Any) -> Any:
        return type(self)(*(a + b for a, b in zip(self._parts, other._parts, strict=True)))

    def __sub__(self, other: Any) -> Any:
        return type(self)(*(a - b for a, b in zip(self._parts, other._parts, strict=True)))

    def __neg__(self) -> Any:
        return type(self)(*(-part for part in self._parts))

    def __mul__(self, factor: float) -> Any:
        return type(self)(*(part * factor for part in self._parts))

    __rmul__ = __mul__

    def __truediv__(self, factor: float) -> Any:
        return type(self)(*(part / factor for part in self._parts))

    def __eq__(self, other: object) -> bool:
        return type(self) is type(other) and Equal(self, other)

    def __repr__(self) -> str:
        return "[" + ", ".join(f"{number:.6g}" for number in self) + "]"


class Twist(_Pair):
    """A velocity and an angular velocity."""

    @staticmethod
    def Zero() -> Twist:  # noqa: N802
        """None."""
        return Twist()

    @property
    def vel(self) -> Vector:
        """The velocity."""
        return self._parts[0]

    @vel.setter
    def vel(self, value: Vector) -> None:
        self._parts[0]._of[:] = value._of

    @property
    def rot(self) -> Vector:
        """The angular velocity."""
        return self._parts[1]

    @rot.setter
    def rot(self, value: Vector) -> None:
        self._parts[1]._of[:] = value._of


class Wrench(_Pair):
    """A force and a torque."""

    @staticmethod
    def Zero() -> Wrench:  # noqa: N802
        """None."""
        return Wrench()

    @property
    def force(self) -> Vector:
        """The force."""
        return self._parts[0]

    @force.setter
    def force(self, value: Vector) -> None:
        self._parts[0]._of[:] = value._of

    @property
    def torque(self) -> Vector:
        """The torque."""
        return self._parts[1]

    @torque.setter
    def torque(self, value: Vector) -> None:
        self._parts[1]._of[:] = value._of


class Frame:
    """A rotation ``M`` and a position ``p``."""

    __hash__ = None  # type: ignore[assignment]

    def __init__(self, *of: Any) -> None:
        """From nothing (the identity), a rotation, a vector, both, or a frame."""
        rotation, position = Rotation(), Vector()
        for part in of:
            if isinstance(part, Frame):
                rotation, position = part._m, part._p
            elif isinstance(part, Rotation):
                rotation = part
            elif isinstance(part, Vector):
                position = part
            else:
                raise TypeError(f"Frame: {type(part).__name__} is no rotation, vector or frame")
        self._m: Rotation = Rotation(rotation)
        self._p: Vector = Vector(position)

    @staticmethod
    def Identity() -> Frame:  # noqa: N802
        """The identity."""
        return Frame()

    @property
    def M(self) -> Rotation:  # noqa: N802
        """The rotation, as a part of the frame; assigning copies."""
        return self._m

    @M.setter
    def M(self, value: Rotation) -> None:  # noqa: N802
        self._m._of = value._of.copy()

    @property
    def p(self) -> Vector:
        """The position, as a part of the frame; assigning copies."""
        return self._p

    @p.setter
    def p(self, value: Vector) -> None:
        self._p._of = value._of.copy()

    def Inverse(self, of: Any = None) -> Any:  # noqa: N802
        """The inverse, or what it makes of a vector, twist or wrench."""
        turned = self._m.Inverse()
        inverse = Frame(turned, -(turned * self._p))
        return inverse if of is None else inverse * of

    def __getitem__(self, place: tuple[int, int]) -> float:
        row, column = place
        if row == 3:
            return float(column == 3)
        return self._p[row] if column == 3 else self._m[row, column]

    def __mul__(self, other: Any) -> Any:
        if isinstance(other, Frame):
            return Frame(self._m * other._m, self._m * other._p + self._p)
        if isinstance(other, Vector):
            return self._m * other + self._p
        if isinstance(other, Twist):
            turned = self._m * other
            return Twist(turned.vel + self._p * turned.rot, turned.rot)
        if isinstance(other, Wrench):
            turned = self._m * other
            return Wrench(turned.force, turned.torque + self._p * turned.force)
        return NotImplemented

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Frame) and Equal(self, other)

    def __repr__(self) -> str:
        return f"[{self._m!r}\n{self._p!r}]"


def dot(a: Any, b: Any) -> float:
    """The scalar product of two vectors, or of a twist and a wrench."""
    return float(sum(x * y for x, y in zip(a, b, strict=True)))


def diff(a: Any, b: Any, dt: float = 1.0) -> Any:
    """What leads from a to b within a time: a vector, or the twist between frames."""
    if isinstance(a, Frame):
        return Twist(diff(a.p, b.p, dt), diff(a.M, b.M, dt))
    if isinstance(a, Rotation):
        return (a * (a.Inverse() * b).GetRot()) / dt
    return (b - a) / dt


def addDelta(a: Any, delta: Any, dt: float = 1.0) -> Any:  # noqa: N802
    """Where :func:`diff` leads."""
    if isinstance(a, Frame):
        return Frame(addDelta(a.M, delta.rot, dt), addDelta(a.p, delta.vel, dt))
    if isinstance(a, Rotation):
        turn = a.Inverse() * delta * dt
        return a * Rotation.Rot(turn, turn.Norm()) if turn.Norm() > 0.0 else Rotation(a)
    return a + delta * dt


def Equal(a: Any, b: Any, eps: float = EPSILON) -> bool:  # noqa: N802
    """Whether no number of two things of one kind differs by more than ``eps``."""
    if isinstance(a, Frame):
        return Equal(a.M, b.M, eps) and Equal(a.p, b.p, eps)
    if isinstance(a, Rotation):
        return bool(np.all(np.abs(a._of - b._of) < eps))
    return all(abs(x - y) < eps for x, y in zip(a, b, strict=True))
