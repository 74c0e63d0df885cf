r"""A real gas: density, energy and nozzle flow of CoolProp's equations of state, tabulated for compiled laws.

The equations are the reference ones, Helmholtz energies over density and temperature: air [Lemmon2000]_, nitrogen
[Span2000]_, carbon dioxide [SpanWagner1996]_, helium [OrtizVega2019]_ and the other fluids of CoolProp [Bell2014]_. Too
slow for a model's inner loop, they are interpolated once:

.. math:: \rho = \frac{p}{R T} D(p, T), \qquad u = R\,U(p, T)

The flow is that of an isentropic nozzle, as the ideal gas's: from rest at (p, T), with enthalpy h_0 and entropy s_0,

.. math:: M_f = \max_{p_t \ge p_k} \rho \sqrt{2 (h_0 - h)}, \quad s = s_0

It is choked, M_f = M_c, where p_k is at most r_c p: the throat then runs at the speed of sound. Two series hold
r_c(p, T) and psi = M_c sqrt(R T) / p. Between r_c and one, with phi = (p_k / p - r_c) / (1 - r_c),

.. math:: (M_f / M_c)^2 = 1 - \varphi^2 + (1 - \varphi) \varphi^2 w(p, T, \varphi)

which, whatever w is, meets the choked flow with its slope and ends in zero at equal pressures. w = 0 is an ellipse; w
is below 0.1 for the four gases above at room temperature, so that a short series gives many digits.

Each series is a Chebyshev interpolant in p, ln T and phi, cut where coefficients fall below a tolerance. Over T it
stays in Chebyshev polynomials: near its critical temperature the equation of carbon dioxide has narrow terms that take
thirty of them. Over p coefficients fall so fast that powers lose no digits, and are quicker.

References
----------
.. [Lemmon2000] Lemmon, E. W. et al., J. Phys. Chem. Ref. Data, 2000.
.. [Span2000] Span, R. et al., J. Phys. Chem. Ref. Data, 2000.
.. [SpanWagner1996] Span, R. and Wagner, W., J. Phys. Chem. Ref. Data, 1996.
.. [OrtizVega2019] Ortiz Vega, D. O. et al., J. Phys. Chem. Ref. Data, 2019.
.. [Bell2014] Bell, I. H., Wronski, J., Quoilin, S. and Lemort, V., "Pure and Pseudo-pure Fluid Thermophysical Property
   Evaluation and the Open-Source Thermophysical Property Library CoolProp", Ind. Eng. Chem. Res. 53, 2014, 2498-2508.
"""

import difflib
import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple, final

import numpy as np
from numpy.polynomial.chebyshev import cheb2poly
from scipy.fft import dctn

from ltvpneu._arrays import FloatArray, finite, positive, read_only
from ltvpneu._compiled import compiled, inlined
from ltvpneu.errors import GasRangeError
from ltvpneu.physics.properties import REAL, Properties

Range = tuple[float, float]

STANDARD_PRESSURE = 1.01325e5
# Places in a table: ends of the ranges, R, middle and scale of p and of ln T, and where the five series begin.
LOWEST_P, HIGHEST_P, LOWEST_T, HIGHEST_T, R_GAS, P_MIDDLE, P_SCALE, T_MIDDLE, T_SCALE = range(9)
DENSITY, ENERGY, CHOKED, CRITICAL, UNCHOKED, HEADER = range(9, 15)
# Largest coefficient dropped from each: of U per kelvin of the lowest temperature, and of w a larger one, for it counts
# with (1 - phi) phi^2 <= 0.15.
TOLERANCES = (2e-10, 2e-10, 5e-10, 1e-9, 3e-8)
# Nodes over temperature and pressure, tried in turn until the coefficients die away; over phi 12 always do.
NODES = ((24, 14), (48, 20), (96, 26))
PHI_NODES = 12


class InterpolationError(NamedTuple):
    """Largest differences found between a table and its equation of state [-]."""

    density: float
    """Relative."""
    energy: float
    """Of the internal energy, over R T."""
    flux: float
    """Relative, choked and unchoked."""
    critical_ratio: float
    """Relative."""


