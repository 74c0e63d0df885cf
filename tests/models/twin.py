"""A slow, plain twin of the nonlinear model: scipy's integrator on equations written out once more, in Python.

It shares no code with the package but the machine's data: areas are evaluated by their windows, flows by eq. (5) as
printed after correction, the push of the air round the cylinder by the bore, stick, slip and stops by terminal events.
It restarts at each switching instant and at each event.
"""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import brentq

import ltvpneu as lp

STUCK = 0


def rods(cylinder: lp.Cylinder) -> tuple[float, float]:
    """Cross-sections of the rods: with its rod each side of the piston covers the whole bore."""
    bore = max(cylinder.piston_area_1, cylinder.piston_area_2)
    first, second = cylinder.rod_area_1, cylinder.rod_area_2
    if first is not None:
        bore = cylinder.piston_area_1 + first
    elif second is not None:
        bore = cylinder.piston_area_2 + second
    return (
        bore - cylinder.piston_area_1 if first is None else first,
        bore - cylinder.piston_area_2 if second is None else second,
    )


@dataclass
class Twin:
    machine: lp.Machine
    rtol: float = 1e-9
    method: str = "DOP853"

    def flux(self, up: float, down: float, temperature: float) -> float:
        g, R = self.machine.gas.heat_capacity_ratio, self.machine.gas.specific_gas_constant
        r = down / up
        if r <= (2 / (g + 1)) ** (g / (g - 1)):
            return up * math.sqrt(g / (R * temperature) * (2 / (g + 1)) ** ((g + 1) / (g - 1)))
        bracket = max(r ** (2 / g) - r ** ((g + 1) / g), 0.0)
        return up * math.sqrt(2 * g / ((g - 1) * R * temperature) * bracket)

    def passed(self, area: float, law: lp.ISO6358 | None, up: float, down: float, temperature: float) -> float:
        """Flow through an effective area, by the paper's nozzle or by ISO 6358 as its formulas stand."""
        if law is None:
            return area * self.flux(up, down, temperature)
        b, B, m, r = law.critical_pressure_ratio, law.laminar_ratio, law.subsonic_index, down / up
        choked = area * self.flux(up, 0.0, temperature)
        if r <= b:
            return choked
        if r <= B:
            return choked * (1 - ((r - b) / (1 - b)) ** 2) ** m
        edge, slope = (1 - ((B - b) / (1 - b)) ** 2) ** m, 2 * m * (B - b) / (1 + B - 2 * b)
        nearer = (1 + B) / 2
        if r >= nearer:
            return choked * edge * (1 - r) / (1 - B)
        # Between the line and the curve the cubic with the values and slopes of both at its ends.
        joint = CubicHermiteSpline([B, nearer], [edge, edge / 2], [-edge * slope / (1 - B), -edge / (1 - B)])
        return choked * float(joint(r))

    def through(self, areas, laws, up: tuple[float, float], down: float) -> float:
        (first, second), (law, second_law) = areas, laws
        if first == 0 or second == 0:
            return 0.0
        if second is None:
            return self.passed(first, law, up[0], down, up[1])
        if up[0] <= down * (1 + 1e-13):
            return 0.0

        def gap(middle: float) -> float:
            return self.passed(first, law, up[0], middle, up[1]) - self.passed(second, second_law, middle, down, up[1])

        return self.passed(first, law, up[0], brentq(gap, down, up[0], xtol=1e-9, rtol=1e-15), up[1])

    def temperature(self, chamber: str, pressure: float) -> float:
        n = getattr(self.machine.cylinder, f"polytropic_exponent_{chamber[-1]}")
        # A trial step of the integrator may go below zero.
        return self.machine.gas.temperature * (max(pressure, 1.0) / self.machine.exhaust_pressure) ** ((n - 1) / n)

    def flow(self, number: int, angle: float, pressure: float) -> float:
        machine, connection = self.machine, self.machine.connections[number]
        source = machine.supply_pressure if connection.source == "supply" else machine.exhaust_pressure
        path = number - len(machine.connections) + len(machine.flow_paths)
        there, back, fixed = None, None, None
        if path >= 0:
            there, fixed = machine.flow_paths[path].law, machine.flow_paths[path].in_series
            back = machine.flow_paths[path].law_back or there
        first = connection.first.at(angle)
        second = None if connection.second is None else connection.second.at(angle)
        if there is not None and back is not None:
            # The opening is that of the direction that lets more through.
            share = (there if source >= pressure else back).area / max(there.area, back.area)
            first, second = (first * share, None) if second is None else (first, second * share)
        laws = (there if source >= pressure else back, None) if fixed is None else (fixed, there)
        if source >= pressure:
            return self.through((first, second), laws, (source, machine.gas.temperature), pressure)
        inside = (pressure, self.temperature(connection.chamber, pressure))
        if second is None:
            return -self.through((first, None), laws, inside, source)
        return -self.through((second, first), (back, fixed), inside, source)

    def force(self, z: np.ndarray) -> float:
        m, c = self.machine, self.machine.cylinder
        pressures = {name: z[2 + k] for k, name in enumerate(c.chambers)}
        p1, p2 = (pressures.get(f"chamber_{i}", m.ambient_pressure) for i in (1, 2))
        push = (c.piston_area_1 - c.seal_friction_area) * p1 - (c.piston_area_2 + c.seal_friction_area) * p2
        rod_1, rod_2 = rods(c)
        return push + (rod_1 - rod_2) * m.ambient_pressure - m.load.spring_stiffness * z[0] + m.load.force

    def seals(self, z: np.ndarray) -> float:
        """Friction that the pressures add by pressing the seals on."""
        m = self.machine
        areas = {"chamber_1": m.load.friction_area_1, "chamber_2": m.load.friction_area_2}
        return sum(areas[name] * (z[2 + k] - m.ambient_pressure) for k, name in enumerate(m.cylinder.chambers))

    def rate(self, t: float, z: np.ndarray, period: float, mode: int) -> np.ndarray:
        m, c = self.machine, self.machine.cylinder
        angle = 2 * math.pi * t / period
        v = 0.0 if mode == STUCK else z[1]
        out = np.zeros(z.size)
        out[0] = v
        if mode != STUCK:
            out[1] = (
                self.force(z) - m.load.viscous_damping * v - (m.load.dry_friction + self.seals(z)) * mode
            ) / m.load.mass
        for k, name in enumerate(c.chambers):
            sign = 1 if name == "chamber_1" else -1
            area = sign * getattr(c, f"piston_area_{name[-1]}")
            volume = getattr(c, f"dead_volume_{name[-1]}") + area * z[0]
            n = getattr(c, f"polytropic_exponent_{name[-1]}")
            mass_flow = sum(
                self.flow(number, angle, z[2 + k]) for number, con in enumerate(m.connections) if con.chamber == name
            )
            heat = m.gas.specific_gas_constant * self.temperature(name, z[2 + k])
            out[2 + k] = n / volume * (heat * mass_flow - z[2 + k] * area * v)
        return out

    def mode(self, z: np.ndarray) -> int:
        if z[1] != 0:
            return int(np.sign(z[1]))
        load, c = self.machine.load, self.machine.cylinder
        hold = max(load.dry_friction, load.stiction) + self.seals(z)
        force = self.force(z)
        if z[0] >= c.upper_stop and force >= -hold:
            return STUCK
        if z[0] <= c.lower_stop and force <= hold:
            return STUCK
        return STUCK if abs(force) <= hold else int(np.sign(force))

    def switches(self) -> np.ndarray:
        angles = [c.first.angles for c in self.machine.connections]
        angles += [c.second.angles for c in self.machine.connections if c.second is not None]
        return np.unique(np.concatenate(angles).round(12)) / (2 * math.pi)

    def period(self, z: np.ndarray, frequency: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Integrate one valve period; return times, states and the last state."""
        T = 1 / frequency
        times, states = [], []
        edges = self.switches() * T
        for begin, end in pairwise(edges):
            t, inside = begin, np.nextafter(end, begin)
            while t < inside:
                z, t, part = self.stretch(z, t, inside, T)
                times.append(part[0])
                states.append(part[1])
        return np.concatenate(times), np.concatenate(states, axis=1), z

    def stretch(self, z, t, end, T):
        """Integrate with one mode up to the first event or the end."""
        load, c = self.machine.load, self.machine.cylinder
        mode = self.mode(z)
        hold = max(load.dry_friction, load.stiction)
        scale = self.machine.state_scales

        def reversal(_t, y):
            return 1.0 if _t < t + 1e-12 * T else mode * y[1]

        def breaks(_t, y):
            f, held = self.force(y), hold + self.seals(y)
            up = math.inf if y[0] >= c.upper_stop else held
            down = math.inf if y[0] <= c.lower_stop else held
            return min(up - f, f + down)

        events = [breaks] if mode == STUCK else ([reversal] if hold + load.friction_area_1 > 0 else [])
        if mode != STUCK and math.isfinite(c.upper_stop):
            events.append(lambda _t, y: c.upper_stop - y[0] if _t > t + 1e-12 * T else 1.0)
        if mode != STUCK and math.isfinite(c.lower_stop):
            events.append(lambda _t, y: y[0] - c.lower_stop if _t > t + 1e-12 * T else 1.0)
        for event in events:
            event.terminal, event.direction = True, -1
        found = solve_ivp(
            self.rate, (t, end), z, method=self.method, rtol=self.rtol, atol=self.rtol * scale, args=(T, mode),
            events=[_with_args(e) for e in events], dense_output=True,
        )  # fmt: skip
        assert found.success, found.message
        z = found.y[:, -1].copy()
        if found.status == 1:
            z[1] = 0.0
            for stop in (c.lower_stop, c.upper_stop):
                if abs(z[0] - stop) < 1e-9:
                    z[0] = stop
            if mode == STUCK:
                # Just past the threshold, so that it does not stick again.
                z[1] = math.copysign(1e-300, self.force(z))
        fine = np.linspace(found.t[0], found.t[-1], 200)
        return z, found.t[-1], (fine, found.sol(fine))

    def orbit(self, frequency: float, n_periods: int, start=None) -> dict[str, float]:
        """Simulate a number of periods; return figures of the last."""
        z = np.array(self.machine.rest_state if start is None else start)
        for _ in range(n_periods):
            t, y, after = self.period(z, frequency)
            closure = float(np.max(np.abs(after - z) / self.machine.state_scales))
            z = after
        mean = np.trapezoid(y, t, axis=1) * frequency
        return {"min": y.min(axis=1), "max": y.max(axis=1), "mean": mean, "closure": closure, "state": z}


def _with_args(event):
    def wrapped(t, y, *_):
        return event(t, y)

    wrapped.terminal, wrapped.direction = True, -1
    return wrapped
