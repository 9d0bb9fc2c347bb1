"""Arrays that users hand over, read by the one rule that ``help(trocar)`` states."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar import errors
from trocar.errors import InvalidOption, InvalidRequest, InvalidSnapshot, refuse

NUMBERS = "biuf"
"""Kinds of NumPy types that are numbers: truth values, integers, floating point of any width."""

LONGEST = 200
"""Characters that a refusal quotes of a value."""


def described(value: Any) -> str:
    """A value as refusals quote it: shape and type of an array, anything else as it is written."""
    shape, dtype = getattr(value, "shape", None), getattr(value, "dtype", None)
    if shape is not None and dtype is not None:
        kind = "array" if type(value) is np.ndarray else type(value).__name__
        return f"{kind} of shape {tuple(shape)} and type {dtype}"
    text = repr(value)
    if len(text) > LONGEST:
        text = f"{text[:LONGEST]}…"
    if isinstance(value, list | tuple):
        try:
            return f"{text}, {type(value).__name__} of shape {np.shape(value)}"
        except Exception:  # rows of different lengths, or values without a shape
            return f"{text}, {type(value).__name__}"
    return text if value is None else f"{text}, {type(value).__name__}"


def refused(error: type[InvalidRequest], field: str, value: Any, expected: str) -> InvalidRequest:
    """An error that names an argument, its shape and type, and what was expected."""
    return refuse(error, field, value, f"expected {expected}", described(value))


def numbers(
    value: Any,
    field: str,
    error: type[InvalidRequest],
    *,
    kinds: str = NUMBERS,
    expected: str = "an array of numbers",
) -> NDArray[Any]:
    """The array that NumPy makes of an array-like, where its type is of these kinds."""
    if isinstance(value, np.ma.MaskedArray) and np.ma.is_masked(value):
        raise refused(error, field, value, f"{expected} without masked values")
    try:
        array = np.asarray(value)
    except Exception as cause:  # of whichever type a library raises where its tensors are no arrays
        raise refused(error, field, value, f"{expected} ({cause})") from cause
    if array.dtype.kind not in kinds:
        raise refused(error, field, value, expected)
    return array


def floats(value: Any, field: str, error: str) -> NDArray[np.float32]:
    """Numbers rounded to the nearest float32: an aligned copy in row-major order.

    The bindings call this; ``error`` is the name of a class of :mod:`trocar.errors`.
    """
    array = numbers(value, field, getattr(errors, error))
    with np.errstate(over="ignore"):  # what is too large becomes infinite, which the server refuses
        return np.array(array, np.float32, order="C")


def octets(value: Any, field: str) -> bytes:
    """The bytes of an object that holds one row of one-byte elements."""
    if isinstance(value, bytes):
        return value
    expected = "bytes, or one row of one-byte elements (bytearray, memoryview, uint8 array)"
    array = numbers(value, field, InvalidSnapshot, kinds="iuS", expected=expected)
    if array.ndim != 1 or array.itemsize != 1:
        raise refused(InvalidSnapshot, field, value, expected)
    return array.tobytes()


def integers(value: Any, field: str, error: type[InvalidRequest], expected: str) -> NDArray[Any]:
    """One row of integers."""
    array = numbers(value, field, error, kinds="iu", expected=expected)
    if array.ndim != 1:
        raise refused(error, field, value, expected)
    return array


def truths(value: Any, field: str, error: type[InvalidRequest], count: int) -> NDArray[np.bool_]:
    """A truth value for each of ``count`` environments, of which one is true."""
    expected = f"a bool array of shape ({count},) that is somewhere true"
    array: NDArray[np.bool_] = numbers(value, field, error, kinds="b", expected=expected)
    if array.shape != (count,) or not array.any():
        raise refused(error, field, value, expected)
    return array


def truth(value: Any, field: str) -> bool:
    """A single truth value, Python's or NumPy's."""
    if not isinstance(value, bool | np.bool_):
        raise refuse(InvalidOption, field, value, "allowed are True and False", described(value))
    return bool(value)


def integer(value: Any, field: str, error: type[InvalidRequest], expected: str) -> int:
    """A single integer: Python's, NumPy's, or that of an array or tensor without axes."""
    try:
        return operator.index(value)
    except Exception as cause:
        raise refused(error, field, value, expected) from cause


def is_single(value: Any) -> bool:
    """Whether a value has no axes."""
    try:
        return np.ndim(value) == 0
    except Exception:  # rows of different lengths, and tensors that are no arrays
        return False


def selected(index: Any, length: int) -> list[int]:
    """The numbers below ``length`` that an index means, as NumPy has it.

    Raises:
        IndexError: There are no such numbers.
    """
    below = range(length)
    if isinstance(index, slice):
        return list(below[index])
    expected = f"integers from {-length} to {length - 1}, a slice, or {length} truth values"
    if isinstance(index, Sequence) and not index:
        return []
    array = numbers(index, "index", InvalidRequest, kinds="biu", expected=expected)
    is_mask = array.dtype.kind == "b"
    if array.shape != (length,) if is_mask else array.ndim > 1:
        raise refused(InvalidRequest, "index", index, expected)
    chosen = np.flatnonzero(array) if is_mask else np.atleast_1d(array)
    try:
        return [below[int(number)] for number in chosen]
    except IndexError:
        raise IndexError(f"index = {described(index)}: expected {expected}") from None


def plain(value: Any, field: str) -> Any:
    """An array, tensor or scalar of NumPy or another library as Python's own numbers or strings."""
    expected = "an array of numbers or strings"
    return numbers(value, field, InvalidOption, kinds=NUMBERS + "U", expected=expected).tolist()
