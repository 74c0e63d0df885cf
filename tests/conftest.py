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


def by_data_sheet(machine: lp.Machine) -> lp.Machine:
    """Return the machine with paths by ISO 6358, others back than there, a silencer on the exhausts."""
    there = lp.ISO6358(sonic_conductance=0.7e-8, critical_pressure_ratio=0.3)
    back = lp.ISO6358(sonic_conductance=0.8e-8, critical_pressure_ratio=0.2, subsonic_index=0.55)
    silencer = lp.ISO6358(sonic_conductance=0.5e-8, critical_pressure_ratio=0.4)
    paths = tuple(
        lp.FlowPath(
            source=path.source,
            chamber=path.chamber,
            opening=path.opening,
            law=there,
            law_back=back,
            in_series=silencer if path.source == "exhaust" else None,
        )
        for path in machine.flow_paths
    )
    return replace(machine, flow_paths=paths)


def extensions() -> dict[str, lp.Machine]:
    """Return machines beyond the paper's: energy balances, the valve's inner volume, real gas, liquid, leakage."""
    one, two = lp.load_machine("kunt_singh_1990"), lp.load_machine("double_acting_5_2")
    walls = lp.EnergyBalance(heat_transfer_coefficient=60.0, wall_area=0.01, wall_temperature=300.0)
    dynamic, air = one.with_collapse("dynamic"), lp.RealGas(fluid="Air")
    hot = lp.EnergyBalance(heat_transfer_coefficient=200.0, wall_area=0.02, wall_temperature=450.0)
    mixed = one.with_collapse("dynamic").with_thermal(1.2)
    assert isinstance(mixed.valve, lp.RotaryValve)
    inner = tuple(replace(v, polytropic_exponent=1.0, energy_balance=walls) for v in mixed.valve.inner_volumes)
    leak = lp.FlowPath(source="chamber_1", chamber="chamber_2", area=0.2e-6)
    return {
        "adiabatic": one.with_thermal("adiabatic"),
        "walls": two.with_thermal(walls),
        "dynamic": dynamic,
        "dynamic, adiabatic": dynamic.with_thermal("adiabatic"),
        "dynamic, polytropic": dynamic.with_thermal(1.3),
        "dynamic, offset": dynamic.with_offset(math.radians(-60)),
        "hot wall, throughflow": one.with_thermal(hot),
        "mixed polytropic": replace(mixed, valve=replace(mixed.valve, inner_volumes=inner)),
        "leakage": replace(two, flow_paths=(*two.flow_paths, leak)),
        "real": one.with_gas(air),
        "real, adiabatic": one.with_gas(air).with_thermal("adiabatic"),
        "real, dynamic, polytropic": dynamic.with_gas(air).with_thermal(1.2),
        "real, in series": replace(one.with_gas(air), collapse="in_series"),
        "real, in series, adiabatic": replace(one.with_gas(air), collapse="in_series").with_thermal("adiabatic"),
        "data sheet": by_data_sheet(two),
        "data sheet, walls": by_data_sheet(two).with_thermal(walls),
        "data sheet, real": by_data_sheet(two).with_gas(air),
        "hydraulic": lp.load_machine("hydraulic_4_2"),
        "hydraulic, in series": replace(one.with_gas(lp.Liquid()), collapse="in_series"),
    }


EXTENSIONS = extensions()
