"""One door to the media: ideal gas, real gas, liquid. A new medium is a file of its own and a branch here.

The models ask for three things: `properties`, from which a chamber's pressure and temperature follow; the flow through
a path and its slopes; and where the medium's laws end. The ideal gas has its own short cut in the models' inner loop
(`flow.mass_flow`); all else goes through here.
"""

import math
import warnings
from typing import Annotated, NamedTuple

from ltvpneu._arrays import FloatArray
from ltvpneu._compiled import compiled
from ltvpneu.physics.flow import mass_flow, mass_flow_slopes, mass_flux, mass_flux_slope
from ltvpneu.physics.gas import Gas, GasConstants, GasState, ideal_properties
from ltvpneu.physics.gas_table import in_table, real_flux_slopes, real_properties
from ltvpneu.physics.iso6358 import PathLaw, RestrictionFields, share_of_choked
from ltvpneu.physics.liquid import Liquid, liquid_flow_slopes, liquid_in_range, liquid_properties
from ltvpneu.physics.properties import IDEAL, LIQUID, Properties
from ltvpneu.physics.real_gas import RealGas
from ltvpneu.physics.thermal import EnergyBalance

Medium = Gas | RealGas | Liquid

LAMINAR = 1e-4
"""Relative difference of pressures within which a gas flows in proportion to it [-], where that is asked for.

The stiffness at that edge falls with its root; orbits of Table 1's machine move by 1e-6 against an edge ten times
nearer, by 1e-4 at one ten times further."""
COLDEST_EXPECTED = 100.0
"""Temperature below which a number is more likely degrees than kelvin [K]."""
MAX_TABLE = 8192
"""Most numbers that a medium's table may have: the room in a record."""
ROUNDING = 1e-15
"""Relative drop of a pressure that is nothing but rounding [-]."""


class MediumFields(NamedTuple):
    """A medium as the compiled kernels read it."""

    kind: int
    """`IDEAL`, `REAL` or `LIQUID`."""
    laminar: float
    """Relative difference of pressures within which a gas flows in proportion to it [-]; 0 for never, as in the paper.

    Eq. (5) has an infinite slope where the pressures meet. Real orifices are laminar there, and a volume that feeds
    another or has a temperature of its own would creep along that edge in tiny steps."""
    gas: GasConstants
    """Of an ideal gas, or of one like a real gas."""
    table: Annotated[FloatArray, MAX_TABLE]
    """Parameters of a medium that is not an ideal gas; zeros beyond their number."""


def warn_if_cold(name: str, temperature: float) -> None:
    """Warn of a temperature that is more likely meant in degrees than in kelvin."""
    if temperature < COLDEST_EXPECTED:
        warnings.warn(
            f"{name}: found {temperature:g} K, expected kelvin; was {temperature:g} degC meant, which is "
            f"{temperature + 273.15:g} K?",
            stacklevel=6,
        )


def check_process(name: str, exponent: float, balance: EnergyBalance | None, medium: Medium) -> None:
    """Raise for a liquid's thermal process; warn of a gas's that is none of heat exchanged with a wall.

    `name` is that of the polytropic exponent.
    """
    if balance is not None and balance.wall_temperature is not None:
        where = name.replace("polytropic_exponent", "energy_balance")
        warn_if_cold(f"{where}.wall_temperature", balance.wall_temperature)
    if isinstance(medium, Liquid):
        if exponent != 1.0 or balance is not None:
            name = name if balance is None else name.replace("polytropic_exponent", "energy_balance")
            raise ValueError(
                f"{name}: found a thermal process of a liquid, whose compression has next to no heat; expected "
                "exponent 1 and no energy_balance"
            )
    elif not 1.0 <= exponent <= medium.heat_capacity_ratio:
        warnings.warn(
            f"{name}: found {exponent:g}, outside 1 (isothermal) to {medium.heat_capacity_ratio:g} (adiabatic): a gas "
            "that exchanges heat with its wall lies between; beyond, heat would flow from cold to warm",
            stacklevel=5,
        )


@compiled
def properties(pressure: float, temperature: float, medium: MediumFields) -> Properties:
    """Density and internal energy of a medium at a pressure [Pa] and a temperature [K], with derivatives."""
    if medium.kind == IDEAL:
        return ideal_properties(pressure, temperature, medium.gas)
    if medium.kind == LIQUID:
        return liquid_properties(pressure, medium.table)
    return real_properties(pressure, temperature, medium.table)


