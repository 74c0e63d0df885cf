r"""Mass flow through a restriction as data sheets give it: ISO 6358, by sonic conductance and critical pressure ratio.

With r = p_2 / p_1, the absolute pressures, and the reference state ANR (T_0 = 20 degC, rho_0 = 1.185 kg/m^3),

.. math:: q = C \rho_0 p_1 \sqrt{T_0 / T_1} \, \varphi(r), \qquad
          \varphi = 1 \;\; (r \le b), \qquad \varphi = \left[1 - s^2\right]^m, \quad
          s = \frac{r - b}{1 - \Delta p_c / p_1 - b}

ISO 6358-1:2013, where Delta p_c is the pressure at which a check valve opens. The curve ends with an infinite slope at
r = 1. From the laminar ratio B on it goes over to the straight line q = k_1 p_1 (1 - r) through its own point at B, as
simulation programs have it, with k_1 = C rho_0 phi(B) / (1 - B). Curve and line have slopes that differ by a factor of
two at B, so here a cubic joins them in the half of that range next to B: value and slope have no jump anywhere. A check
valve opens with slope zero.

C p_1 at the choked flow of air is that of a nozzle of effective area A, which is how the models carry it: other gases
flow through the same area at their own choked flux.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, final

import numpy as np

from ltvpneu._arrays import finite, layout, not_negative, positive
from ltvpneu._compiled import compiled
from ltvpneu._values import Value
from ltvpneu.physics.gas import Gas

ANR_DENSITY = 1.185
"""Of air at the reference state ANR: 20 degC, 1 bar, 65 % relative humidity [kg/m^3] (ISO 8778)."""
ANR_TEMPERATURE = 293.15
"""[K]"""
AREA_OF_CONDUCTANCE = ANR_DENSITY * math.sqrt(ANR_TEMPERATURE) / Gas().constants.choked
"""Effective area of a nozzle with the choked flow of a sonic conductance of 1 m^3/(s Pa) [m^2]."""
AREA_OF_KV = 1 / 3600 / math.sqrt(2 * 1e5 / 1000.0)
"""Effective area C A with the flow of water of Kv = 1: 1 m^3/h at a drop of 1 bar [m^2]."""
KV_OF_CV = 0.865
"""Kv of a valve with Cv = 1: one US gallon a minute at a drop of 1 psi [m^3/h]."""
NARROWEST = 0.01
"""Least part of the range of r that the curve takes where a check valve opens close to choking [-]."""


class RestrictionFields(NamedTuple):
    """How a restriction lets through, in one direction, as the compiled kernels read it."""

    is_iso: bool
    """Whether by ISO 6358; else an ideal nozzle, or a liquid's orifice."""
    share: float
    """Of the effective area that is open [-]."""
    critical_pressure_ratio: float
    subsonic_index: float
    laminar_ratio: float
    cracking_pressure: float


class PathLaw(NamedTuple):
    """The two restrictions of a path, first on the side of the source, in the direction of its volume and back."""

    first: RestrictionFields
    second: RestrictionFields
    first_back: RestrictionFields
    second_back: RestrictionFields


NOZZLE = RestrictionFields(False, 1.0, 0.0, 0.0, 0.0, 0.0)
"""An orifice of the paper."""
NOZZLES = PathLaw(NOZZLE, NOZZLE, NOZZLE, NOZZLE)


class Share(NamedTuple):
    """Share of the choked flow that passes, and its slopes over the pressures on both sides [1/Pa]."""

    share: float
    by_upstream: float
    by_downstream: float


@compiled
def share_of_choked(upstream: float, downstream: float, law: RestrictionFields) -> Share:
    """Share of the choked flow that passes at pressures [Pa], `upstream` not below `downstream`."""
    ratio, opens = downstream / upstream, 1.0 - law.cracking_pressure / upstream
    if opens <= 0.0 or ratio > opens:
        return Share(0.0, 0.0, 0.0)
    opens_up = law.cracking_pressure / (upstream * upstream)
    begins, begins_up = law.critical_pressure_ratio, 0.0
    if begins > opens - NARROWEST:
        begins, begins_up = opens - NARROWEST, opens_up
    if ratio <= begins:
        return Share(1.0, 0.0, 0.0)
    width = opens - begins
    s = (ratio - begins) / width
    s_down = 1.0 / (upstream * width)
    s_up = ((-ratio / upstream - begins_up) * width - (ratio - begins) * (opens_up - begins_up)) / (width * width)
    m, b = law.subsonic_index, law.critical_pressure_ratio
    s_laminar = (law.laminar_ratio - b) / (1.0 - b)
    if s <= s_laminar:
        value = (1.0 - s * s) ** m
        by_s = -2.0 * m * s * value / (1.0 - s * s)
    else:
        value, by_s = _laminar(s, s_laminar, m, law.cracking_pressure > 0.0)
    return Share(value, by_s * s_up, by_s * s_down)