@final
@dataclass(frozen=True, kw_only=True)
class RealGas:
    """A real gas at the temperature of its surroundings, tabulated over pressure and temperature.

    Only the gas at rest has to be inside the ranges: in the throat of a nozzle it is colder and at a lower pressure.

    Parameters
    ----------
    fluid : str
        CoolProp's name of a pure fluid, or "Air".
    temperature : float
        Of the supply, the return and the surroundings [K].
    pressure_range : tuple of float
        Lowest and highest absolute pressure [Pa].
    temperature_range : tuple of float, optional
        Lowest and highest temperature [K]. By default 0.6 to 1.8 times `temperature`, or less where the gas would
        condense in a nozzle or the equation of state ends: see `temperature_limits`.

    Raises
    ------
    ImportError
        CoolProp is not installed.
    ValueError
        A fluid that CoolProp does not know, or a range that does not rise from above zero.
    GasRangeError
        In the ranges, or in a nozzle fed from them, the fluid is not a gas; or `temperature` is outside.
    """

    fluid: str
    temperature: float = 293.15
    pressure_range: Range = (0.2e5, 20e5)
    temperature_range: Range | None = None

    def __post_init__(self) -> None:
        positive("temperature", self.temperature, "K")
        object.__setattr__(self, "pressure_range", _rising("pressure_range", self.pressure_range, "Pa"))
        if self.temperature_range is not None:
            object.__setattr__(self, "temperature_range", _rising("temperature_range", self.temperature_range, "K"))
        coldest, hottest = self.temperature_limits
        if not coldest <= self.temperature <= hottest:
            raise GasRangeError(
                f"temperature: found {self.temperature:g} K, expected {coldest:g} to {hottest:g} K, the range of the "
                "table. The gas of the supply and of the surroundings must be inside: widen temperature_range.",
                pressure=self.pressure_range[1],
                temperature=self.temperature,
            )

    @property
    def kind(self) -> int:
        """Which laws the compiled kernels take."""
        return REAL

    def expect_inside(self, name: str, pressure: float) -> None:
        """Raise `GasRangeError` unless a pressure [Pa] lies in the table's range; `name` is whose it is."""
        low, high = self.pressure_range
        if not low <= pressure <= high:
            raise GasRangeError(
                f"{name}: found {pressure:g} Pa, expected {low:g} to {high:g} Pa, the pressure_range of {self.fluid}. "
                "Give RealGas a wider one, with room for what chambers reach beyond their sources.",
                pressure=pressure,
                temperature=self.temperature,
            )

    @property
    def temperature_limits(self) -> Range:
        """Lowest and highest temperature of the table [K]: `temperature_range`, or its default."""
        return _limits(self.fluid, self.temperature, self.pressure_range, self.temperature_range)

    @property
    def specific_gas_constant(self) -> float:
        """R_g of the equation of state [J/(kg K)]."""
        return float(self.table[R_GAS])

    @property
    def heat_capacity_ratio(self) -> float:
        """c_p / c_v at `temperature` and 1.01325 bar [-]."""
        return _ratios(self.fluid, self.temperature)[0]

    @property
    def critical_pressure_ratio(self) -> float:
        """r_c below which the flow from `temperature` and 1.01325 bar is choked [-]."""
        return _ratios(self.fluid, self.temperature)[1]

    @property
    def table(self) -> FloatArray:
        """What the compiled laws need, shape (n,), read-only; equal gases share it."""
        return _table(self.fluid, self.pressure_range, self.temperature_limits)

    @property
    def interpolation_error(self) -> InterpolationError:
        """Largest errors of `table` against the equation of state, measured at 400 states off its nodes."""
        return _interpolation_error(self.fluid, self.pressure_range, self.temperature_limits)


@inlined
def _place(pressure: float, temperature: float, table: FloatArray) -> tuple[float, float]:
    """Return p and ln T, scaled to [-1, 1]."""
    x = (pressure - table[P_MIDDLE]) * table[P_SCALE]
    return x, (math.log(temperature) - table[T_MIDDLE]) * table[T_SCALE]