@compiled
def in_range(pressure: float, temperature: float, medium: MediumFields) -> bool:
    """Whether a medium's laws hold at a pressure [Pa] and a temperature [K]."""
    if not (pressure > 0.0 and temperature > 0.0):
        return False
    if medium.kind == IDEAL:
        return True
    if medium.kind == LIQUID:
        return liquid_in_range(pressure, medium.table)
    return in_table(pressure, temperature, medium.table)


class Flow(NamedTuple):
    """Mass flow [kg/s] and its slopes over the pressures on both sides and the temperature upstream."""

    flow: float
    by_upstream: float
    by_downstream: float
    by_temperature: float


@compiled
def _nozzle(upstream: float, downstream: float, temperature: float, medium: MediumFields) -> Flow:
    """Flow of a gas through a nozzle, per effective area."""
    if medium.kind == IDEAL:
        flux = mass_flux(upstream, downstream, temperature, medium.gas)
        slope = mass_flux_slope(upstream, downstream, temperature, medium.gas)
        # Homogeneous of degree one in the pressures; M_f ~ T^(-1/2) of the side upstream, (5).
        return Flow(flux, (flux - downstream * slope) / upstream, slope, -0.5 * flux / temperature)
    flux, by_upstream, by_downstream, by_temperature = real_flux_slopes(upstream, downstream, temperature, medium.table)
    return Flow(flux, by_upstream, by_downstream, by_temperature)


@compiled
def _through(
    area: float, law: RestrictionFields, upstream: float, downstream: float, temperature: float, medium: MediumFields
) -> Flow:
    """Flow through one restriction of an effective area."""
    area *= law.share
    if area == 0.0:
        return Flow(0.0, 0.0, 0.0, 0.0)
    if medium.kind == LIQUID:
        flow, by_upstream, by_downstream = liquid_flow_slopes(area, upstream, downstream, medium.table)
        return Flow(flow, by_upstream, by_downstream, 0.0)
    if law.is_iso:
        choked, found = _nozzle(upstream, 0.0, temperature, medium), share_of_choked(upstream, downstream, law)
        by_upstream = choked.by_upstream * found.share + choked.flow * found.by_upstream
        by_downstream = choked.flow * found.by_downstream
        return Flow(
            area * choked.flow * found.share,
            area * by_upstream,
            area * by_downstream,
            area * choked.by_temperature * found.share,
        )
    flux = _nozzle(upstream, downstream, temperature, medium)
    return Flow(area * flux.flow, area * flux.by_upstream, area * flux.by_downstream, area * flux.by_temperature)


class _Way(NamedTuple):
    """A path in the direction of its flow: effective areas [m^2] and laws of its two restrictions."""

    first: float
    second: float
    """Infinite where there is none."""
    law: RestrictionFields
    second_law: RestrictionFields


@compiled
def _is_steep(way: _Way, medium: MediumFields) -> bool:
    """Whether the flow's slope is infinite where the pressures meet: a gas through nozzles."""
    return not (medium.kind == LIQUID or way.law.is_iso or (way.second_law.is_iso and not math.isinf(way.second)))


@compiled
def _pressure_between(way: _Way, upstream: float, downstream: float, temperature: float, medium: MediumFields) -> float:
    """Pressure between two restrictions in series that pass the same flow [Pa], by bisection.

    The temperature between them is taken as that upstream, which throttling changes by a real gas's Joule-Thomson
    effect only.
    """
    low, high = downstream, upstream
    middle = 0.5 * (low + high)
    while low < middle < high:
        into = _through(way.first, way.law, upstream, middle, temperature, medium).flow
        if into > _through(way.second, way.second_law, middle, downstream, temperature, medium).flow:
            low = middle
        else:
            high = middle
        middle = 0.5 * (low + high)
    return middle


