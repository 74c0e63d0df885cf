"""Fixtures and the catalogue of machines that every model is tried on."""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import cache

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


class Catalogue(Mapping[str, lp.Machine]):
    """Machines by name, each made when it is first asked for: tables of a real gas take seconds."""

    def __init__(self, made: Mapping[str, Callable[[], lp.Machine]]) -> None:
        self._made, self._machines = made, dict[str, lp.Machine]()

    def __getitem__(self, name: str) -> lp.Machine:
        if name not in self._machines:
            self._machines[name] = self._made[name]()
        return self._machines[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._made)

    def __len__(self) -> int:
        return len(self._made)


@cache
def one() -> lp.Machine:
    return lp.load_machine("kunt_singh_1990")


@cache
def two() -> lp.Machine:
    return lp.load_machine("double_acting_5_2")


# Machines that differ in kind: chambers, collapse, process, ramps, stops.
MACHINES = Catalogue(
    {
        "table 1": one,
        "frictionless": lambda: one().without_dry_friction(),
        "duty 0.3, 6 bar": lambda: one().with_duty(0.3).with_supply_pressure(6e5),
        "offset": lambda: one().with_offset(math.radians(-60)),
        "in series": lambda: replace(one(), collapse="in_series"),
        "polytropic": lambda: replace(one(), cylinder=replace(one().cylinder, polytropic_exponent_1=1.3)),
        "ramped": lambda: ramped(one()),
        "ramped in series": lambda: replace(ramped(one()), collapse="in_series"),
        "double-acting": two,
        "double-acting, free": lambda: two().without_dry_friction(),
        "end stops": lambda: replace(one(), cylinder=replace(one().cylinder, lower_stop=0.0, upper_stop=0.06)),
        "external force": lambda: replace(one(), load=replace(one().load, force=-15.0)),
    }
)


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


WALLS = lp.EnergyBalance(heat_transfer_coefficient=60.0, wall_area=0.01, wall_temperature=300.0)
HOT = lp.EnergyBalance(heat_transfer_coefficient=200.0, wall_area=0.02, wall_temperature=450.0)
LEAK = lp.FlowPath(source="chamber_1", chamber="chamber_2", area=0.2e-6)


@cache
def dynamic() -> lp.Machine:
    return one().with_collapse("dynamic")


@cache
def air() -> lp.RealGas:
    return lp.RealGas(fluid="Air")


def mixed() -> lp.Machine:
    """Return a machine whose chambers are polytropic, and whose valve's inner volumes have walls."""
    machine = one().with_collapse("dynamic").with_thermal(1.2)
    assert isinstance(machine.valve, lp.RotaryValve)
    inner = tuple(replace(v, polytropic_exponent=1.0, energy_balance=WALLS) for v in machine.valve.inner_volumes)
    return replace(machine, valve=replace(machine.valve, inner_volumes=inner))


# Machines beyond the paper's: energy balances, the valve's inner volume, real gas, liquid, leakage.
EXTENSIONS = Catalogue(
    {
        "adiabatic": lambda: one().with_thermal("adiabatic"),
        "walls": lambda: two().with_thermal(WALLS),
        "dynamic": dynamic,
        "dynamic, adiabatic": lambda: dynamic().with_thermal("adiabatic"),
        "dynamic, polytropic": lambda: dynamic().with_thermal(1.3),
        "dynamic, offset": lambda: dynamic().with_offset(math.radians(-60)),
        "hot wall, throughflow": lambda: one().with_thermal(HOT),
        "mixed polytropic": mixed,
        "leakage": lambda: replace(two(), flow_paths=(*two().flow_paths, LEAK)),
        "real": lambda: one().with_gas(air()),
        "real, adiabatic": lambda: one().with_gas(air()).with_thermal("adiabatic"),
        "real, dynamic, polytropic": lambda: dynamic().with_gas(air()).with_thermal(1.2),
        "real, in series": lambda: replace(one().with_gas(air()), collapse="in_series"),
        "real, in series, adiabatic": lambda: replace(one().with_gas(air()), collapse="in_series").with_thermal(
            "adiabatic"
        ),
        "data sheet": lambda: by_data_sheet(two()),
        "data sheet, walls": lambda: by_data_sheet(two()).with_thermal(WALLS),
        "data sheet, real": lambda: by_data_sheet(two()).with_gas(air()),
        "hydraulic": lambda: lp.load_machine("hydraulic_4_2"),
        "hydraulic, in series": lambda: replace(one().with_gas(lp.Liquid()), collapse="in_series"),
    }
)