@compiled
def _laminar(s: float, s_laminar: float, m: float, checks: bool) -> tuple[float, float]:
    """Share of the choked flow beyond the laminar ratio, and its slope over s."""
    at_edge = (1.0 - s_laminar * s_laminar) ** m
    # In shares of the way from no flow to the edge, whose slope is that of the curve.
    u, slope = (1.0 - s) / (1.0 - s_laminar), 2.0 * m * s_laminar / (1.0 + s_laminar)
    if checks:
        value, by_u = (
            (3.0 - slope) * u * u + (slope - 2.0) * u * u * u,
            u * (6.0 - 2.0 * slope + 3.0 * (slope - 2.0) * u),
        )
    elif u <= 0.5:
        value, by_u = u, 1.0
    else:
        t = 2.0 * u - 1.0
        value, by_u = u + 0.5 * (slope - 1.0) * t * t * (t - 1.0), 1.0 + (slope - 1.0) * t * (3.0 * t - 2.0)
    return at_edge * value, -at_edge * by_u / (1.0 - s_laminar)


@final
@dataclass(frozen=True, kw_only=True)
class ISO6358(Value):
    """What a valve's passage, a silencer, a tube or a throttle lets through, by the numbers of its data sheet.

    Parameters
    ----------
    sonic_conductance : float
        C [m^3/(s Pa)]; 1 dm^3/(s bar) is 1e-8 of these.
    critical_pressure_ratio : float
        b [-], below which the flow is choked; 0 to below 1.
    subsonic_index : float
        m [-], 0.5 unless measured; above 0, at most 1.
    laminar_ratio : float
        B [-], of the pressures beyond which the flow is laminar; above b, below 1. It sets how stiff the machine is
        where pressures meet.
    cracking_pressure : float
        Delta p_c [Pa], which a check valve takes to open.

    Examples
    --------
    SMC's catalog: C = 1.1 dm^3/(s bar) and b = 0.28 pass 276 l/min (ANR) from 0.6 to 0.5 MPa (gauge).

    >>> valve = ISO6358(sonic_conductance=1.1e-8, critical_pressure_ratio=0.28)
    >>> round(valve.volume_flow(701325.0, 601325.0) * 6e4, 1)
    276.5
    """

    sonic_conductance: float
    critical_pressure_ratio: float = 0.3
    subsonic_index: float = 0.5
    laminar_ratio: float = 0.999
    cracking_pressure: float = 0.0

    def __post_init__(self) -> None:
        conductance = not_negative("sonic_conductance", self.sonic_conductance, "m^3/(s Pa)")
        if conductance >= 1e-4:
            raise ValueError(
                f"sonic_conductance: found {conductance:g} m^3/(s Pa), which is {conductance * 1e8:.3g} dm^3/(s bar); "
                "expected less than 1e4 dm^3/(s bar) (a data sheet's 0.7 dm^3/(s bar) is 7e-9 m^3/(s Pa))"
            )
        if not 0 <= finite("critical_pressure_ratio", self.critical_pressure_ratio) < 1:
            raise ValueError(
                f"critical_pressure_ratio: found {self.critical_pressure_ratio:g}, expected b, 0 to below 1 (valves: "
                "0.1 to 0.5)"
            )
        if not 0 < finite("subsonic_index", self.subsonic_index) <= 1:
            raise ValueError(f"subsonic_index: found {self.subsonic_index:g}, expected m, above 0, at most 1")
        if not self.critical_pressure_ratio < finite("laminar_ratio", self.laminar_ratio) < 1:
            raise ValueError(
                f"laminar_ratio: found {self.laminar_ratio:g}, expected B, above the critical pressure ratio "
                f"{self.critical_pressure_ratio:g}, below 1"
            )
        not_negative("cracking_pressure", self.cracking_pressure, "Pa")

    @staticmethod
    def from_nominal_flow(
        flow: float, critical_pressure_ratio: float = 0.3, *, subsonic_index: float = 0.5
    ) -> "ISO6358":
        """Return the restriction that passes a standard nominal flow qNn [m^3/s ANR], from 6 to 5 bar gauge at 20 degC.

        1 l/min is 1/60000 m^3/s. The ambient pressure is one bar.
        """
        unit = ISO6358(
            sonic_conductance=1e-8, critical_pressure_ratio=critical_pressure_ratio, subsonic_index=subsonic_index
        )
        conductance = 1e-8 * positive("flow", flow, "m^3/s") / unit.volume_flow(7e5, 6e5)
        return ISO6358(
            sonic_conductance=conductance,
            critical_pressure_ratio=critical_pressure_ratio,
            subsonic_index=subsonic_index,
        )

    @staticmethod
    def from_kv(kv: float, critical_pressure_ratio: float = 0.3) -> "ISO6358":
        """Return the restriction whose flow at small drops is that of a water valve with Kv [m^3/h at 1 bar].

        At small drops air is a liquid of its own density: C rho_0 sqrt(2 / (1 - b)) = A sqrt(2 / (R T_0)). Cv = 1 is
        Kv = 0.865; `KV_OF_CV`.
        """
        air = Gas()
        density_root = math.sqrt((1 - critical_pressure_ratio) / (air.specific_gas_constant * ANR_TEMPERATURE))
        conductance = positive("kv", kv, "m^3/h") * AREA_OF_KV * density_root / ANR_DENSITY
        return ISO6358(sonic_conductance=conductance, critical_pressure_ratio=critical_pressure_ratio)

    @staticmethod
    def in_series(*restrictions: "ISO6358") -> "ISO6358":
        """Return one restriction for several in a row, by 1/C^3 = sum 1/C_i^3 and b = 1 - C^2 sum (1 - b_i) / C_i^2.

        The rule for b makes the drop of small flows the sum of the drops; that for C is an empirical one (Eckersten).
        Flow paths solve two restrictions in series exactly; this is for the fixed ones among more.
        """
        if not restrictions:
            raise ValueError("restrictions: found none, expected at least one")
        if len(restrictions) == 1:
            return restrictions[0]
        if any(one.sonic_conductance == 0.0 or one.cracking_pressure for one in restrictions):
            raise ValueError("restrictions: found one that is shut or a check valve, expected open ones")
        conductance = sum(one.sonic_conductance**-3 for one in restrictions) ** (-1 / 3)
        drop = sum((1 - one.critical_pressure_ratio) / one.sonic_conductance**2 for one in restrictions)
        ratio = max(0.0, 1 - conductance**2 * drop)
        return ISO6358(sonic_conductance=conductance, critical_pressure_ratio=ratio)

    @cached_property
    def _record(self) -> RestrictionFields:
        # Kernels take a law as they find it in a machine's record.
        record: Any = np.array([self.fields(1.0)], layout(RestrictionFields))[0]
        return record

    @property
    def area(self) -> float:
        """Effective area C A of an ideal nozzle with the same choked flow [m^2]."""
        return self.sonic_conductance * AREA_OF_CONDUCTANCE

    def volume_flow(self, upstream: float, downstream: float, temperature: float = ANR_TEMPERATURE) -> float:
        """Return the flow of air in its volume at ANR [m^3/s], from absolute pressures [Pa] and upstream temperature.

        Negative where `downstream` is the higher pressure.
        """
        if positive("upstream", upstream, "Pa") < positive("downstream", downstream, "Pa"):
            return -self.volume_flow(downstream, upstream, temperature)
        share = share_of_choked(float(upstream), float(downstream), self._record).share
        root = math.sqrt(ANR_TEMPERATURE / positive("temperature", temperature, "K"))
        return self.sonic_conductance * upstream * root * share

    def mass_flow(self, upstream: float, downstream: float, temperature: float = ANR_TEMPERATURE) -> float:
        """Return the flow of air [kg/s], as `volume_flow`."""
        return ANR_DENSITY * self.volume_flow(upstream, downstream, temperature)

    def fields(self, share: float) -> RestrictionFields:
        """Return the law as the compiled kernels read it, for a share of the area that is open."""
        return RestrictionFields(
            True,
            float(share),
            float(self.critical_pressure_ratio),
            float(self.subsonic_index),
            float(self.laminar_ratio),
            float(self.cracking_pressure),
        )
