r"""Mass flow through a restriction and its two pressure slopes.

Isentropic orifice, eq. (5) of [Kunt1990]_ with its errata: the factor before the root is the upstream pressure p_i, the
whole bracket stands under the root (E1), and r_c = [2/(gamma+1)]^(gamma/(gamma-1)) (E2). Per effective area C A, with
r = p_k/p_i,

.. math:: M_f = p_i \sqrt{\frac{2\gamma}{(\gamma-1) R T_i} \left(r^{2/\gamma} - r^{(\gamma+1)/\gamma}\right)},
          \quad r \ge r_c; \qquad
          M_f = p_i \sqrt{\frac{\gamma}{R T_i} \left(\frac{2}{\gamma+1}\right)^{(\gamma+1)/(\gamma-1)}},
          \quad r \le r_c

The slopes are (8k-n): with alpha the flow into chamber k and beta = -d(alpha)/dp_k, in the readings E7 and E7b. At
equal pressures the unchoked slope is infinite; the functions return it so, and the caller decides.

M_f is homogeneous of degree one in (p_i, p_k), so by Euler's theorem dM_f/dp_i = (M_f - p_k dM_f/dp_k) / p_i.
"""

import math

from ltvpneu._compiled import compiled, inlined
from ltvpneu.physics.gas import GasConstants, GasState


@inlined
def mass_flux(upstream: float, downstream: float, temperature: float, gas: GasConstants) -> float:
    """Mass flow per effective area through an ideal nozzle [kg/(s m^2)], eq. (5).

    Parameters
    ----------
    upstream, downstream : float
        Absolute pressures [Pa], upstream not below downstream.
    temperature : float
        Upstream temperature [K].
    gas : GasConstants
    """
    if downstream <= gas.critical_pressure_ratio * upstream:
        return upstream * gas.choked / math.sqrt(temperature)
    # r^(2/g) - r^((g+1)/g) = w (w - r), w = r^(1/g).
    ratio = downstream / upstream
    if ratio < 0.99:
        w = ratio ** (1.0 / gas.heat_capacity_ratio)
        difference = w - ratio
    else:
        # log1p and expm1 keep the digits of the difference where the pressures almost agree.
        log_ratio = math.log1p((downstream - upstream) / upstream)
        w = math.exp(log_ratio / gas.heat_capacity_ratio)
        difference = ratio * math.expm1(-(1.0 - 1.0 / gas.heat_capacity_ratio) * log_ratio)
    return upstream * gas.unchoked * math.sqrt(w * abs(difference) / temperature)


@compiled
def mass_flux_slope(upstream: float, downstream: float, temperature: float, gas: GasConstants) -> float:
    """Slope dM_f(i,k)/dp_k of the nozzle's flow over the downstream pressure [s/m], never positive; -inf at r = 1.

    (8k-n), unchoked with erratum E7; choked 0, for a choked flow does not feel what is downstream.
    """
    if downstream <= gas.critical_pressure_ratio * upstream:
        return 0.0
    gamma = gas.heat_capacity_ratio
    flux = mass_flux(upstream, downstream, temperature, gas)
    if flux == 0.0:
        return -math.inf
    ratio = downstream / upstream
    w = ratio ** (1.0 / gamma)
    numerator = 2.0 / gamma * w * w / ratio - (gamma + 1.0) / gamma * w
    return gas.unchoked * gas.unchoked / temperature * numerator * upstream / (2.0 * flux)


@compiled
def intermediate_pressure(
    first: float, second: float, upstream: float, downstream: float, temperature: float, gas: GasConstants
) -> float:
    """Pressure between two restrictions in series that pass the same flow [Pa].

    `first` and `second` are effective areas [m^2], both above zero, in the direction of the flow. The difference of the
    squared flows is close to linear in the pressure sought, so safeguarded regula falsi converges in a few steps.
    """
    low, high = downstream, upstream
    at_low = (first * mass_flux(upstream, low, temperature, gas)) ** 2
    at_high = -((second * mass_flux(high, downstream, temperature, gas)) ** 2)
    middle = high
    for _ in range(200):
        middle = (low * at_high - high * at_low) / (at_high - at_low)
        value = (first * mass_flux(upstream, middle, temperature, gas)) ** 2 - (
            second * mass_flux(middle, downstream, temperature, gas)
        ) ** 2
        if value > 0.0:
            # Anderson-Bjorck: the weight of an end that stays is lowered, so that both ends move in.
            weight = 1.0 - value / at_low
            at_high *= weight if weight > 0.0 else 0.5
            converged = middle - low < 1e-15 * upstream
            low, at_low = middle, value
        elif value < 0.0:
            weight = 1.0 - value / at_high
            at_low *= weight if weight > 0.0 else 0.5
            converged = high - middle < 1e-15 * upstream
            high, at_high = middle, value
        else:
            return middle
        if converged or high - low < 1e-15 * upstream:
            break
    return middle


