r"""A position controller on the duty: feed-forward from the duty map, and an integrator that goes by a model.

Once a period k the controller sees the mean position y of the period before and the duty u that the valve made of it.
The machine is taken for its duty map F, seen through the answer p to a short change of the duty, and off its map by a
duty c that it does not tell (supply, load, friction, wear):

.. math:: y_k = \sum_{j \ge 0} p_j F(u_{k-j} - c), \quad \sum_j p_j = 1

Three parts follow.

*Feed-forward.* With r the reference, u_k = F^{-1}(r_k + (\tau + d) s_k) + c. On a ramp of slope s [m/period] the model
lags its map by tau = sum j p_j periods and the command by the d periods of the delay, so the lead makes up for both:
without it a ramp would be followed with the error (tau + d) s. As slope counts the smaller of the reference's last two
changes, and none where they differ in sign: a step is no slope, and gets no kick.

*Integral.* The model with the correction as it is now foretells the last mean, m; what the machine is off by, m - y,
is put right by a share of it,

.. math:: c \leftarrow c + g \, (m - y) / S

with S the map's mean slope [m]. As m is foretold from the duties as they were made, an answer that is still on its way
is no error: c may be put right in every period, whether the reference stands, steps or moves, where an integral of
r - y would take the way for an error and overshoot. If the model were exact, what is left would shrink by 1 - g a
period, whatever lag and delay are (the principle of internal model control, [Garcia1982]_). Where it comes to
rest m = y, so F(u - c) = y; but u is F^{-1}(r) + c, so y = r: the loop integrates, whatever p is. Where c has to move
with the reference, by c' a period, as the machine's own map is steeper or flatter than F, the error left is S c' / g.

*No wind-up.* A duty at a limit of the valve is known as it was made, so m does not expect what could not be done, and c
stands still where the error cannot be helped. c itself ends at `most`.

*No hunting.* While the reference stands, c rests from when the mean is within a third of `zone`, or has come through
its goal within `zone`, until it leaves `zone`: stiction gives a piston that sticks nothing to wind up against.

.. [Garcia1982] C. E. Garcia and M. Morari, "Internal model control. 1. A unifying review and some new results",
   Industrial & Engineering Chemistry Process Design and Development 21 (1982) 308-323.
"""

import math
from typing import final

import numpy as np

from ltvpneu._arrays import FloatArray, not_negative, positive, read_only, whole
from ltvpneu.design.control.closed_loop import simulate_closed_loop
from ltvpneu.design.control.laws import Measurement
from ltvpneu.design.duty_map import DutyMap
from ltvpneu.models.machine.machine import Machine
from ltvpneu.models.nonlinear.orbits import nonlinear_orbit

FIRST_PERIODS, MOST_PERIODS = 32, 1024
"""Periods for which the answer to a step of the duty is followed: twice as many until it has settled."""
SETTLED = 0.01
"""Share of a step within which its answer counts as settled [-]."""
REST_WITHIN = 1 / 3
"""Share of the zone within which the integrator comes to rest [-]."""


