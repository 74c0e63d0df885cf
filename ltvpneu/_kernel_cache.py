"""Compiled kernels on disk: found again as long as nothing that they were compiled from has changed.

numba's own cache asks whether a kernel's file is what it was. A kernel holds the code of all that it calls, though, in
other files too. Here a kernel's key is a hash of everything that it can reach: the bytecode of its functions and of
those that they call, and the constants that they read. An edit of one law is therefore seen by what calls it, and by
nothing else; comments, line numbers and the times of files have no part in it.

There are two stores. The user's lies where numba keeps its own: in `NUMBA_CACHE_DIR`, beside the sources, or among the
user's cached files. The other comes with a wheel, is only read, and holds kernels for any processor of its kind.
"""

import hashlib
import pickle
import platform
import sys
import threading
import time
import types as python
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache, cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba.core import caching, types
from numba.core.compiler import CompileResult
from numba.core.dispatcher import Dispatcher
from numba.core.serialize import dumps

SHIPPED = Path(__file__).parent / "_kernels"
"""Kernels that came with the package, if any."""
ANY_CPU = ("generic", "")
"""Name and features of the processor that shipped kernels are compiled for."""


@dataclass
class Counts:
    """What became of the kernels that were asked for since the process began."""

    compiled: int = 0
    loaded: int = 0
    """From the user's store."""
    shipped: int = 0
    """From the package's."""
    names: set[str] = field(default_factory=set[str])
    """Files that kernels were loaded from."""


counts = Counts()
OPTIONS: dict[Any, dict[str, bool]] = {}
"""How the functions of kernels are compiled."""
CHOICES: dict[Any, tuple[Any, ...]] = {}
"""Functions that are chosen by the type of a record, and what each is chosen from, and by what."""


def reachable(function: python.FunctionType, signature: str | None = None) -> list[python.FunctionType]:
    """Return a kernel's function and all functions that it can call, but for those of libraries.

    Of functions that are chosen by the type of a record, all are taken, or those alone that a signature asks for.
    """
    found: dict[python.FunctionType, None] = {}
    waiting = [function]
    while waiting:
        present = waiting.pop()
        if present not in found:
            found[present] = None
            values = _values_read(present)
            if signature is not None and present in CHOICES:
                field, _, having, lacking = CHOICES[present]
                values = [having if f"{field.rpartition('.')[2]}[type=" in signature else lacking]
            waiting += [value for value in map(_function_of, values) if value is not None]
    return list(found)


def kernels_reached(function: python.FunctionType, signature: str) -> list[Any]:
    """Return the dispatchers of all kernels that one with a signature calls."""
    values = [value for each in reachable(function, signature) for value in _values_read(each)]
    return list({id(value): value for value in values if isinstance(value, Dispatcher)}.values())


def _function_of(value: Any) -> python.FunctionType | None:
    """Return the Python function behind something that a function reads, None where there is none of ours."""
    if isinstance(value, Dispatcher):
        value = value.py_func
    return value if isinstance(value, python.FunctionType) and _is_ours(value.__module__) else None


def _is_ours(module: str) -> bool:
    """Whether a module is anything but a library's: what those change comes with a version of theirs."""
    found = sys.modules.get(module)
    path = getattr(found, "__file__", None) or ""
    installed = "site-packages" in path and module.partition(".")[0] != __name__.partition(".")[0]
    return bool(path) and not installed and module.partition(".")[0] not in sys.stdlib_module_names


def _codes(code: python.CodeType) -> Iterator[python.CodeType]:
    yield code
    for constant in code.co_consts:
        if isinstance(constant, python.CodeType):
            yield from _codes(constant)


def _values_read(function: python.FunctionType) -> list[Any]:
    """Return what a function reads from outside: globals, attributes of modules, cells, defaults, its choices."""
    names = [name for code in _codes(function.__code__) for name in code.co_names]
    found = [function.__globals__[name] for name in names if name in function.__globals__]
    for module in [value for value in found if isinstance(value, python.ModuleType)]:
        if _is_ours(module.__name__):
            found += [vars(module)[name] for name in names if name in vars(module)]
    found += [cell.cell_contents for cell in function.__closure__ or ()]
    found += [*(function.__defaults__ or ()), *CHOICES.get(function, ())]
    return found


@cache
def own_hash(function: python.FunctionType) -> str:
    """Return a hash of a function's own bytecode and of the constants that it reads."""
    parts: list[str] = [function.__qualname__, repr(OPTIONS.get(function))]
    for code in _codes(function.__code__):
        constants = [repr(c) for c in code.co_consts if not isinstance(c, python.CodeType) and c != function.__doc__]
        parts += [code.co_code.hex(), *constants, *code.co_names, *code.co_varnames]
    parts += [_constant(value) for value in _values_read(function)]
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()


def _constant(value: Any) -> str:
    """Return what tells a constant from others; of functions and types, their names."""
    if isinstance(value, np.ndarray):
        array: Any = value
        return f"{array.dtype} {array.shape} {array.tobytes().hex()}"
    if isinstance(value, Dispatcher | python.FunctionType | type):
        return f"{getattr(value, '__qualname__', value)} {getattr(value, '_fields', '')}"
    if isinstance(value, python.ModuleType | python.BuiltinFunctionType):
        return value.__name__
    if isinstance(value, tuple):
        items: Any = value
        return " ".join(map(_constant, items))
    if value is None or isinstance(
        value, bool | int | float | complex | str | bytes | np.dtype | np.generic | np.ufunc
    ):
        return repr(value)
    raise TypeError(f"found a {type(value).__name__} that a kernel reads, expected functions, numbers, text or arrays")


