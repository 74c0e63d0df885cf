"""Says that something is being compiled, once that takes long enough for somebody to wonder."""

import sys
import threading
import time
from collections.abc import Generator
from contextlib import contextmanager
from typing import Any

from numba.core.dispatcher import Dispatcher

from ltvpneu._kernel_cache import counts, kernels_reached

SILENT, BETWEEN = 1.0, 5.0
"""Seconds that compiling may take unannounced, and between lines where they cannot be written over [s]."""


class _Told:
    """What has been said so far about the compiling that is under way."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.depth, self.begin, self.last, self.compiled = 0, 0.0, 0.0, 0
        self.outermost: Any = None
        self.is_silent = False

    def start(self, kernel: Any, signature: str) -> None:
        self.depth += 1
        if self.depth == 1:
            self.outermost, self.compiled = (kernel.py_func, signature), counts.compiled
            self.begin, self.last = time.monotonic(), 0.0

    def stop(self) -> None:
        self.depth -= 1
        now, done = time.monotonic(), counts.compiled - self.compiled
        elapsed, on_terminal = now - self.begin, sys.stderr.isatty()
        if elapsed < SILENT or done == 0 or self.is_silent:
            return
        if self.depth == 0:
            if self.last:
                self._write(f"compiled the machine's equations: {done} parts in {elapsed:.0f} s", is_last=True)
        elif now - self.last > (0.1 if on_terminal else BETWEEN):
            self.last = now
            # The outermost comes last.
            left = 1 + sum(not other.signatures for other in kernels_reached(*self.outermost))
            self._write(f"compiling the machine's equations, once: {done} of {done + left}, {elapsed:.0f} s")

    @staticmethod
    def _write(text: str, is_last: bool = False) -> None:
        on_terminal = sys.stderr.isatty()
        line = f"\r{text:<79}" if on_terminal else text
        print(line, end="" if on_terminal and not is_last else "\n", file=sys.stderr, flush=True)


_told = _Told()


def be_silent() -> None:
    """Say nothing in this process, where another one does."""
    _told.is_silent = True


@contextmanager
def telling(kernel: Dispatcher, signature: str) -> Generator[None]:
    """Say how far compiling is while a kernel is compiled, and whatever it calls with it."""
    # Not locked while numba compiles, which has a lock of its own.
    with _told.lock:
        _told.start(kernel, signature)
    try:
        yield
    finally:
        with _told.lock:
            _told.stop()
