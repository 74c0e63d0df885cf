"""Fixtures and the catalogue of machines that every model is tried on."""

import math
from dataclasses import replace

import matplotlib as mpl
import pytest
from hypothesis import settings

import ltvpneu as lp

mpl.use("Agg")
# Compiling a law on first use may take seconds; slow machines are not failures.
settings.register_profile("ltvpneu", deadline=None, max_examples=60, derandomize=True)
settings.load_profile("ltvpneu")


@pytest.fixture(scope="session")
def table_1() -> lp.Machine:
    return lp.load_machine("kunt_singh_1990")


@pytest.fixture(scope="session")
def double_acting() -> lp.Machine:
    return lp.load_machine("double_acting_5_2")


def ramped(machine: lp.Machine) -> lp.Machine:
    """Table 1 with ports that take 20 degrees to open."""
    assert isinstance(machine.valve, lp.RotaryValve)
    ports = tuple(replace(p, window=replace(p.window, ramp=math.radians(20))) for p in machine.valve.ports)
    return replace(machine, valve=replace(machine.valve, ports=ports))


def variants() -> dict[str, lp.Machine]:
    """Return machines that differ in kind: chambers, collapse, process, ramps, stops."""
    one, two = lp.load_machine("kunt_singh_1990"), lp.load_machine("double_acting_5_2")
    return {
        "table 1": one,
        "frictionless": one.without_dry_friction(),
        "duty 0.3, 6 bar": one.with_duty(0.3).with_supply_pressure(6e5),
        "offset": one.with_offset(math.radians(-60)),
        "in series": replace(one, collapse="in_series"),
        "polytropic": replace(one, cylinder=replace(one.cylinder, polytropic_exponent_1=1.3)),
        "ramped": ramped(one),
        "ramped in series": replace(ramped(one), collapse="in_series"),
        "double-acting": two,
        "double-acting, free": two.without_dry_friction(),
        "end stops": replace(one, cylinder=replace(one.cylinder, lower_stop=0.0, upper_stop=0.06)),
        "external force": replace(one, load=replace(one.load, force=-15.0)),
    }


MACHINES = variants()
