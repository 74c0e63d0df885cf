"""Compile the equations ahead of use, in as many processes as there are cores."""

import os
import shutil
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
from tqdm import tqdm

import ltvpneu as lp
from ltvpneu._compiled import kernels
from ltvpneu._kernel_cache import KernelCache, counts
from ltvpneu._telling import be_silent
from ltvpneu.models.linear.march import march_period
from ltvpneu.models.nonlinear.integrator import advance

FREQUENCY = 4.0
"""Of the cycles that are computed on the way [Hz]."""
WAIT, MOST_WAITS = 0.2, 300
"""How long a process waits at a time for what another one compiles [s], and how often."""


class Warmed(NamedTuple):
    """What warming came to."""

    compiled: int
    loaded: int
    """Found on disk."""
    seconds: float
    folder: str
    """Where kernels are kept; empty where they cannot be."""
    files: frozenset[str]
    """Those that were loaded."""


def _machines() -> tuple[lp.Machine, lp.Machine]:
    """Return a machine of the paper's kind, and one of any other: the kernels tell no more."""
    machine = lp.load_machine("kunt_singh_1990")
    return machine, machine.with_thermal("adiabatic")


def _orbits(machine: lp.Machine) -> None:
    orbit = lp.nonlinear_orbit(machine, FREQUENCY)
    lp.orbit_floquet(machine, orbit)
    lp.balance(machine, orbit)
    lp.attractors(machine, FREQUENCY, n_spread=2)
    lp.stiction_band(machine.with_duty(0.7), 20.0)


def _fixed_steps(machine: lp.Machine) -> None:
    lp.nonlinear_orbit(machine, FREQUENCY, method=lp.RungeKutta4())


def _linear(machine: lp.Machine) -> None:
    model = lp.ltv_model(machine, FREQUENCY)
    lp.cycle_floquet(model)
    _ = model.error_estimate
    for i in range(len(machine.states)):
        model.orbit.amplitude(i)


def _own_cycles(machine: lp.Machine) -> None:
    # Faster than the paper's, so that the piston does not rest and the march leaps.
    for points in ("fitted", "self-consistent"):
        lp.cycle_floquet(lp.ltv_model(machine, 2 * FREQUENCY, operating_points=points))


def _design(machine: lp.Machine) -> None:
    from ltvpneu import design

    design.optimize_duty(machine, 2 * FREQUENCY, minimize="air_use", mean={"position": (0.04, 0.06)})
    lp.nonlinear_sensitivity(machine, 2 * FREQUENCY, ["duty"])
    design.air_use(machine, lp.nonlinear_orbit(machine, 2 * FREQUENCY))
    design.with_air_use(lp.ltv_model(machine, 2 * FREQUENCY))


def _periodic_systems(machine: lp.Machine) -> None:
    model = lp.ltv_model(machine, FREQUENCY)
    turning = np.array([[0.0, -1.0], [1.0, 0.0]])
    # A pair, which the iteration does not part.
    lp.product_multipliers([turning, 0.5 * turning])
    lp.response(model.system, n_periods=1)


WORK: dict[str, Callable[[lp.Machine], None]] = {
    "orbits": _orbits,
    "cycles of linear models": _own_cycles,
    "linear models": _linear,
    "design": _design,
    "fixed steps": _fixed_steps,
    "periodic systems": _periodic_systems,
}
"""What needs the equations, by name: between them, all of them."""


def work(name: str, number: int) -> tuple[int, int, set[str]]:
    """Do one kind of work on one of the machines.

    Returns how many kernels were compiled, how many were loaded, and the files of these.
    """
    be_silent()
    before = counts.compiled, counts.loaded + counts.shipped
    counts.names.clear()
    # Done for its kernels alone: what the models warn of is no news here.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        WORK[name](_machines()[number])
    return counts.compiled - before[0], counts.loaded + counts.shipped - before[1], set(counts.names)


def warm(jobs: int | None = None, names: Sequence[str] = tuple(WORK)) -> Warmed:
    """Compile what the public names need, and keep it on disk.

    Parameters
    ----------
    jobs : int, optional
        Processes at work; by default as many as there are cores.
    names : sequence of str
        Kinds of work, of `WORK`; by default all.
    """
    begin, tasks = time.monotonic(), [(name, number) for number in range(len(_machines())) for name in names]
    jobs = jobs or os.cpu_count() or 1
    compiled, loaded, files = 0, 0, set[str]()
    # Started afresh: a process that is forked takes over the threads' locks as they stand.
    with (
        ProcessPoolExecutor(min(jobs, len(tasks)), mp_context=get_context("spawn")) as pool,
        tqdm(total=len(tasks), desc="compiling the machine's equations", unit="part", leave=False) as bar,
    ):
        for done in as_completed([pool.submit(work, *task) for task in tasks]):
            compiled, loaded = compiled + done.result()[0], loaded + done.result()[1]
            files |= done.result()[2]
            bar.update(1)
    return Warmed(compiled, loaded, time.monotonic() - begin, kernels[0]._cache.cache_path or "", frozenset(files))


def work_later(*names: str) -> None:
    """Do kinds of work once the first orbit has been compiled by another process: what both need is then on disk."""
    first: KernelCache = cast(Any, advance)._cache
    for _ in range(MOST_WAITS):
        if first.is_kept:
            break
        time.sleep(WAIT)
    for name in names:
        work(name, 0)


@contextmanager
def beside(*names: str) -> Generator[None]:
    """Compile what some kinds of work need in a process beside this one, where it is not on disk yet.

    The process ends with what it is beside; what it has compiled by then is kept.
    """
    kernel: KernelCache = cast(Any, march_period)._cache
    if kernel.is_kept or (os.cpu_count() or 1) < 2:
        yield
        return
    code = f"from ltvpneu.face.warm import work_later; work_later(*{names!r})"
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as process:
        try:
            yield
        finally:
            process.terminate()


def ship(folder: str) -> int:
    """Copy the kernels that calls from Python ask for to a folder, to come with a wheel; return how many.

    Those hold all that they call. Which they are shows when nothing is compiled any more.
    """
    warm()
    Path(folder).mkdir(parents=True, exist_ok=True)
    files = warm(1).files
    for file in files:
        shutil.copy(file, folder)
    return len(files)
