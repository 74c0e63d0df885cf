"""Random periodic systems for property tests."""

from dataclasses import replace

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import ltvpneu as lp

entries = st.floats(-2, 2).map(lambda x: round(x, 6))


@st.composite
def systems(
    draw, n: int = 3, most_steps: int = 4, damped: bool = True, ports: tuple[int, int] | None = None
) -> lp.PeriodicSystem:
    """Draw a system of n states, stable if damped; with ports, of as many inputs and outputs, D zero."""
    N = draw(st.integers(1, most_steps))
    A = draw(arrays(float, (N, n, n), elements=entries))
    if damped:
        A = A - 5 * np.eye(n)
    f = draw(arrays(float, (N, n), elements=entries))
    durations = draw(arrays(float, (N,), elements=st.floats(0.05, 1.5)))
    if ports is None:
        return lp.PeriodicSystem.from_matrices(A, f, durations)
    # Never all zero, so that norms are above zero.
    B = 0.5 + draw(arrays(float, (N, n, ports[0]), elements=entries))
    C = 0.5 + draw(arrays(float, (N, ports[1], n), elements=entries))
    return lp.PeriodicSystem.from_matrices(A, f, durations, B=B, C=C)


def split_lti(durations: list[float], n: int = 3, m: int = 2, p: int = 2, D: float = 0.0) -> lp.PeriodicSystem:
    """Return one stable time-invariant system written as several equal steps."""
    random = np.random.default_rng(7)
    A = random.normal(size=(n, n)) - 2 * np.eye(n)
    B, C = random.normal(size=(n, m)), random.normal(size=(p, n))
    N = len(durations)
    return lp.PeriodicSystem.from_matrices(
        [A] * N, np.zeros((N, n)), durations, [B] * N, [C] * N, [np.full((p, m), D)] * N
    )


def shifted(system: lp.PeriodicSystem) -> lp.PeriodicSystem:
    """Return the system started one step later."""
    parts = {name: np.roll(getattr(system, name), -1, axis=0) for name in ("A", "B", "r", "C", "D", "q", "durations")}
    return replace(system, **parts)
