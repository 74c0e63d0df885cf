"""Periodic orbits of the nonlinear model (3)-(7).

An orbit is what the machine settles on from its initial state, by default at rest at exhaust pressure. With stiction
it may be one of a band of resting positions, or repeat only after several valve periods; both are found and
reported.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from ltvpneu._arrays import FloatArray, positive, read_only, whole
from ltvpneu._clock import Deadline, deadline
from ltvpneu.errors import NotSettledError
from ltvpneu.models.machine.dynamics import STUCK
from ltvpneu.models.machine.machine import Machine, expect_machine
from ltvpneu.models.machine.openings import pieces_of
from ltvpneu.models.nonlinear.heading import Heading, look_ahead
from ltvpneu.models.nonlinear.integrator import OK, Outcome, Record, joined, log_of
from ltvpneu.models.nonlinear.method import DEFAULT, Method, settings_of
from ltvpneu.models.nonlinear.newton import nearest_orbit
from ltvpneu.models.nonlinear.period_map import PeriodMap
from ltvpneu.models.nonlinear.periods import integrate_period
from ltvpneu.models.nonlinear.polynomial import trajectory_of
from ltvpneu.models.nonlinear.rest import AT_EDGE, is_at_edge_of_band, rests_in_a_band, what_holds
from ltvpneu.models.nonlinear.runge_kutta import Run, new_run
from ltvpneu.models.nonlinear.settle import FINE, settle
from ltvpneu.models.nonlinear.simulation import initial_state_of
from ltvpneu.models.nonlinear.stopped import raise_stopped
from ltvpneu.periodic.orbits.orbit import Orbit

REPEATS = 1e3
"""How well an orbit of several periods repeats once more at least, over the tolerance [-]."""
NEARBY = 1e-2
"""Scaled distance from an orbit of several periods from which Newton's method is tried [-]."""


def nonlinear_orbit(  # noqa: PLR0913 - keyword-only, each with its default
    machine: Machine,
    frequency: float,
    initial_state: ArrayLike | None = None,
    *,
    method: Method = DEFAULT,
    max_periods: int = 5000,
    tolerance: float = 1e-7,
    stable_only: bool = True,
    max_seconds: float | None = None,
) -> Orbit:
    r"""Return the periodic orbit that the machine settles on.

    Parameters
    ----------
    machine : Machine
    frequency : float
        Switching frequency Omega_p [Hz].
    initial_state : array_like, shape (n_states,), optional
        Start [m, m/s, Pa]; by default at rest at zero, all chambers at exhaust pressure.
    method : DormandPrince or RungeKutta4
        Adaptive with located events, or the paper's fixed step. The adaptive method takes a smaller tolerance by
        itself where a machine is so slow that the errors of many periods add up.
    max_periods : int
        Valve periods to simulate before giving up.
    tolerance : float
        Distance from the orbit, relative to the machine's state scales [-], at which the state counts as periodic:
        :math:`|(I - \Phi)^{-1} r|` with the change r of the state over a period and the derivative of that map.
    stable_only : bool
        By default the orbit attracts, and the start leads to it. If false, the orbit nearest to the start by Newton's
        method, of one valve period, whether it attracts or not.
    max_seconds : float, optional
        Time after which to give up [s]; by default never. Ctrl-C ends the call at any time.

    Returns
    -------
    Orbit
        Over `n_periods` valve periods, the least number after which it repeats. `is_isolated` is false where the piston
        rests within a stiction band, or creeps to its edge by less than the tolerance; `rest` says what holds it.
        `residual` is the scaled distance from the orbit. Other starts may lead to other orbits: see `attractors`.

    Raises
    ------
    NotSettledError
        The state did not repeat; the error carries the residual.
    TimeLimitError
        `max_seconds` are over.
    ChamberVolumeError
        The piston swept a chamber's volume down to zero.
    ValueError
        Frequency or initial state out of range.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> machine = lp.load_machine("kunt_singh_1990").with_duty(0.86)
    >>> lp.nonlinear_orbit(machine, frequency=5.4).n_periods
    2

    The orbit of one period that it has left there, which does not attract:

    >>> lost = lp.nonlinear_orbit(machine, 5.4, stable_only=False)
    >>> lost.n_periods, lp.orbit_floquet(machine, lost).is_stable
    (1, False)
    """
    expect_machine(machine)
    period = 1 / positive("frequency", frequency, "Hz")
    end, machine = deadline(max_seconds), machine.at(frequency)
    start, tolerance = initial_state_of(machine, initial_state), positive("tolerance", tolerance)
    if not stable_only:
        search = PeriodMap(machine=machine, frequency=frequency, method=method)
        turn, distance, taken = nearest_orbit(search, start, tolerance, end)
        return _orbit(machine, period, turn.record, (taken, distance))
    run = new_run(machine.record, settings_of(machine, period, method), pieces_of(machine.openings, period))
    max_periods, n_simulated = whole("max_periods", max_periods), 0
    while True:
        found = settle(start, run, machine.state_scales, tolerance, max_periods - n_simulated, end)
        n_simulated += found.n_simulated
        if found.last.status != OK:
            elapsed = (n_simulated - 1) * period + found.last.time
            raise_stopped(machine, found.last.status, elapsed, found.last.state)
        if found.n_periods == 1:
            orbit = _orbit(machine, period, found.last.record, (n_simulated, found.residual))
            if orbit.is_isolated and is_at_edge_of_band(machine, run, orbit, tolerance):
                return replace(orbit, is_isolated=False, rest=AT_EDGE)
            return orbit
        residual, start = found.residual, found.last.state
        if found.n_periods > 1:
            turns = _Turns(machine, run, found.n_periods, end)
            record, residual, start = turns.closed(start, tolerance, max_periods - n_simulated)
            n_simulated += turns.n_simulated
            # What is chaotic comes near an earlier state by chance, and does not once more.
            if residual <= REPEATS * tolerance:
                return _orbit(machine, period, record, (n_simulated, residual))
        if n_simulated >= max_periods:
            raise NotSettledError(
                f"no periodic orbit after {n_simulated} valve periods: the scaled state still changes by "
                f"{residual:.1e} (tolerance {tolerance:.1e}). {_why_not_settled(machine, found.last)}",
                residual=residual,
                n_simulated=n_simulated,
                last_state=start,
            )