@compiled
def _forward(way: _Way, upstream: float, downstream: float, temperature: float, medium: MediumFields) -> Flow:
    """Flow through a path's two restrictions."""
    if way.first * way.law.share == 0.0 or way.second * way.second_law.share == 0.0:
        return Flow(0.0, 0.0, 0.0, 0.0)
    if medium.kind == IDEAL and _is_steep(way, medium):
        high, low = GasState(upstream, temperature), GasState(downstream, temperature)
        flow = mass_flow(way.first, way.second, high, low, medium.gas)
        by_upstream, by_downstream = mass_flow_slopes(way.first, way.second, high, low, medium.gas)
        return Flow(flow, by_upstream, by_downstream, -0.5 * flow / temperature)
    if math.isinf(way.second):
        return _through(way.first, way.law, upstream, downstream, temperature, medium)
    if upstream == downstream and _is_steep(way, medium):
        return Flow(0.0, math.inf, -math.inf, 0.0)
    middle = _pressure_between(way, upstream, downstream, temperature, medium)
    # So much wider that nothing drops across it, one of the two is none; where pressures meet, a nozzle is.
    if medium.kind != LIQUID and upstream - middle <= ROUNDING * upstream and not way.law.is_iso:
        return _through(way.second, way.second_law, upstream, downstream, temperature, medium)
    if medium.kind != LIQUID and middle - downstream <= ROUNDING * downstream and not way.second_law.is_iso:
        return _through(way.first, way.law, upstream, downstream, temperature, medium)
    one = _through(way.first, way.law, upstream, middle, temperature, medium)
    two = _through(way.second, way.second_law, middle, downstream, temperature, medium)
    # Whichever has the larger pressure drop gives the flow with the smaller rounding error.
    flow = one.flow if upstream - middle > middle - downstream else two.flow
    # Implicit function theorem on M_1(p_u, p_m, T) = M_2(p_m, p_d, T).
    apart = one.by_downstream - two.by_upstream
    if apart == 0.0:
        # Shut by a check valve.
        return Flow(flow, 0.0, 0.0, 0.0)
    return Flow(
        flow,
        -one.by_upstream * two.by_upstream / apart,
        one.by_downstream * two.by_downstream / apart,
        one.by_temperature + one.by_downstream * (two.by_temperature - one.by_temperature) / apart,
    )


@compiled
def _laminar(way: _Way, upstream: float, downstream: float, temperature: float, medium: MediumFields) -> Flow:
    """Flow that is proportional to the difference of the pressures, up to that of eq. (5) where laminar flow ends."""
    share = medium.laminar
    edge = _forward(way, upstream, (1.0 - share) * upstream, temperature, medium)
    part = (upstream - downstream) / (share * upstream)
    chord = edge.flow / (share * upstream)
    by_both = edge.by_upstream + (1.0 - share) * edge.by_downstream
    return Flow(part * edge.flow, chord + part * (by_both - edge.flow / upstream), -chord, part * edge.by_temperature)


@compiled
def path_flow_slopes(
    first: float, second: float, source: GasState, chamber: GasState, law: PathLaw, medium: MediumFields
) -> tuple[float, float, float, float]:
    """Mass flow from a source into a chamber [kg/s] and its slopes.

    Parameters
    ----------
    first, second : float
        Effective areas C A [m^2] on the side of the source and of the chamber; `second` infinite where there is none.
    source, chamber : GasState
    law : PathLaw
    medium : MediumFields

    Returns
    -------
    tuple of float
        Flow; slopes over the source's and the chamber's pressure [kg/(s Pa)] and over the temperature of the side that
        it comes from [kg/(s K)].
    """
    forward = source.pressure >= chamber.pressure
    high, low = (source, chamber) if forward else (chamber, source)
    if forward:
        way = _Way(first, second, law.first, law.second)
    elif math.isinf(second):
        way = _Way(first, second, law.first_back, law.second_back)
    else:
        way = _Way(second, first, law.second_back, law.first_back)
    if high.pressure - low.pressure < medium.laminar * high.pressure and _is_steep(way, medium):
        found = _laminar(way, high.pressure, low.pressure, high.temperature, medium)
    else:
        found = _forward(way, high.pressure, low.pressure, high.temperature, medium)
    if forward:
        return found.flow, found.by_upstream, found.by_downstream, found.by_temperature
    return -found.flow, -found.by_downstream, -found.by_upstream, -found.by_temperature


@compiled
def path_flow(
    first: float, second: float, source: GasState, chamber: GasState, law: PathLaw, medium: MediumFields
) -> float:
    """Mass flow from a source into a chamber [kg/s], as of `path_flow_slopes`."""
    high = max(source.pressure, chamber.pressure)
    is_iso = law.first.is_iso or law.second.is_iso
    if medium.kind == IDEAL and not is_iso and abs(source.pressure - chamber.pressure) >= medium.laminar * high:
        return mass_flow(first, second, source, chamber, medium.gas)
    return path_flow_slopes(first, second, source, chamber, law, medium)[0]