@inlined
def _plane(table: FloatArray, start: int, x: float, y: float) -> tuple[float, float, float, float, float, float, int]:
    """Return f, f_x, f_y, f_xx, f_xy, f_yy of a series, and where it ends; what a caller drops costs it nothing."""
    n_rows, length, at = int(table[start]), int(table[start + 1]), start + 1
    f, f_x, f_y, f_xx, f_xy, f_yy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    # T_j(y) and T_j+1(y), with their slopes.
    now, now_y, now_yy = 1.0, 0.0, 0.0
    after, after_y, after_yy = y, 1.0, 0.0
    for _ in range(n_rows):
        g, g_x, g_xx = 0.0, 0.0, 0.0
        for i in range(at + length, at, -1):
            g_xx = g_xx * x + 2.0 * g_x
            g_x = g_x * x + g
            g = g * x + table[i]
        f += g * now
        f_x += g_x * now
        f_y += g * now_y
        f_xx += g_xx * now
        f_xy += g_x * now_y
        f_yy += g * now_yy
        now_yy, after_yy = after_yy, 4.0 * after_y + 2.0 * y * after_yy - now_yy
        now_y, after_y = after_y, 2.0 * (after + y * after_y) - now_y
        now, after = after, 2.0 * y * after - now
        at += length
    return f, f_x, f_y, f_xx, f_xy, f_yy, at + 1


@inlined
def _unchoked(table: FloatArray, x: float, y: float, phi: float) -> tuple[float, float, float, float]:
    """Return w, w_x, w_y, w_phi: a series over pressure and temperature for each Chebyshev polynomial of phi."""
    start = int(table[UNCHOKED])
    at = start + 1
    z = 2.0 * phi - 1.0
    w, w_x, w_y, w_phi = 0.0, 0.0, 0.0, 0.0
    now, now_z, after, after_z = 1.0, 0.0, z, 1.0
    for _ in range(int(table[start])):
        f, f_x, f_y, _xx, _xy, _yy, at = _plane(table, at, x, y)
        w += f * now
        w_x += f_x * now
        w_y += f_y * now
        w_phi += 2.0 * f * now_z
        now_z, after_z = after_z, 2.0 * (after + z * after_z) - now_z
        now, after = after, 2.0 * z * after - now
    return w, w_x, w_y, w_phi


@compiled
def in_table(pressure: float, temperature: float, table: FloatArray) -> bool:
    """Whether a state of the gas at rest [Pa, K] is inside the table; outside it the laws extrapolate, and badly."""
    in_pressure = table[LOWEST_P] <= pressure <= table[HIGHEST_P]
    return in_pressure and table[LOWEST_T] <= temperature <= table[HIGHEST_T]


@compiled
def real_properties(pressure: float, temperature: float, table: FloatArray) -> Properties:
    """Density and internal energy of a real gas, with the exact slopes of their series.

    Parameters
    ----------
    pressure, temperature : float
        Of the gas at rest [Pa, K], inside the table.
    table : ndarray, shape (n,)
        `RealGas.table`.
    """
    p, T, R = pressure, temperature, table[R_GAS]
    x, y = _place(p, T, table)
    # y is a logarithm: y_T = scale / T, y_TT = -y_T / T.
    x_p, y_T = table[P_SCALE], table[T_SCALE] / T
    D, D_x, D_y, D_xx, D_xy, D_yy, _ = _plane(table, int(table[DENSITY]), x, y)
    U, U_x, U_y, U_xx, U_xy, U_yy, _ = _plane(table, int(table[ENERGY]), x, y)
    D_p, D_T, RT = D_x * x_p, D_y * y_T, R * T
    D_TT = (D_yy * y_T - D_y / T) * y_T
    rho_p = (D + p * D_p) / RT
    return Properties(
        rho=p * D / RT,
        rho_p=rho_p,
        rho_T=p * (D_T - D / T) / RT,
        rho_pp=(2.0 * D_p + p * D_xx * x_p * x_p) / RT,
        rho_pT=(D_T + p * D_xy * x_p * y_T) / RT - rho_p / T,
        rho_TT=p * (D_TT - 2.0 * (D_T - D / T) / T) / RT,
        u=R * U,
        u_p=R * U_x * x_p,
        u_T=R * U_y * y_T,
        u_pp=R * U_xx * x_p * x_p,
        u_pT=R * U_xy * x_p * y_T,
        u_TT=R * (U_yy * y_T - U_y / T) * y_T,
    )