@final
class PositionController:
    """Feed-forward from the duty map, and an integrator of what the machine is off its map by.

    It acts in every period, whatever the reference does, and holds still near a goal that stands still. Derivation, and
    what error is left on a ramp: the module's docstring.

    Parameters
    ----------
    duty_map : DutyMap
        Of the machine as it is known; its answer to a step of the duty is simulated once.
    frequency : float
        One of the map's [Hz].
    gain : float
        Share of what the machine is off by that each period's correction makes up for [-], below 2.
    zone : float
        Error of the mean within which the integrator rests while the reference stands [m]. 0: it never rests.
    most : float
        Largest correction of the duty [-].
    delay : int
        Periods by which a command is late, as of `ValveLimits`: on a ramp the feed-forward goes ahead by so many more.

    Attributes
    ----------
    correction : float
        Of the duty, now [-].
    lag : float
        Periods by which the mean follows the duty, on the mean: of the machine that the map is of.

    Raises
    ------
    ValueError
        The map moves at fewer than two duties, or its mean does not rise or fall throughout; numbers out of range.

    Examples
    --------
    >>> import numpy as np
    >>> import ltvpneu as lp
    >>> from ltvpneu import design
    >>> machine = lp.load_machine("kunt_singh_1990")
    >>> duties = design.duty_map(machine, np.linspace(0.3, 0.6, 7), [15.0])
    >>> controller = design.PositionController(duties, 15.0)
    >>> done = design.simulate_closed_loop(machine, controller, [0.045] * 40, 15.0)
    >>> bool(abs(done.mean_positions[-1] - 0.045) < 0.5e-3)
    True
    """

    def __init__(
        self, duty_map: DutyMap, frequency: float, *, gain: float = 0.3, zone: float = 0.3e-3, most: float = 0.3,
        delay: int = 0,
    ) -> None:  # fmt: skip
        self.duty_map, self.frequency = duty_map, frequency
        self.gain, self.zone = positive("gain", gain), not_negative("zone", zone, "m")
        if gain >= 2:
            raise ValueError(f"gain: found {gain:g}, expected below 2, from which on the correction grows without end")
        self.most, self.delay = not_negative("most", most), whole("delay", delay, 0)
        self._duties, self._means = duty_map.curve(frequency)
        self._slope = float((self._means[-1] - self._means[0]) / (self._duties[-1] - self._duties[0]))
        self._answer = _answer_to_a_pulse(duty_map.orbits.machine, frequency, self._duties)
        self.lag = float(np.arange(self._answer.size) @ self._answer)
        self._begin(math.nan, math.nan)

    def __call__(self, measured: Measurement) -> float:
        """Return the duty of the next period."""
        reference, error = measured.reference, measured.reference - measured.mean_position
        if measured.number == 0:
            self._begin(reference, measured.mean_position)
        else:
            made = self._command if math.isnan(measured.duty) else measured.duty
            self._made = np.concatenate([[made], self._made[: self._answer.size - 1]])
            if not self._rests(reference, error):
                off = self._foretold() - measured.mean_position
                known = float(self._answer[: self._made.size].sum())
                corrected = self.correction + known * self.gain * off / self._slope
                self.correction = float(np.clip(corrected, -self.most, self.most))
        change = reference - self._reference
        ahead = reference + (self.lag + self.delay) * _smaller(change, self._change)
        self._reference, self._change, self._error = reference, change, error
        # What is asked for has to be on the map; going ahead of it stops at the map's end.
        wanted = self.duty_map.duty_for(reference, self.frequency)
        if ahead != reference:
            inside = float(np.clip(ahead, self._means.min(), self._means.max()))
            wanted = self.duty_map.duty_for(inside, self.frequency)
        self._command = float(np.clip(wanted + self.correction, 0.0, 1.0))
        return self._command

    def _begin(self, reference: float, position: float) -> None:
        self.correction, self._start, self._made = 0.0, position, np.zeros(0)
        self._reference, self._change, self._error = reference, 0.0, 0.0
        self._resting, self._command = False, math.nan

    def _rests(self, reference: float, error: float) -> bool:
        """Whether the correction holds still: near a goal that stands."""
        if reference != self._reference or abs(error) > self.zone:
            self._resting = False
        elif abs(error) < REST_WITHIN * self.zone or error * self._error < 0:
            self._resting = True
        return self._resting

    def _foretold(self) -> float:
        """Return the last period's mean [m] as the model has it, with the correction of now."""
        at, low, high = self._made - self.correction, self._duties[0], self._duties[-1]
        # Straight on beyond the map's ends.
        beyond = np.minimum(at - low, 0.0) + np.maximum(at - high, 0.0)
        means = np.interp(at, self._duties, self._means) + self._slope * beyond
        shares = self._answer[: means.size]
        return float(shares @ means + (1 - shares.sum()) * self._start)


def _smaller(change: float, before: float) -> float:
    """Return the smaller of two changes, 0 where they differ in sign."""
    return math.copysign(min(abs(change), abs(before)), change) if change * before > 0 else 0.0


def _answer_to_a_pulse(machine: Machine, frequency: float, duties: FloatArray) -> FloatArray:
    """Return what share of a change of the duty, one period long, is seen in its mean and in those after it, sum 1.

    From a step between two duties of the map, a third and two thirds of it away from its end.
    """
    n = duties.size - 1
    first, last = float(duties[n // 3]), float(duties[max(2 * n // 3, n // 3 + 1)])
    before, after = (nonlinear_orbit(machine.with_duty(duty), frequency) for duty in (first, last))
    start, end = before.mean("position"), after.mean("position")
    n_periods = FIRST_PERIODS
    while True:
        done = simulate_closed_loop(
            machine.with_duty(last), lambda _: last, np.zeros(n_periods), frequency, initial_state=before.initial_state
        )
        reached = (done.mean_positions - start) / (end - start)
        unsettled = np.flatnonzero(np.abs(reached - 1) > SETTLED)
        n_lasting = int(unsettled[-1]) + 1 if unsettled.size else 0
        if n_lasting < n_periods or n_periods >= MOST_PERIODS:
            break
        n_periods *= 2
    answered = np.append(reached[:n_lasting], 1.0)
    return read_only(np.diff(answered, prepend=0.0))
