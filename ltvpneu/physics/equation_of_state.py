"""Equations of state of CoolProp: a gas at rest, and expanded through a nozzle."""

import difflib
import math
from functools import lru_cache
from typing import Any, NamedTuple

from ltvpneu.errors import GasRangeError

Range = tuple[float, float]
STANDARD_PRESSURE = 1.01325e5


class Rest(NamedTuple):
    """A gas at rest, upstream of a nozzle."""

    density: float
    energy: float
    enthalpy: float
    entropy: float


class Throat(NamedTuple):
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


class EquationOfState:
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

    def at_rest(self, pressure: float, temperature: float) -> Rest:
        """Return the gas at a pressure [Pa] and a temperature [K]."""
        gas, library = self.gas, self.library
        gas.update(library.PT_INPUTS, pressure, temperature)
        # Again at the density found: CoolProp 8.0.0 leaves h and s of the iterate before, off by up to 2e-11 R T and R,
        # which shows in the flow between almost equal pressures.
        gas.update(library.DmassT_INPUTS, gas.rhomass(), temperature)
        return Rest(gas.rhomass(), gas.umass(), gas.hmass(), gas.smass())

    def throat(self, rest: Rest, temperature: float, pressure: float | None = None) -> Throat:
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
                return Throat(gas.p(), temperature, density * math.sqrt(2 * (rest.enthalpy - gas.hmass())))
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


@lru_cache(maxsize=64)
def limits(fluid: str, temperature: float, pressures: Range, temperatures: Range | None) -> Range:
    """Return the range of temperatures, chosen where none is given; the fluid is a gas in all of it."""
    equation = EquationOfState(fluid)
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


def _require_gas(equation: EquationOfState, fluid: str, pressure: float, temperature: float) -> None:
    if flaw := equation.flaw(pressure, temperature):
        raise GasRangeError(
            f"{fluid} at {pressure:g} Pa and {temperature:g} K: expected a gas, at rest and in a nozzle, but {flaw}. "
            "Choose ranges that are warmer or at lower pressures, within the limits of the equation of state.",
            pressure=pressure,
            temperature=temperature,
        )


@lru_cache(maxsize=64)
def ratios(fluid: str, temperature: float, pressure: float) -> tuple[float, float]:
    """Return c_p / c_v and r_c."""
    equation = EquationOfState(fluid)
    _require_gas(equation, fluid, pressure, temperature)
    rest = equation.at_rest(pressure, temperature)
    gamma = float(equation.gas.cpmass() / equation.gas.cvmass())
    return gamma, equation.throat(rest, temperature).pressure / pressure
