"""The one place that checks numbers and arrays: shapes, finiteness, signs, and that nobody writes into a value."""

import inspect
import math
from collections.abc import Sequence
from functools import cache
from typing import Annotated, Any, TypeVar, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
S = TypeVar("S", bound=np.generic)


def finite_array(
    name: str, values: ArrayLike | Sequence[ArrayLike], shape: Sequence[int | None] | None = None
) -> FloatArray:
    """Return a read-only float64 copy, after checking its shape and that every entry is finite.

    Parameters
    ----------
    name : str
        What the caller calls it; stands first in the error.
    values : array_like
    shape : sequence of (int or None), optional
        Expected shape; None matches any length.

    Raises
    ------
    ValueError
        Ragged, of another shape, or with an entry that is not finite.
    """
    try:
        # Without a wanted type first, so that complex numbers are seen and not cut to their real parts.
        found = np.array(values)
        array = np.asarray(np.real(found), dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name}: expected numbers in a regular array, found {values!r} ({error})") from None
    if found.dtype.kind == "c":
        raise ValueError(f"{name}: found complex numbers, expected real ones")
    if shape is not None and array.shape != tuple(shape):
        wrong = array.ndim != len(shape) or any(
            want is not None and have != want for have, want in zip(array.shape, shape, strict=False)
        )
        if wrong:
            wanted = "(" + ", ".join("any" if size is None else str(size) for size in shape) + ")"
            raise ValueError(f"{name}: found shape {array.shape}, expected {wanted}")
    # One sum is a quick test of many entries; only where it fails is the entry looked for.
    if not math.isfinite(np.add.reduce(array, axis=None)) and not (finite := np.isfinite(array)).all():
        where = tuple(int(i) for i in np.argwhere(~finite)[0])
        raise ValueError(f"{name}: found {array[where]} at index {where}, expected finite numbers")
    array.setflags(write=False)
    return array


def read_only(array: NDArray[S]) -> NDArray[S]:
    """Return the same array, closed to writing."""
    array.setflags(write=False)
    return array


def solved(matrices: FloatArray, right: FloatArray) -> FloatArray:
    """Return numpy's solution of stacked linear equations; its stubs forget that doubles in give doubles out."""
    return np.asarray(np.linalg.solve(matrices, right), dtype=np.float64)


def finite(name: str, value: float, unit: str = "") -> float:
    """Return the value as a float if it is a finite number."""
    number = _number(name, value)
    if not math.isfinite(number):
        raise ValueError(f"{name}: found {number:g}{_of(unit)}, expected a finite number")
    return number


def positive(name: str, value: float, unit: str = "") -> float:
    """Return the value as a float if it is finite and above zero."""
    number = _number(name, value)
    if not (math.isfinite(number) and number > 0):
        raise ValueError(f"{name}: found {number:g}{_of(unit)}, expected a finite number above zero")
    return number


def not_negative(name: str, value: float, unit: str = "") -> float:
    """Return the value as a float if it is finite and not below zero."""
    number = _number(name, value)
    if not (math.isfinite(number) and number >= 0):
        raise ValueError(f"{name}: found {number:g}{_of(unit)}, expected a finite number, zero or more")
    return number


def whole(name: str, value: object, least: int = 1) -> int:
    """Return the value if it is a whole number, at least `least`."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        raise ValueError(f"{name}: found {value!r}, expected a whole number, {least} or more")
    return int(value)


def _number(name: str, value: float) -> float:
    if isinstance(value, bool | str) or not np.isscalar(value) or isinstance(value, complex):
        raise TypeError(f"{name}: found {value!r} of type {type(value).__name__}, expected a number")
    return float(value)


def _of(unit: str) -> str:
    return f" {unit}" if unit else ""


@cache
def layout(record: type, **given: np.dtype[Any]) -> np.dtype[Any]:
    """Return the memory layout of a record: of a class whose fields are annotated.

    Fields are numbers, `bool`, or records themselves; `Annotated[Sequence[Field], n]` is an array of n of them, and
    `Annotated[FloatArray, m, n]` one of m times n numbers. Fields may be given by name, with a layout of another kind.
    """
    fields: list[Any] = []
    hints = get_type_hints(record, include_extras=True)
    # A derived class's own fields first: numba takes a record that begins like another for that other.
    for name in dict.fromkeys(name for base in record.__mro__ for name in inspect.get_annotations(base)):
        hint = hints[name]
        if name in given:
            fields.append((name, given[name]))
        elif get_origin(hint) is Annotated:
            base, *shape = get_args(hint)
            element = float if base == FloatArray else get_args(base)[0]
            fields.append((name, _field(element), tuple(shape)))
        else:
            fields.append((name, _field(hint)))
    return np.dtype(fields, align=True)


def _field(kind: type) -> np.dtype[Any]:
    # A `bool` is stored as such; whole numbers have 64 bits on every platform.
    return np.dtype({float: np.float64, int: np.int64, bool: np.bool_}.get(kind) or layout(kind))
