"""Shared ways of measuring: ratios against a peer in the same run, since machines are shared and noisy."""

import statistics
import time
from collections.abc import Callable

import pytest

import ltvpneu as lp


def ratio(peer: Callable[[], object], ours: Callable[[], object], rounds: int = 15, inner: int = 20) -> float:
    """Return the median over rounds of the peer's time over ours, measured in turn; `inner` calls of ours a round."""
    ours()
    peer()
    ratios: list[float] = []
    for _ in range(rounds):
        start = time.perf_counter()
        peer()
        middle = time.perf_counter()
        for _ in range(inner):
            ours()
        ratios.append((middle - start) / ((time.perf_counter() - middle) / inner))
    return statistics.median(ratios)


@pytest.fixture(scope="session")
def table_1() -> lp.Machine:
    return lp.load_machine("kunt_singh_1990")