@compiled
def real_critical_ratio(pressure: float, temperature: float, table: FloatArray) -> float:
    """r_c [-] of a nozzle fed at a pressure [Pa] and a temperature [K] inside the table."""
    x, y = _place(pressure, temperature, table)
    critical, _x, _y, _xx, _xy, _yy, _end = _plane(table, int(table[CRITICAL]), x, y)
    return critical


@compiled
def real_flux(upstream: float, downstream: float, temperature: float, table: FloatArray) -> float:
    """Mass flow of a real gas per effective area through an isentropic nozzle [kg/(s m^2)].

    Parameters
    ----------
    upstream, downstream : float
        Absolute pressures [Pa], upstream inside the table and not below downstream.
    temperature : float
        Upstream temperature [K], inside the table.
    table : ndarray, shape (n,)
        `RealGas.table`.
    """
    x, y = _place(upstream, temperature, table)
    psi, _x, _y, _xx, _xy, _yy, _end = _plane(table, int(table[CHOKED]), x, y)
    critical, _x, _y, _xx, _xy, _yy, _end = _plane(table, int(table[CRITICAL]), x, y)
    choked = upstream * psi / math.sqrt(table[R_GAS] * temperature)
    # 1 - phi, from the difference of the pressures, so that it keeps its digits where they almost agree.
    rest = (upstream - downstream) / (upstream * (1.0 - critical))
    if rest >= 1.0:
        return choked
    phi = 1.0 - rest
    w, _x, _y, _phi = _unchoked(table, x, y, phi)
    # Rounding may put a pressure between two restrictions a last digit above the upstream one.
    return choked * math.sqrt(abs(rest) * (1.0 + phi + phi * phi * w))


@compiled
def real_flux_slopes(
    upstream: float, downstream: float, temperature: float, table: FloatArray
) -> tuple[float, float, float, float]:
    """`real_flux` and its slopes over upstream and downstream pressure [s/m] and over temperature [kg/(s m^2 K)].

    At equal pressures 0, inf, -inf and 0; choked, the slope over the downstream pressure is 0.
    """
    if upstream == downstream:
        return 0.0, math.inf, -math.inf, 0.0
    x, y = _place(upstream, temperature, table)
    x_p, y_T = table[P_SCALE], table[T_SCALE] / temperature
    psi, psi_x, psi_y, _xx, _xy, _yy, _end = _plane(table, int(table[CHOKED]), x, y)
    critical, critical_x, critical_y, _xx, _xy, _yy, _end = _plane(table, int(table[CRITICAL]), x, y)
    root = math.sqrt(table[R_GAS] * temperature)
    choked = upstream * psi / root
    choked_p = (psi + upstream * psi_x * x_p) / root
    choked_T = upstream * (psi_y * y_T - 0.5 * psi / temperature) / root
    span = upstream * (1.0 - critical)
    rest = (upstream - downstream) / span
    if rest >= 1.0:
        return choked, choked_p, 0.0, choked_T
    phi = 1.0 - rest
    rest_p = downstream / upstream / span + rest * critical_x * x_p / (1.0 - critical)
    rest_T = rest * critical_y * y_T / (1.0 - critical)
    w, w_x, w_y, w_phi = _unchoked(table, x, y, phi)
    share = math.sqrt(abs(rest) * (1.0 + phi + phi * phi * w))
    # Slopes of share^2 over 1 - phi and over w.
    by_rest = 2.0 * phi - phi * (2.0 - 3.0 * phi) * w - rest * phi * phi * w_phi
    by_w = rest * phi * phi
    half = 0.5 * choked / share
    return (
        choked * share,
        choked_p * share + half * (by_rest * rest_p + by_w * w_x * x_p),
        -half * by_rest / span,
        choked_T * share + half * (by_rest * rest_T + by_w * w_y * y_T),
    )


class _Rest(NamedTuple):
    """A gas at rest, upstream of a nozzle."""

    density: float
    energy: float
    enthalpy: float
    entropy: float


class _Throat(NamedTuple):
    """The same gas in the nozzle's throat."""

    pressure: float
    temperature: float
    flux: float


def _coolprop() -> Any:
    try:
        import CoolProp
    except ImportError as error:
        raise ImportError("real gas needs CoolProp: pip install 'ltvpneu[gas]'") from error
    return CoolProp