@inlined
def _forward(
    first: float, second: float, upstream: float, downstream: float, temperature: float, gas: GasConstants
) -> float:
    if first == 0.0 or second == 0.0 or upstream == downstream:
        return 0.0
    if math.isinf(second):
        return first * mass_flux(upstream, downstream, temperature, gas)
    middle = intermediate_pressure(first, second, upstream, downstream, temperature, gas)
    return _in_series(first, second, (upstream, middle, downstream), temperature, gas)


@compiled
def _in_series(
    first: float, second: float, pressures: tuple[float, float, float], temperature: float, gas: GasConstants
) -> float:
    """Flow through both, by whichever has the larger pressure drop: that has the smaller rounding error."""
    upstream, middle, downstream = pressures
    if upstream - middle > middle - downstream:
        return first * mass_flux(upstream, middle, temperature, gas)
    return second * mass_flux(middle, downstream, temperature, gas)


@compiled
def _forward_slope(
    first: float, second: float, upstream: float, downstream: float, temperature: float, gas: GasConstants
) -> float:
    if first == 0.0 or second == 0.0:
        return 0.0
    if math.isinf(second):
        return first * mass_flux_slope(upstream, downstream, temperature, gas)
    if upstream == downstream:
        return -math.inf
    middle = intermediate_pressure(first, second, upstream, downstream, temperature, gas)
    # So much wider that nothing drops across it, one of the two is none.
    if upstream == middle:
        return second * mass_flux_slope(upstream, downstream, temperature, gas)
    if middle == downstream:
        return first * mass_flux_slope(upstream, downstream, temperature, gas)
    down_first = first * mass_flux_slope(upstream, middle, temperature, gas)
    down_second = second * mass_flux_slope(middle, downstream, temperature, gas)
    flow = _in_series(first, second, (upstream, middle, downstream), temperature, gas)
    up_second = (flow - downstream * down_second) / middle
    # Implicit function theorem on first M(p_u, p_m) = second M(p_m, p_d).
    return down_first * down_second / (down_first - up_second)


@inlined
def mass_flow(first: float, second: float, source: GasState, chamber: GasState, gas: GasConstants) -> float:
    """Mass flow into a chamber through one restriction, or two in series [kg/s]; negative when it leaves, eq. (6).

    Parameters
    ----------
    first, second : float
        Effective areas C A [m^2] on the side of the source and of the chamber; `second` infinite where there is none.
    source, chamber : GasState
    gas : GasConstants
    """
    if source.pressure >= chamber.pressure:
        return _forward(first, second, source.pressure, chamber.pressure, source.temperature, gas)
    return -_backward(first, second, source, chamber, gas)


@inlined
def _backward(first: float, second: float, source: GasState, chamber: GasState, gas: GasConstants) -> float:
    if math.isinf(second):
        return _forward(first, second, chamber.pressure, source.pressure, chamber.temperature, gas)
    return _forward(second, first, chamber.pressure, source.pressure, chamber.temperature, gas)


@compiled
def mass_flow_slopes(
    first: float, second: float, source: GasState, chamber: GasState, gas: GasConstants
) -> tuple[float, float]:
    """Slopes of `mass_flow` over the pressure of the source and of the chamber [kg/(s Pa)], temperatures held.

    The second is -C A beta of (8k-n). At equal pressures they are +inf and -inf.
    """
    if source.pressure >= chamber.pressure:
        by_chamber = _forward_slope(first, second, source.pressure, chamber.pressure, source.temperature, gas)
        flow = _forward(first, second, source.pressure, chamber.pressure, source.temperature, gas)
        return (flow - chamber.pressure * by_chamber) / source.pressure, by_chamber
    if math.isinf(second):
        by_source = -_forward_slope(first, second, chamber.pressure, source.pressure, chamber.temperature, gas)
    else:
        by_source = -_forward_slope(second, first, chamber.pressure, source.pressure, chamber.temperature, gas)
    flow = -_backward(first, second, source, chamber, gas)
    return by_source, (flow - source.pressure * by_source) / chamber.pressure
