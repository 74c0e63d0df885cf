r"""Floquet analysis of the nonlinear model's own orbit: how a small disturbance fares over it.

Between events a disturbance follows d' = J(t) d along the orbit, J the full tangent in the mode of motion. Each
interval of the integrator is taken in parts by Magnus' method of fourth order,

.. math:: \Omega = \tfrac h2 (J_1 + J_2) + \tfrac{\sqrt3}{12} h^2 (J_2 J_1 - J_1 J_2), \qquad d \to e^\Omega d

with J at the two Gauss points. Where the piston stops, reverses, breaks away or meets an end stop, a disturbance also
shifts the instant, and jumps by the saltation matrix

.. math:: S = D R + \frac{(f^+ - D R f^-)\, \nabla h'}{\nabla h' f^-}

with the rates f before and after, the event function h and the reset R (at an end stop: v = 0) [Leine2004]_.

.. [Leine2004] R. I. Leine and H. Nijmeijer, "Dynamics and Bifurcations of Non-Smooth Mechanical Systems", Springer,
   2004.
"""

import math

import numpy as np

from ltvpneu._arrays import FloatArray, read_only
from ltvpneu.models.machine.chord import Tangent, tangent_at
from ltvpneu.models.machine.dynamics import STUCK, state_rate
from ltvpneu.models.machine.machine import Machine
from ltvpneu.models.machine.openings import pieces_of, write_areas
from ltvpneu.models.machine.piston import is_pressed
from ltvpneu.models.machine.records import N_INPUTS
from ltvpneu.models.nonlinear.polynomial import PolynomialTrajectory
from ltvpneu.models.nonlinear.simulation import mode_labelled
from ltvpneu.periodic.floquet import Floquet, Maps, orbit_multipliers
from ltvpneu.periodic.orbit import Orbit
from ltvpneu.periodic.propagate import exponentials

PARTS = 4
"""Parts that each interval of the integrator is taken in."""
NEAREST_SOURCE = 1e-5
"""Relative distance from a source's pressure within which the chord to it replaces an ever steeper slope [-]."""
NEUTRAL = 1e-6
"""Distance of a modulus from 1 within which a disturbance neither grows nor decays [-]."""


def orbit_floquet(machine: Machine, orbit: Orbit) -> Floquet:
    """Return the Floquet multipliers of an orbit found by `nonlinear_orbit`, with saltation where the piston sticks.

    Where stiction holds the piston its position stays where it is put: a multiplier of one. Where it is pressed on an
    end stop, a disturbance into the stroke returns, and its multiplier is zero.

    Parameters
    ----------
    machine : Machine
        The orbit's.
    orbit : Orbit

    Raises
    ------
    TypeError
        The orbit is a linear model's; `cycle_floquet` of the model is what is wanted there.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> machine = lp.load_machine("kunt_singh_1990")
    >>> print(f"{lp.orbit_floquet(machine, lp.nonlinear_orbit(machine, 8.0)).spectral_radius:.3f}")
    0.224
    """
    trajectory = orbit.trajectory
    if not isinstance(trajectory, PolynomialTrajectory):
        raise TypeError(
            f"orbit: found one of {orbit.name}, a linear model; expected one of nonlinear_orbit. Of a linear model, "
            "take lp.cycle_floquet(model)"
        )
    machine = machine.at(1 / orbit.system_period)
    return orbit_multipliers(orbit, _Factors(machine, orbit, trajectory).maps(), NEUTRAL)