class _EquationOfState:
    """One fluid of CoolProp, by two low-level states that are moved about: not for several threads."""

    def __init__(self, fluid: str) -> None:
        self.library = _coolprop()
        try:
            # The first looks for its phase, the second is told that it is a gas, which is quicker.
            self.any_phase, self.gas = (self.library.AbstractState("HEOS", fluid) for _ in range(2))
            is_known = len(self.gas.fluid_names()) == 1
        except (TypeError, ValueError):
            is_known = False
        if not is_known:
            raise ValueError(
                f"fluid: found {fluid!r}, expected a pure fluid of CoolProp or 'Air'; nearest: "
                f"{', '.join(self._nearest(fluid))}. Check the spelling; of mixtures only air is tabulated."
            )
        self.gas.specify_phase(self.library.iphase_gas)
        self.R = float(self.gas.gas_constant() / self.gas.molar_mass())

    def _nearest(self, fluid: str) -> list[str]:
        named = self.library.CoolProp
        names = named.get_global_param_string("FluidsList").split(",")
        aliases = [alias for name in names for alias in named.get_fluid_param_string(name, "aliases").split(",")]
        # The proper name last, so that it wins over an alias that differs in capitals only.
        known = {name.lower(): name for name in (*aliases, *names) if name}
        near = difflib.get_close_matches(str(fluid).lower(), known, cutoff=0.5)
        return [known[name] for name in near] or ["Air", "Nitrogen", "Helium", "CO2"]

    def at_rest(self, pressure: float, temperature: float) -> _Rest:
        gas, library = self.gas, self.library
        gas.update(library.PT_INPUTS, pressure, temperature)
        # Again at the density found: CoolProp 8.0.0 leaves h and s of the iterate before, off by up to 2e-11 R T and R,
        # which shows in the flow between almost equal pressures.
        gas.update(library.DmassT_INPUTS, gas.rhomass(), temperature)
        return _Rest(gas.rhomass(), gas.umass(), gas.hmass(), gas.smass())

    def throat(self, rest: _Rest, temperature: float, pressure: float | None = None) -> _Throat:
        """Expand from rest at a temperature, at constant entropy, to a pressure or else to the speed of sound.

        Newton's method on entropy and pressure, or entropy and h_0 - h = c^2 / 2, whose slope over density along an
        isentrope is -c^2 / rho times the fundamental derivative of gas dynamics.
        """
        gas, library, density = self.gas, self.library, rest.density
        for _ in range(40):
            gas.update(library.DmassT_INPUTS, density, temperature)
            p_T = gas.first_partial_deriv(library.iP, library.iT, library.iDmass)
            heat, sound = temperature / gas.cvmass(), gas.speed_sound() ** 2
            warmer = heat * (rest.entropy - gas.smass())
            if pressure is None:
                gap = rest.enthalpy - gas.hmass() - sound / 2
                denser = density * gap / (sound * gas.fundamental_derivative_of_gas_dynamics())
            else:
                denser = (pressure - gas.p() - p_T * warmer) / sound
            warmer += heat * p_T / density**2 * denser
            density, temperature = density + denser, temperature + warmer
            if abs(denser) < 1e-12 * density and abs(warmer) < 1e-12 * temperature:
                gas.update(library.DmassT_INPUTS, density, temperature)
                return _Throat(gas.p(), temperature, density * math.sqrt(2 * (rest.enthalpy - gas.hmass())))
        raise ValueError("no isentrope through a nozzle was found")

    def flaw(self, pressure: float, temperature: float) -> str:
        """Return why the fluid at rest, or in a nozzle fed with it, is no gas that the equation covers; else ''."""
        library, state = self.library, self.any_phase
        if temperature > state.Tmax() or pressure > state.pmax():
            return f"its equation of state ends at {state.Tmax():g} K and {state.pmax():g} Pa"
        try:
            state.update(library.PT_INPUTS, pressure, temperature)
            if state.phase() not in (
                library.iphase_gas,
                library.iphase_supercritical_gas,
                library.iphase_supercritical,
            ):
                return "it is a liquid there"
            if state.rhomass() > state.rhomass_critical():
                return "it is denser there than at its critical point"
            throat = self.throat(self.at_rest(pressure, temperature), temperature)
            if throat.temperature < state.Tmin():
                return f"in a nozzle it cools below {state.Tmin():g} K, where its equation of state ends"
            if throat.temperature < state.T_critical():
                state.update(library.QT_INPUTS, 1.0, throat.temperature)
                if throat.pressure >= state.p():
                    return f"in a nozzle it cools to {throat.temperature:.4g} K and condenses"
        except ValueError as error:
            return f"CoolProp finds none there ({error})"
        return ""


