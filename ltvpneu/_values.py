"""Values that travel: pickled to another process, copied and compared by what they hold.

numpy forgets in a pickle and in a copy that an array was closed to writing, and a value's cached properties are worth
nothing elsewhere. So a value travels as its fields alone, its closed arrays marked as such: what arrives is closed
again, and a machine that was copied reaches the compiled kernels as the one it was copied from.
"""

from collections.abc import Hashable, Mapping
from dataclasses import dataclass, fields
from typing import Any, cast, final

import numpy as np


class Value:
    """Base of the package's frozen dataclasses.

    Equal are values of one type whose fields are: arrays entry by entry, two that are not a number being the same.
    """

    def __getstate__(self) -> dict[str, Any]:
        """Return the fields, marked where they are closed to writing."""
        return {name: packed(value) for name, value in fields_of(self).items()}

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        """Take the fields back."""
        for name, value in state.items():
            object.__setattr__(self, name, unpacked(value))

    def __eq__(self, other: object) -> bool:
        """Whether another value is of the same type and holds the same."""
        if type(self) is not type(other):
            return NotImplemented
        return same(fields_of(self), fields_of(other))

    def __hash__(self) -> int:
        """Return a number that equal values share."""
        return hash((type(self), *(_fingerprint(value) for value in fields_of(self).values())))


def fields_of(value: object) -> dict[str, Any]:
    """Return the fields of a dataclass by name."""
    return {field.name: getattr(value, field.name) for field in fields(cast(Any, value))}


def same(one: Any, other: Any) -> bool:
    """Whether two objects hold the same; also errors and python-control's objects, which compare by identity."""
    if one is other:
        return True
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        return _same_arrays(one, other)
    if type(one) is not type(other):
        return False
    if isinstance(one, float):
        return one == other or (one != one and other != other)
    if isinstance(one, tuple | list):
        return len(one) == len(other) and all(same(a, b) for a, b in zip(one, other, strict=True))
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(value, other[key]) for key, value in one.items())
    if isinstance(one, Exception):
        return same(one.args, other.args) and same(vars(one), vars(other))
    if type(one).__eq__ is object.__eq__ and hasattr(one, "__dict__"):
        return same(vars(one), vars(other))
    return bool(one == other)


def _same_arrays(one: Any, other: Any) -> bool:
    if not (isinstance(one, np.ndarray) and isinstance(other, np.ndarray)):
        return False
    a, b = cast(Any, one), cast(Any, other)
    # Not a number is equal to itself here: a sweep's failed points are no difference.
    return a.dtype == b.dtype and np.array_equal(a, b, equal_nan=a.dtype.kind in "fc")


def _fingerprint(value: Any) -> Any:
    """Return something hashable that equal fields share."""
    if isinstance(value, np.ndarray):
        # Adding zero makes minus zero the zero that it is equal to.
        array = cast(Any, value)
        if array.dtype.names:
            # Between the fields of a record there may be room, which nothing is ever written to.
            return array.shape, tuple(_fingerprint(array[name]) for name in array.dtype.names)
        return array.shape, (array + 0 if array.dtype.kind in "fc" else array).tobytes()
    if isinstance(value, tuple | list):
        return tuple(_fingerprint(item) for item in cast(list[Any], value))
    if value != value or not isinstance(value, Hashable) or type(value).__hash__ is object.__hash__:
        return type(value).__name__
    return hash(value)


@final
@dataclass(frozen=True)
class _Closed:
    """An array that is closed to writing, on its way."""

    array: Any


def packed(value: Any) -> Any:
    """Return a value with the arrays in it that are closed to writing marked as such."""
    if isinstance(value, np.ndarray):
        return value if cast(Any, value).flags.writeable else _Closed(value)
    return _mapped(value, packed)


def unpacked(value: Any) -> Any:
    """Return what was packed, with its closed arrays closed again."""
    if isinstance(value, _Closed):
        value.array.setflags(write=False)
        return value.array
    return _mapped(value, unpacked)


def _mapped(value: Any, change: Any) -> Any:
    """Return a container with its items changed, named tuples as what they are."""
    if isinstance(value, tuple):
        items = [change(item) for item in cast(tuple[Any, ...], value)]
        return type(value)(*items) if hasattr(value, "_fields") else tuple(items)
    if isinstance(value, list):
        return [change(item) for item in cast(list[Any], value)]
    if type(value) is dict:
        return {key: change(item) for key, item in cast(dict[Any, Any], value).items()}
    return value