class _Factors:
    """The disturbance's maps over one orbit, in scaled states."""

    def __init__(self, machine: Machine, orbit: Orbit, trajectory: PolynomialTrajectory) -> None:
        self.machine, self.orbit, self.trajectory = machine, orbit, trajectory
        self.n, self.scales = len(machine.states), machine.state_scales
        self.pieces = pieces_of(machine.openings, orbit.system_period)
        # A creep to the edge of a stiction band is rest: set beside it, within the band, the piston stays.
        labels = orbit.step_labels if orbit.is_isolated else ("stuck",) * len(orbit.step_labels)
        self.modes = [mode_labelled(label) for label in labels]

    def maps(self) -> Maps:
        """Return the maps in the order of time."""
        found, durations, begins = list[FloatArray](), list[float](), list[int]()

        def at_once(maps: list[FloatArray]) -> None:
            found.extend(maps)
            durations.extend([0.0] * len(maps))

        starts, spans = self.trajectory.starts, self.trajectory.spans
        step = np.clip(
            np.searchsorted(self.orbit.step_times, starts + 1e-9 * spans, side="right") - 1, 0, len(self.modes) - 1
        )
        pressed = False
        for interval in range(starts.size):
            mode = self.modes[step[interval]]
            if interval == 0 or step[interval] != step[interval - 1]:
                begins.append(len(found))
                if interval > 0:
                    at_once(self._saltation(interval, self.modes[step[interval - 1]], mode))
                elif mode == STUCK:
                    # A small velocity is braked at once, having moved the piston by its square only.
                    at_once([np.diag([1.0, 0.0, *np.ones(self.n - 2)])])
            pressed = pressed and mode == STUCK
            if mode == STUCK and not pressed and is_pressed(self._state(interval, 0.0), self.machine.record):
                pressed = True
                at_once([self._back_on_stop(interval)])
            found += list(self._smooth(interval, mode))
            durations += [float(spans[interval]) / PARTS] * PARTS
        at_once(self._saltation(0, self.modes[-1], self.modes[0]))
        return Maps(
            factors=read_only(np.array(found)),
            durations=read_only(np.array(durations)),
            starts=np.array(begins, dtype=np.int64),
            scales=self.scales,
        )

    def _back_on_stop(self, interval: int) -> FloatArray:
        """Return what becomes of a disturbance where the piston is pressed on a stop.

        Set beside it the piston goes back at once, and sweeps the chambers' volumes on the way.
        """
        tangent = self._tangent(self._state(interval, 0.0), self._areas(self.trajectory.starts[interval]), STUCK)
        jump = np.diag([0.0, 0.0, *np.ones(self.n - 2)])
        jump[2:, 0] = -tangent.sweeps[2:] * self.scales[0] / self.scales[2:]
        return jump

    def _state(self, interval: int, time: float) -> FloatArray:
        return time ** np.arange(5) @ self.trajectory.coefficients[interval]

    def _areas(self, time: float) -> FloatArray:
        within = math.fmod(time, self.orbit.system_period)
        piece = max(int(np.searchsorted(self.pieces["begin"], within, side="right")) - 1, 0)
        areas = np.empty((2, len(self.machine.path_fields)))
        write_areas(within, self.pieces[piece], areas)
        return areas

    def _tangent(self, state: FloatArray, areas: FloatArray, mode: int) -> Tangent:
        n = self.n
        found = Tangent(np.empty((n, n)), np.empty((n, N_INPUTS)), np.empty(n), np.empty(n), np.empty(n))
        tangent_at(state, areas, mode, self.machine.record, NEAREST_SOURCE, found)
        return found

    def _scaled_tangent(self, state: FloatArray, areas: FloatArray, mode: int) -> FloatArray:
        return self._tangent(state, areas, mode).A * self.scales / self.scales[:, None]

    def _smooth(self, interval: int, mode: int) -> FloatArray:
        start, h = self.trajectory.starts[interval], self.trajectory.spans[interval] / PARTS
        exponents = np.empty((PARTS, self.n, self.n))
        for part in range(PARTS):
            times = [(part + 0.5 + side * math.sqrt(3) / 6) * h for side in (-1, 1)]
            one, two = (self._scaled_tangent(self._state(interval, t), self._areas(start + t), mode) for t in times)
            exponents[part] = 0.5 * h * (one + two) + math.sqrt(3) / 12 * h * h * (two @ one - one @ two)
        return exponentials(exponents)

    def _rate(self, state: FloatArray, areas: FloatArray, mode: int) -> FloatArray:
        rate = np.empty(self.n)
        state_rate(state, areas, mode, self.machine.record, rate)
        return rate / self.scales

    def _saltation(self, interval: int, before: int, after: int) -> list[FloatArray]:
        """Return the jump of a disturbance at the start of an interval, if there is one."""
        last = interval - 1 if interval > 0 else self.trajectory.starts.size - 1
        arriving = self._state(last, float(self.trajectory.spans[last]))
        leaving = self.trajectory.coefficients[interval, 0]
        if before == after and abs(arriving[1] - leaving[1]) <= 1e-6 * self.scales[1]:
            return []
        areas = self._areas(float(self.trajectory.starts[last] + self.trajectory.spans[last]) * (1 - 1e-12))
        rate_before, rate_after = self._rate(arriving, areas, before), self._rate(leaving, areas, after)
        machine, n = self.machine, self.n
        gradient, reset = np.zeros(n), np.eye(n)
        at_stop = leaving[0] in (machine.cylinder.lower_stop, machine.cylinder.upper_stop)
        if before == STUCK:
            # Breaks away where the external force reaches what holds it.
            gradient[0] = -machine.load.spring_stiffness
            gradient[2 : 2 + machine.n_volumes] = [
                volume.push_area - after * volume.friction_area for volume in machine.volume_fields
            ]
            gradient *= self.scales
        elif at_stop and abs(arriving[1]) > 1e-6 * self.scales[1]:
            gradient[0] = 1.0
            reset[0, 0] = reset[1, 1] = 0.0
        else:
            gradient[1] = 1.0
        along = float(gradient @ rate_before)
        if along == 0.0:
            return []
        jump = reset + np.outer(rate_after - reset @ rate_before, gradient) / along
        return [jump]