def _rising(name: str, ends: Any, unit: str) -> Range:
    try:
        low, high = (finite(name, end, unit) for end in ends)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name}: found {ends!r}, expected two numbers, lowest and highest ({error})") from None
    if not 0 < low < high:
        raise ValueError(
            f"{name}: found {low:g} to {high:g} {unit}, expected a range that rises from above zero. "
            "Absolute values are meant, the lower end first."
        )
    return low, high


@lru_cache(maxsize=64)
def _limits(fluid: str, temperature: float, pressures: Range, temperatures: Range | None) -> Range:
    """Return the range of temperatures, chosen where none is given; the fluid is a gas in all of it."""
    equation = _EquationOfState(fluid)
    coldest, hottest = temperatures or (0.6 * temperature, min(1.8 * temperature, equation.gas.Tmax()))
    for T in (temperature, hottest) if temperatures is None else (hottest, coldest):
        for p in pressures:
            _require_gas(equation, fluid, p, T)
    if temperatures is not None or not any(equation.flaw(p, coldest) for p in pressures):
        return coldest, hottest
    bad, good = coldest, temperature
    while good - bad > 1e-3 * good:
        middle = 0.5 * (bad + good)
        bad, good = (middle, good) if any(equation.flaw(p, middle) for p in pressures) else (bad, middle)
    # One per cent off the edge, where there is room: at the edge itself series are longest.
    return min(1.01 * good, temperature), hottest


def _require_gas(equation: _EquationOfState, fluid: str, pressure: float, temperature: float) -> None:
    if flaw := equation.flaw(pressure, temperature):
        raise GasRangeError(
            f"{fluid} at {pressure:g} Pa and {temperature:g} K: expected a gas, at rest and in a nozzle, but {flaw}. "
            "Choose ranges that are warmer or at lower pressures, within the limits of the equation of state.",
            pressure=pressure,
            temperature=temperature,
        )


@lru_cache(maxsize=64)
def _ratios(fluid: str, temperature: float) -> tuple[float, float]:
    """Return c_p / c_v and r_c at 1.01325 bar."""
    equation = _EquationOfState(fluid)
    _require_gas(equation, fluid, STANDARD_PRESSURE, temperature)
    rest = equation.at_rest(STANDARD_PRESSURE, temperature)
    gamma = float(equation.gas.cpmass() / equation.gas.cvmass())
    return gamma, equation.throat(rest, temperature).pressure / STANDARD_PRESSURE


def _nodes(n: int, low: float, high: float) -> FloatArray:
    return 0.5 * (low + high) + 0.5 * (high - low) * np.cos(np.pi * (np.arange(n) + 0.5) / n)


def _sampled(equation: _EquationOfState, temperatures: FloatArray, pressures: FloatArray) -> list[FloatArray]:
    """Return D, U, psi, r_c at the nodes over temperature and pressure, and w over phi, temperature and pressure."""
    phis = _nodes(PHI_NODES, 0.0, 1.0)
    planes = np.empty((4, temperatures.size, pressures.size))
    w = np.empty((phis.size, temperatures.size, pressures.size))
    for j, T in enumerate(temperatures):
        RT = equation.R * T
        for i, p in enumerate(pressures):
            rest = equation.at_rest(p, T)
            choked = equation.throat(rest, T)
            r_c = choked.pressure / p
            planes[:, j, i] = rest.density * RT / p, rest.energy / equation.R, choked.flux * math.sqrt(RT) / p, r_c
            for k, phi in enumerate(phis):
                flux = equation.throat(rest, T, p * (r_c + (1 - r_c) * phi)).flux
                w[k, j, i] = ((flux / choked.flux) ** 2 - 1 + phi**2) / ((1 - phi) * phi**2)
    return [*planes, w]


