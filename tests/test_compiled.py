"""The cache of compiled kernels never outlives the laws it was made from."""

import os
import time

from ltvpneu._compiled import compiled, drop_stale_kernels


def test_kernels_older_than_any_source_are_dropped(tmp_path):
    (tmp_path / "__pycache__").mkdir()
    source, kernel = tmp_path / "law.py", tmp_path / "__pycache__" / "kernel.nbi"
    kernel.touch()
    source.touch()
    past = time.time() - 60
    os.utime(source, (past, past))
    assert drop_stale_kernels(tmp_path) == 0
    assert kernel.exists()
    os.utime(kernel, (past - 60, past - 60))
    assert drop_stale_kernels(tmp_path) == 1
    assert not kernel.exists()


def test_a_compiled_law_divides_as_on_paper():
    @compiled
    def inverse(x: float) -> float:
        return 1.0 / x

    assert inverse(0.0) == float("inf")
