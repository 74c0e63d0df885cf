"""A limit on the time that a call may take, and word of how far it has got."""

import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import final

from ltvpneu._arrays import positive
from ltvpneu._values import Value
from ltvpneu.errors import TimeLimitError


@final
@dataclass(frozen=True, kw_only=True)
class Deadline(Value):
    """When a call has to end."""

    seconds: float
    """That it may take."""
    end: float
    """On the monotonic clock [s]."""

    @property
    def left(self) -> float:
        """Seconds left; next to none where the time is over."""
        return max(self.end - time.monotonic(), 1e-9)

    def check(self, reached: str) -> None:
        """Raise if the time is over; `reached` says how far the call got.

        Raises
        ------
        TimeLimitError
        """
        if time.monotonic() > self.end:
            raise TimeLimitError(
                f"max_seconds: {self.seconds:g} s are over, {reached}. Give it more time, or ask for less",
                seconds=self.seconds,
            )


@contextmanager
def interruptible() -> Generator[None]:
    """Let Ctrl-C that arrives within a kernel end it as it ends Python: numba reports a broken result instead.

    Raises
    ------
    KeyboardInterrupt
    """
    try:
        yield
    except SystemError as error:
        if isinstance(error.__cause__ or error.__context__, KeyboardInterrupt):
            raise KeyboardInterrupt from error
        raise


@final
@dataclass(frozen=True, kw_only=True)
class Watch(Value):
    """What looks on while a call works its way from one valve period to the next."""

    end: Deadline | None = None
    progress: Callable[[int], object] | None = None
    """Called with 1 after each period."""

    def tick(self, reached: str) -> None:
        """Note one period more; `reached` is as of `Deadline.check`."""
        if self.progress is not None:
            self.progress(1)
        if self.end is not None:
            self.end.check(reached)


UNWATCHED = Watch()


def deadline(max_seconds: float | None) -> Deadline | None:
    """Return when a call that begins now has to end; None for never.

    Raises
    ------
    ValueError
        The time is not positive.
    """
    if max_seconds is None:
        return None
    seconds = positive("max_seconds", max_seconds, "s")
    return Deadline(seconds=seconds, end=time.monotonic() + seconds)