def _coefficients(values: FloatArray) -> FloatArray:
    """Return the coefficients of the Chebyshev interpolant of values at the nodes, along every axis."""
    series = np.asarray(dctn(values, type=2), dtype=np.float64) / values.size / 2**values.ndim
    for axis in range(values.ndim):
        np.moveaxis(series, axis, 0)[1:] *= 2
    return series


def _has_died_away(series: FloatArray, tolerance: float) -> bool:
    return all((np.abs(np.moveaxis(series, axis, 0)[-2:]) < tolerance).all() for axis in range(series.ndim))


def _packed(plane: FloatArray, tolerance: float) -> list[float]:
    """Flatten a series over temperature and pressure: how many rows, how long, then each row as powers of x."""
    rows, columns = np.nonzero(np.abs(plane) > tolerance)
    n_rows, length = int(np.max(rows, initial=-1)) + 1, int(np.max(columns, initial=-1)) + 1
    powers = np.zeros((n_rows, length))
    for row, found in zip(powers, plane, strict=False):
        in_powers = cheb2poly(found[:length])
        row[: in_powers.size] = in_powers
    return [float(n_rows), float(length), *powers.ravel().tolist()]


@lru_cache(maxsize=32)
def _table(fluid: str, pressures: Range, temperatures: Range) -> FloatArray:
    equation = _EquationOfState(fluid)
    log_ends = (math.log(temperatures[0]), math.log(temperatures[1]))
    tolerances = [
        tolerance * (temperatures[0] if i == ENERGY - DENSITY else 1) for i, tolerance in enumerate(TOLERANCES)
    ]
    for n_temperatures, n_pressures in NODES:
        nodes = np.exp(_nodes(n_temperatures, *log_ends)), _nodes(n_pressures, *pressures)
        series = [_coefficients(values) for values in _sampled(equation, *nodes)]
        if all(_has_died_away(*pair) for pair in zip(series, tolerances, strict=True)):
            break
    else:
        raise GasRangeError(
            f"{fluid} from {pressures[0]:g} to {pressures[1]:g} Pa and {temperatures[0]:g} to {temperatures[1]:g} K: "
            "expected properties smooth enough for a table, but their series do not die away. The range is too wide, "
            "or comes near the critical point; narrow it.",
            pressure=pressures[1],
            temperature=temperatures[0],
        )
    scales = [x for low, high in (pressures, log_ends) for x in (0.5 * (low + high), 2 / (high - low))]
    starts, body = [], list[float]()
    for values, tolerance in zip(series, tolerances, strict=True):
        starts.append(float(HEADER + len(body)))
        # w has a plane for each polynomial of phi, and says how many.
        body += [float(len(values))] if values.ndim == 3 else []
        for plane in values if values.ndim == 3 else [values]:
            body += _packed(plane, tolerance)
    return read_only(np.array([*pressures, *temperatures, equation.R, *scales, *starts, *body]))


@lru_cache(maxsize=32)
def _interpolation_error(fluid: str, pressures: Range, temperatures: Range) -> InterpolationError:
    equation, table = _EquationOfState(fluid), _table(fluid, pressures, temperatures)
    ranges = (pressures, temperatures, (0.0, 1.0))
    worst = np.zeros(4)
    # More states near the edges of the table, and near choking and equal pressures: there interpolants are worst.
    for shares in 0.5 - 0.5 * np.cos(np.pi * np.random.default_rng(0).random((400, 3))):
        p, T, phi = (low + (high - low) * float(share) for share, (low, high) in zip(shares, ranges, strict=True))
        rest = equation.at_rest(p, T)
        choked = equation.throat(rest, T)
        r_c = choked.pressure / p
        downstream = p * (r_c + (1 - r_c) * phi)
        flux = equation.throat(rest, T, downstream).flux
        found = real_properties(p, T, table)
        errors = (
            found.rho / rest.density - 1,
            (found.u - rest.energy) / (equation.R * T),
            max(abs(real_flux(p, downstream, T, table) / flux - 1), abs(real_flux(p, 0.0, T, table) / choked.flux - 1)),
            real_critical_ratio(p, T, table) / r_c - 1,
        )
        worst = np.maximum(worst, np.abs(errors))
    return InterpolationError(*worst.tolist())