def stamp(function: python.FunctionType) -> str:
    """Return one hash of everything that a kernel can reach, and of what compiles it."""
    parts = sorted(map(own_hash, reachable(function)))
    return hashlib.sha256("\n".join([*parts, *COMPILER]).encode()).hexdigest()


COMPILER = (
    numba.__version__,
    version("llvmlite"),
    np.__version__,
    platform.python_implementation(),
    f"{sys.version_info[0]}.{sys.version_info[1]}{getattr(sys, 'abiflags', '')}",
)
"""What else a kernel's machine code depends on."""


class KernelCache(caching._Cache):  # pyright: ignore[reportPrivateUsage] - the interface that numba asks
    """The stores of one kernel, as numba's dispatcher asks them."""

    def __init__(self, function: python.FunctionType) -> None:
        self._function, self._enabled = function, True

    @cached_property
    def _numbas(self) -> Any:
        """Means of numba to find a place and to take kernels apart, None where no place can be written to."""
        try:
            return caching.CompileResultCacheImpl(self._function)
        except RuntimeError:
            _warn_of_no_place()
            return None

    @cached_property
    def _stamp(self) -> str:
        return stamp(self._function)

    @property
    def cache_path(self) -> Any:
        """The user's store, None where there is none."""
        return None if self._numbas is None else str(self._numbas.locator.get_cache_path())

    @property
    def is_kept(self) -> bool:
        """Whether a store has the kernel, for any signature."""
        folders = [SHIPPED, *([] if self.cache_path is None else [Path(self.cache_path)])]
        return any(any(folder.glob(f"{self._base}.*.{self._stamp[:16]}.nbc")) for folder in folders)

    def enable(self) -> None:
        """Use the stores."""
        self._enabled = True

    def disable(self) -> None:
        """Do not use the stores."""
        self._enabled = False

    def flush(self) -> None:
        """Remove the kernel from the user's store."""
        if self.cache_path is not None:
            for path in Path(self.cache_path).glob(f"{self._base}.*.nbc"):
                path.unlink(missing_ok=True)

    @property
    def _base(self) -> str:
        return f"{self._function.__module__}.{self._function.__qualname__}".replace("<", "").replace(">", "")

    def _name(self, signature: Any, processor: tuple[str, ...]) -> tuple[str, str]:
        """Return the file's name up to what it was compiled from, and the whole."""
        asked = hashlib.sha256(repr((_types(signature), processor, COMPILER[-1])).encode()).hexdigest()[:16]
        return f"{self._base}.{asked}.", f"{self._base}.{asked}.{self._stamp[:16]}.nbc"

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the kernel for a signature, None where no store has it."""
        target_context.refresh()
        if not self._enabled:
            return None
        processor: tuple[str, ...] = target_context.codegen().magic_tuple()
        for folder, names in ((self.cache_path, processor), (SHIPPED, (processor[0], *ANY_CPU))):
            path = None if folder is None else Path(folder) / self._name(sig, names)[1]
            data = None if path is None else _read(path)
            if data is not None:
                counts.names.add(str(path))
                if folder is SHIPPED:
                    counts.shipped += 1
                else:
                    counts.loaded += 1
                return CompileResult._rebuild(target_context, *data)  # pyright: ignore[reportPrivateUsage]
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a kernel that was compiled, in place of what an earlier state of its sources made of it."""
        counts.compiled += 1
        if not self._enabled or self.cache_path is None or not self._numbas.check_cachable(data):
            return
        self._numbas.locator.ensure_cache_path()
        folder, (begin, name) = Path(self.cache_path), self._name(sig, data.codegen.magic_tuple())
        # Under a name of its own first: another process may be reading, or writing the same.
        part = folder / f"{name}.{time.time_ns()}.{threading.get_ident()}.part"
        try:
            part.write_bytes(dumps(self._numbas.reduce(data)))
            part.replace(folder / name)
            for path in folder.glob(f"{begin}*.nbc"):
                if path.name != name:
                    path.unlink(missing_ok=True)
        except OSError:
            part.unlink(missing_ok=True)
            _warn_of_no_place()


def _types(signature: Any) -> str:
    """Return what tells the types of arguments from others.

    To numba's name of a named tuple belong the fields in their order: by that a kernel reads them.
    """
    parts = [str(signature)]
    for kind in signature:
        if isinstance(kind, types.BaseTuple):
            parts += [repr(getattr(kind, "fields", ())), _types(kind)]
    return " ".join(parts)


def _read(path: Path) -> Any:
    """Return what a file of a store holds; None where it is missing or damaged, whatever way."""
    try:
        return pickle.loads(path.read_bytes())
    except Exception:
        return None


@cache
def _warn_of_no_place() -> None:
    """Warn, once in a process, that no kernel can be kept."""
    warnings.warn(
        "compiled kernels cannot be kept: found no folder for them that can be written to. Every process compiles "
        "them anew, which takes up to minutes; set NUMBA_CACHE_DIR to a folder of yours",
        RuntimeWarning,
        stacklevel=2,
    )
