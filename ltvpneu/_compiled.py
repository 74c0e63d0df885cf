"""The one door to numba's compiler, typed, so that a compiled law keeps its signature for readers and checkers."""

from collections.abc import Callable
from pathlib import Path
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


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a kernel into each of its callers.

    A call that passes tuples of arrays counts references to each array up and down, which in the integrator's inner
    loop costs several times the arithmetic.
    """
    return numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")(function)


def drop_stale_kernels(package: Path) -> int:
    """Delete cached kernels older than any source file of the package, and return how many.

    numba renews a cached function when its own file changes, not when a law that it calls, in another file, does: after
    an edit or an update the integrator would go on with the old law.
    """
    newest = max(source.stat().st_mtime for source in package.rglob("*.py"))
    stale = [kernel for kernel in package.rglob("*.nb[ic]") if kernel.stat().st_mtime < newest]
    for kernel in stale:
        # Another process may have been faster, or the package may be read-only: numba then uses another folder.
        try:
            kernel.unlink(missing_ok=True)
        except OSError:
            continue
    return len(stale)


drop_stale_kernels(Path(__file__).parent)