class _Turns:
    """Turns of several valve periods each, at the end of which the state seems to repeat."""

    def __init__(self, machine: Machine, run: Run, n_periods: int, end: Deadline | None) -> None:
        self.machine, self.run, self.n_periods, self.end = machine, run, n_periods, end
        self.scales, self.n_simulated = np.array(machine.state_scales), 0

    def closed(self, start: FloatArray, tolerance: float, max_periods: int) -> tuple[Record, float, FloatArray]:
        """Return a turn that closes, its scaled distance from an orbit, and the state after it.

        By Newton's method, as long as that comes nearer.
        """
        record, end = self._turn(start)
        ahead = self._ahead(record, start, end)
        while tolerance < ahead.left < NEARBY and self.n_simulated < max_periods:
            beside = end + ahead.moves[-1] * self.scales
            following, reached = self._turn(beside)
            nearer = self._ahead(following, beside, reached)
            if not nearer.left < 0.5 * ahead.left:
                break
            record, end, ahead = following, reached, nearer
        change = float(np.max(np.abs(ahead.moves[0])))
        return record, ahead.left if np.isfinite(ahead.left) else change, end

    def _turn(self, state: FloatArray) -> tuple[Record, FloatArray]:
        records: list[Record] = []
        for _ in range(self.n_periods):
            outcome = integrate_period(state, self.run, self.end)
            state = outcome.state
            records.append(outcome.record)
        self.n_simulated += self.n_periods
        return joined(records, float(self.run.pieces["end"][-1])), state

    def _ahead(self, record: Record, start: FloatArray, end: FloatArray) -> Heading:
        change = (end - start) / self.scales
        return look_ahead(log_of(record), self.machine.record, self.run.pieces, self.scales, change, FINE)


def _why_not_settled(machine: Machine, last: Outcome) -> str:
    """Return the likely cause and what to do."""
    free = np.isinf([machine.cylinder.lower_stop, machine.cylinder.upper_stop]).any()
    if machine.load.spring_stiffness == 0:
        moved = float(last.state[0] - last.record.coefficients[0, 0, 0])
        without = " and without both end stops" if free else ""
        remedy = "Give it a spring or end stops." if free else "Raise max_periods until it reaches an end stop."
        return (
            f"There is a piston without a spring (load.spring_stiffness is 0){without}: in the last period its "
            f"position moved by {moved:+.3g} m. {remedy}"
        )
    return "It may decay slowly (raise max_periods) or be chaotic (look at lp.simulate)."


def _orbit(machine: Machine, period: float, record: Record, reached: tuple[int, float]) -> Orbit:
    n_periods = round((record.starts[-1] + record.spans[-1]) / period)
    modes, pieces = record.modes, record.pieces
    first = np.ones(modes.size, dtype=np.bool_)
    first[1:] = (modes[1:] != modes[:-1]) | (pieces[1:] != pieces[:-1])
    begins = first.nonzero()[0]
    step_times = np.empty(begins.size + 1)
    step_times[:-1], step_times[-1] = record.starts[begins], n_periods * period
    trajectory = trajectory_of(record)
    n_simulated, residual = reached
    states = trajectory.coefficients[:, 0].copy()
    return Orbit(
        system_period=period,
        n_periods=n_periods,
        step_times=read_only(step_times),
        step_states=read_only(record.coefficients[begins, 0]),
        step_labels=tuple(step_label(machine, mode) for mode in modes[begins].tolist()),
        trajectory=trajectory,
        states=machine.states,
        outputs=machine.states,
        is_isolated=not rests_in_a_band(machine, states, modes),
        residual=float(residual),
        n_simulated=n_simulated,
        name=machine.name,
        rest=what_holds(machine, states, modes),
    )


def step_label(machine: Machine, mode: int) -> str:
    """Return what a step of an orbit is, for readers."""
    if mode == STUCK:
        return "stuck"
    if not machine.has_dry_friction:
        return "free"
    return "moves up" if mode > 0 else "moves down"


def mode_labelled(label: str) -> int:
    """Return the mode of motion that `step_label` names; without dry friction either direction serves."""
    return {"stuck": STUCK, "moves down": -1}.get(label, 1)
