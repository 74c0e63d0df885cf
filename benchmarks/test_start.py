"""How long until the first number: what starting, compiling and loading cost, in CPU seconds of their own processes."""

import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

ORBIT = "import ltvpneu as lp; lp.nonlinear_orbit(lp.load_machine('kunt_singh_1990'), 4.0{})"
WORK = {
    "libraries": "import numpy, scipy.linalg, numba",
    "package": "import numpy, scipy.linalg, numba, ltvpneu as lp; lp.nonlinear_orbit, lp.ltv_model, lp.load_machine",
    "help": "import sys; sys.argv = ['ltvpneu', '--version']; from ltvpneu.face.cli import main; main()",
    "first orbit": ORBIT.format(""),
    "fixed step on top": ORBIT.format(", method=lp.RungeKutta4()"),
    "orbit, kernels on disk": ORBIT.format(""),
    "fitted model on top": (
        "import ltvpneu as lp; lp.ltv_model(lp.load_machine('kunt_singh_1990'), 4.0, operating_points='fitted')"
    ),
}


def cpu(code: str, folder: Path) -> float:
    """Return the CPU seconds of a process, all threads and children."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(
        [sys.executable, "-c", code],
        check=True,
        capture_output=True,
        env={**os.environ, "NUMBA_CACHE_DIR": str(folder)},
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


@pytest.mark.benchmark(group="start")
def test_seconds_to_the_first_number(benchmark: BenchmarkFixture, tmp_path: Path) -> None:
    found = {name: cpu(code, tmp_path) for name, code in WORK.items()}
    print()
    for name, seconds in found.items():
        print(f"{name:24} {seconds:6.2f} s of CPU, {seconds / found['libraries']:5.1f} times importing the libraries")
    benchmark.extra_info.update(found)
    benchmark.pedantic(lambda: cpu(WORK["help"], tmp_path), rounds=3)
