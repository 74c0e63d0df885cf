"""The one door to numba's compiler, typed, so that a compiled law keeps its signature for readers and checkers."""

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import numba
from numba.core import types
from numba.extending import overload

P = ParamSpec("P")
R = TypeVar("R")


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a scalar law or a kernel for the machine and cache it on disk.

    The interpreter lock is released inside, so that sweeps may run in threads.
    """
    # error_model="numpy": a division by zero gives inf, as on paper, where an infinite slope is an answer.
    kernel: Any = numba.njit(cache=True, nogil=True, error_model="numpy")(function)
    resolve = kernel.get_call_template

    def resolve_plainly(args: tuple[types.Type, ...], kws: dict[str, types.Type]) -> Any:
        """Take a literal argument, which numba would compile a kernel of its own for, as a number like any other."""
        return resolve(tuple(map(types.unliteral, args)), {name: types.unliteral(kind) for name, kind in kws.items()})

    kernel.get_call_template = resolve_plainly
    return kernel


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a kernel into each of its callers.

    A call that passes tuples of arrays counts references to each array up and down, which in the integrator's inner
    loop costs several times the arithmetic.
    """
    return numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")(function)


def by_field(field: str, argument: str, having: Callable[..., R], lacking: Callable[P, R]) -> Callable[P, R]:
    """Return a function for kernels that is `having` where an argument's record has a field, and else `lacking`.

    "settings.rtol" is a field of a record within the record.

    Both are plain functions. They are compiled into the kernels that call them, each only where its type of record
    comes up. Kernels alone can call the function that is returned.
    """
    place = list(inspect.signature(having).parameters).index(argument)

    def chosen(*args: P.args, **kwargs: P.kwargs) -> R:
        raise TypeError(f"{having.__name__} or {lacking.__name__}: only kernels choose by the type of a record")

    @overload(chosen, strict=False, jit_options={"error_model": "numpy", "nogil": True})
    def _choose(*args: types.Type) -> Callable[..., R]:  # pyright: ignore[reportUnusedFunction] - numba calls it
        record = args[place]
        for name in field.split("."):
            if not (isinstance(record, types.Record) and name in record.fields):
                return lacking
            record = record.typeof(name)
        return having

    return chosen


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
