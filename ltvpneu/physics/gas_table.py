"""Table of a real gas: how it is built from an equation of state, and the compiled laws that read it.

Each series is a Chebyshev interpolant in p, ln T and phi, cut where coefficients fall below a tolerance. Over T it
stays in Chebyshev polynomials: near its critical temperature the equation of carbon dioxide has narrow terms that take
thirty of them. Over p coefficients fall so fast that powers lose no digits, and are quicker.
"""

import math
from functools import lru_cache

import numpy as np
from numpy.polynomial.chebyshev import cheb2poly
from scipy.fft import dctn

from ltvpneu._arrays import FloatArray, read_only
from ltvpneu._compiled import compiled
from ltvpneu.errors import GasRangeError
from ltvpneu.physics.equation_of_state import EquationOfState, Range
from ltvpneu.physics.properties import Properties

# Places in a table: ends of the ranges, R, middle and scale of p and of ln T, and where the five series begin.
LOWEST_P, HIGHEST_P, LOWEST_T, HIGHEST_T, R_GAS, P_MIDDLE, P_SCALE, T_MIDDLE, T_SCALE = range(9)
DENSITY, ENERGY, CHOKED, CRITICAL, UNCHOKED, HEADER = range(9, 15)
# Largest coefficient dropped from each: of U per kelvin of the lowest temperature, and of w a larger one, for it counts
# with (1 - phi) phi^2 <= 0.15.
TOLERANCES = (2e-10, 2e-10, 5e-10, 1e-9, 3e-8)
# Nodes over temperature and pressure, tried in turn until the coefficients die away; over phi 12 always do.
NODES = ((24, 14), (48, 20), (96, 26))
PHI_NODES = 12


@compiled
def _place(pressure: float, temperature: float, table: FloatArray) -> tuple[float, float]:
    """Return p and ln T, scaled to [-1, 1]."""
    x = (pressure - table[P_MIDDLE]) * table[P_SCALE]
    return x, (math.log(temperature) - table[T_MIDDLE]) * table[T_SCALE]


@compiled
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


@compiled
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


def _nodes(n: int, low: float, high: float) -> FloatArray:
    return 0.5 * (low + high) + 0.5 * (high - low) * np.cos(np.pi * (np.arange(n) + 0.5) / n)


def _sampled(equation: EquationOfState, temperatures: FloatArray, pressures: FloatArray) -> list[FloatArray]:
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
def gas_table(fluid: str, pressures: Range, temperatures: Range) -> FloatArray:
    """Return the table of a fluid over ranges of pressure [Pa] and temperature [K], shape (n,)."""
    equation = EquationOfState(fluid)
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
