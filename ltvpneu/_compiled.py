"""The one door to numba's compiler, typed, so that a compiled law keeps its signature for readers and checkers."""

from collections.abc import Callable
from typing import ParamSpec, TypeVar

import numba

P = ParamSpec("P")
R = TypeVar("R")


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a scalar law or a kernel for the machine and cache it on disk.

    The interpreter lock is released inside, so that sweeps may run in threads.
    """
    # error_model="numpy": a division by zero gives inf, as on paper, where an infinite slope is an answer.
    return numba.njit(cache=True, nogil=True, error_model="numpy")(function)
