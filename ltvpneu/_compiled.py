"""The one door to numba's compiler, typed, so that a compiled law keeps its signature for readers and checkers."""

import inspect
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

import numba
from numba.core import types
from numba.extending import overload

from ltvpneu._kernel_cache import CHOICES, OPTIONS, KernelCache
from ltvpneu._telling import telling

P = ParamSpec("P")
R = TypeVar("R")

kernels: list[Any] = []
"""numba's dispatchers of all kernels, in the order of their definition."""


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a scalar law or a kernel for the machine and keep it on disk.

    The interpreter lock is released inside, so that sweeps may run in threads.
    """
    return _kernel(function, forceinline=False)


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a small law of an inner loop into its callers: the call would take longer than the law."""
    return _kernel(function, forceinline=True)


def _kernel(function: Callable[P, R], **options: Any) -> Callable[P, R]:
    # error_model="numpy": a division by zero gives inf, as on paper, where an infinite slope is an answer. No wrapper
    # for C: nobody calls a kernel from there, and each takes a tenth of the compiling.
    common: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
    kernel: Any = numba.njit(**common, **options)(function)
    kernel._cache, OPTIONS[kernel.py_func] = KernelCache(kernel.py_func), options
    resolve, make = kernel.get_call_template, kernel.compile

    def resolve_plainly(args: tuple[types.Type, ...], kws: dict[str, types.Type]) -> Any:
        """Take a literal argument, which numba would compile a kernel of its own for, as a number like any other."""
        return resolve(tuple(map(types.unliteral, args)), {name: types.unliteral(kind) for name, kind in kws.items()})

    def make_told(sig: Any) -> Any:
        with telling(kernel, str(sig)):
            return make(sig)

    kernel.get_call_template, kernel.compile = resolve_plainly, make_told
    kernels.append(kernel)
    return kernel


def by_field(field: str, argument: str, having: Callable[..., R], lacking: Callable[P, R]) -> Callable[P, R]:
    """Return a function for kernels that is `having` where an argument's record has a field, and else `lacking`.

    "settings.rtol" is a field of a record within the record. Both are plain functions. They are compiled into the
    kernels that call them, each only where its type of record comes up. Kernels alone can call what is returned.
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

    CHOICES[chosen] = field, place, having, lacking
    return chosen
