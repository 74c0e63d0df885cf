"""Simulation until the state is near an orbit: by waiting, and by going where it is heading.

Periods are marched until the state repeats, or at least the sequence of events does. Then the derivative of the map
over the last period tells how far the orbit is (`variation`, `heading`): a fast motion that has died down says nothing
of a slow one. The rest of the way is gone by Newton's method or, where the machine is slow, in steps of many periods
that lead where the machine would go. A step is taken back where the sequence of events is another after it, or the
change over a period is not what was foreseen.
"""

import math
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from ltvpneu._arrays import FloatArray
from ltvpneu._clock import Deadline
from ltvpneu._compiled import compiled
from ltvpneu.models.machine.piston import at_stop, can_stick
from ltvpneu.models.machine.records import MachineRecord
from ltvpneu.models.nonlinear.drift import WINDOW, Drift, within_sources
from ltvpneu.models.nonlinear.heading import (
    MOST_DOUBLINGS,
    Heading,
    creeps,
    furthest,
    heading_of,
    is_held,
    largest,
    look_ahead,
    surprise,
)
from ltvpneu.models.nonlinear.integrator import Outcome
from ltvpneu.models.nonlinear.periods import FAILED, LIMIT, REPEATS, WAITED, March, Plan
from ltvpneu.models.nonlinear.runge_kutta import Run

NEAR, PATIENCE, AGAIN = 1e-3, 12, 1.6
"""Scaled change below which, or periods after which, it is asked where the state is heading, if events repeat;
and how many times as many after a look that came to nothing."""
BIASED, SLOW, VERY_SLOW = 0.5, 0.9, 0.999
"""Spectral radius above which periods are integrated more tightly, the derivative is taken more finely, and waiting
takes too long [-]."""
RIGHT = 0.8
"""Spectral radius up to which the tolerances given will do [-]."""
ROUGH, FINE = 0, 2
"""Parts of an interval in the derivative, as of `turn_maps`."""
LEAST_RTOL = 1e-13
TIGHTER = 1e-8
"""Relative tolerance over the share of a distance by which a slow motion comes nearer in a period [-]."""
ERRS = 0.25
"""What a step of many periods may err by, over its length [-]."""
BACK, FEWEST = 3, 5
"""Doublings by which a step that was taken back is shortened, and below which it is not worth it."""
CALM, CALMS = 16, 0.8
"""Periods to march at most after a step of a slow machine, and how much the change falls in each while fast motions die
down [-]."""
STICKY = 8
"""Times as long as `WINDOW` that a machine that may come to rest anywhere is left to itself."""
CREEPS = 64
"""Periods for which a piston that creeps is left to come to rest."""
MOST_BLOCKED = 20
"""Steps cut short by events after which slow volumes alone are carried on."""
MOST_TO_REST, NEVER = 1000, 2**40
"""Periods in which a piston that was moved is followed to its place of rest once more."""
STILL = 2e-15
"""Scaled change over a period that is no change [-]."""
DEARER, LEAST_STEPS = 20, 2000
"""Times as many steps, and so many on top, that a period may take when it is integrated more tightly."""
MOST_STALLED, MORE_TIGHTLY = 3, 0.03
"""Steps without coming much nearer after which it is integrated more tightly still, and how much."""
FAR, NEUTRAL, NOISE = 1.0, 1e-9, 100.0
"""Scaled distance beyond which no orbit is known ahead, distance of the spectral radius from one that is none, and
change over a period that is none, over the tightest tolerance [-]."""
FLOOR = 10.0
"""What rounding and step control may leave of the distance, over the tolerance [-]."""


class Settled(NamedTuple):
    """Where `settle` got to."""

    n_periods: int
    """Least number of periods after which the state repeats; 0 if none was found."""
    n_simulated: int
    residual: float
    """Scaled distance from the orbit; where none was found, the least change over any number of periods."""
    last: Outcome
    """The last period simulated."""


def settle(
    start: FloatArray,
    run: Run,
    scales: FloatArray,
    tolerance: float,
    max_periods: int,
    deadline: Deadline | None = None,
) -> Settled:
    """Simulate valve periods until the state is near an orbit, of one or more of them.

    Returns
    -------
    Settled
        With `n_periods` zero if none was found, or if the last period could not be integrated.

    Raises
    ------
    TimeLimitError
    """
    return _Search(March(start, run, scales, deadline), tolerance, max_periods).settled()


class _Search:
    """A march, and the steps ahead in it."""

    def __init__(self, march: March, tolerance: float, max_periods: int) -> None:
        self.march, self.tolerance, self.max_periods = march, float(tolerance), int(max_periods)
        self.settings: Any = march.run.records["settings"][0]
        self.is_adaptive = "rtol" in self.settings.dtype.names
        self.given = (float(self.settings["rtol"]), self.settings["atol"].copy()) if self.is_adaptive else (0.0, None)
        self.may_tighten = True
        self.most, self.failed = MOST_DOUBLINGS, 0
        """Doublings to step at first, and looks since the last step."""
        self.moved_from: FloatArray | None = None
        """Where a piston that may come to rest anywhere was moved from first."""
        self.is_slow = False
        """Whether steps have failed, and waiting would take very long."""
        self.refused = False
        """Whether the last look was at a state that repeats, which was not near an orbit."""
        self.blocked = 0
        """Steps that events cut short."""
        self.drift = Drift(int(march.run.records["machine"]["n_volumes"][0]))

    @cached_property
    def sticks(self) -> bool:
        """Whether friction can hold the piston."""
        return _may_stick(self.march.machine)

    @property
    def _rtol(self) -> float:
        return float(self.settings["rtol"]) if self.is_adaptive else 0.0

    @property
    def n_simulated(self) -> int:
        return int(self.march.progress["simulated"])

    def settled(self) -> Settled:
        """Return where the march ends."""
        found = self._end()
        if self.moved_from is None or found.n_periods == 0 or not self._is_one_of_a_band():
            return found
        # Which place of a band it comes to rest at, each period on the way decides.
        self.march.restart(self.moved_from)
        self._set_tolerances(*self.given)
        ended = self.march.go(Plan(self.tolerance, 0.0, NEVER, NEVER, self.n_simulated + MOST_TO_REST))
        return found if ended != REPEATS else self._found(int(self.march.progress["repeats"]), self._change())

    def _is_one_of_a_band(self) -> bool:
        """Whether the piston rests through the last period, beside the stops."""
        return is_held(self.march.log) and at_stop(self.march.state[0], self.march.machine) == 0

    def _end(self) -> Settled:
        wait = self._window
        while True:
            # A look that came to nothing is not repeated soon.
            near, look = (0.0 if self.failed else NEAR), int(PATIENCE * AGAIN**self.failed)
            if self.blocked > MOST_BLOCKED:
                near, look, wait = 0.0, NEVER, WINDOW
            ended = self.march.go(Plan(self.tolerance, near, look, wait, self.max_periods))
            repeats = int(self.march.progress["repeats"]) if ended == REPEATS else 0
            if ended in (FAILED, LIMIT) or repeats > 1:
                return self._found(repeats, self._change())
            if ended == WAITED:
                drifted = self._drifted()
                wait = WINDOW if drifted else wait + WINDOW
                self.blocked = self.blocked if drifted else 0
                continue
            if repeats == 0 and self._may_come_to_rest():
                self.failed += 1
                continue
            too_soon = self.refused and int(self.march.progress["done"]) < int(PATIENCE * AGAIN**self.failed)
            if repeats and too_soon and self.n_simulated < self.max_periods:
                continue
            found = self._looked_ahead(repeats == 1)
            if found is not None:
                return found
            if self.n_simulated >= self.max_periods:
                # A state that repeats, but not near an orbit, may be all that the last period allowed came to.
                return self._found(0, self._change())
            self.refused = repeats == 1
            self._set_tolerances(*self.given)
            wait = self._window

    @property
    def _window(self) -> int:
        return WINDOW * (STICKY if self.sticks and not self.is_slow else 1)

    def _may_come_to_rest(self) -> bool:
        """Whether it is too soon to step ahead of a piston that creeps: most come to rest soon."""
        march = self.march
        done = int(march.progress["done"])
        return done < CREEPS and creeps(march.log, float(march.change[0] * march.scales[0]))

    def _change(self) -> float:
        return float(self.march.progress["change"])

    def _found(self, n_periods: int, residual: float) -> Settled:
        return Settled(n_periods, self.n_simulated, residual, self.march.outcome)

    def _looked_ahead(self, repeats: bool) -> Settled | None:
        """Step ahead as far as that leads; return the end, None where the march has to go on."""
        march, ahead, least, stalled = self.march, None, math.inf, 0
        while True:
            change = largest(march.change)
            if change <= STILL:
                return self._found(1, ahead.left if ahead is not None and ahead.left < FAR else change)
            ahead = self._heading() if ahead is None else ahead
            is_near = ahead.left <= (FLOOR if repeats else 1.0) * self.tolerance
            if is_near and (ahead.radius <= RIGHT or not self._is_loose(_rtol_for(ahead))):
                return self._found(1, ahead.left)
            if (repeats and not self.may_tighten) or self._is_neutral(ahead, change):
                # No more can be known, or nothing leads anywhere: each state beside is on an orbit of its own.
                return self._found(1, min(ahead.left, change))
            stalled = stalled + 1 if 0.5 * least < ahead.left < NEAR else 0
            least = min(least, ahead.left)
            rtol = _rtol_for(ahead)
            if stalled > MOST_STALLED:
                # Errors of integration are all that is left.
                if not (self.is_adaptive and self.may_tighten) or self._rtol <= LEAST_RTOL:
                    return self._found(1, ahead.left)
                rtol, stalled = max(MORE_TIGHTLY * self._rtol, LEAST_RTOL), 0
            if self.n_simulated >= self.max_periods:
                return None
            following = self._tightened(rtol) if self._is_loose(rtol) else self._stepped(ahead)
            if following is None:
                self.is_slow = self.is_slow or ahead.radius > VERY_SLOW
                self.failed, self.most = self.failed + 1, MOST_DOUBLINGS
                return None
            ahead = following

    def _is_neutral(self, ahead: Heading, change: float) -> bool:
        """Whether what is left of a change is error, and the derivative knows of no way."""
        leads_nowhere = not ahead.left < FAR or abs(1.0 - ahead.radius) < NEUTRAL
        return leads_nowhere and self._rtol <= LEAST_RTOL and change <= NOISE * LEAST_RTOL

    def _one_more(self) -> bool:
        """March one period more; return whether the machine came through."""
        return self.march.go(Plan(0.0, 0.0, self.max_periods, self.max_periods, self.n_simulated + 1)) != FAILED

    def _heading(self) -> Heading:
        """Return where the state is heading."""
        march = self.march
        machine, pieces, change = march.machine, march.run.pieces, march.change
        ahead = look_ahead(march.log, machine, pieces, march.scales, change, ROUGH)
        return ahead if ahead.radius <= SLOW else look_ahead(march.log, machine, pieces, march.scales, change, FINE)

    def _drifted(self) -> bool:
        """Carry slow volumes on; return whether there were any."""
        reached = self.drift.carried_on(self.march)
        if reached is not None:
            self.march.restart(reached)
        return reached is not None

    def _set_tolerances(self, rtol: float, atol: FloatArray | None) -> None:
        if self.is_adaptive:
            self.settings["rtol"], self.settings["atol"] = rtol, atol

    def _is_loose(self, rtol: float) -> bool:
        return self.is_adaptive and self.may_tighten and 2.0 * rtol <= self._rtol

    def _tightened(self, rtol: float) -> Heading | None:
        """Integrate more tightly from now on; return where the state is heading, None where no period comes through.

        Beside the pressure of a source, where slopes have no end, that would take steps without end: then not.
        """
        march, settings = self.march, self.settings
        origin, most = march.state.copy(), int(settings["max_steps"])
        loose = settings["rtol"].copy(), settings["atol"].copy()
        settings["max_steps"] = DEARER * int(march.progress["steps"]) + LEAST_STEPS
        atol = np.zeros(settings["atol"].size)
        atol[: march.scales.size] = rtol * march.scales
        self._set_tolerances(rtol, atol)
        came_through = self._one_more()
        settings["max_steps"] = most
        if not came_through:
            self.may_tighten = False
            self._set_tolerances(*loose)
            march.restart(origin)
            came_through = self._one_more()
        return self._heading() if came_through else None

    def _stepped(self, ahead: Heading) -> Heading | None:
        """Step ahead, and return where it goes on to; None, and back, where no step holds."""
        march, last = self.march, len(ahead.moves) - 1
        origin, sequence = march.state.copy(), int(march.progress["sequence"])
        longest = furthest(ahead, origin, march.scales, march.machine)
        number = min(longest, self.most)
        while (number >= FEWEST or (ahead.ends and number == last)) and self.n_simulated < self.max_periods:
            reached = origin + ahead.moves[number] * march.scales
            march.restart(reached if ahead.radius <= SLOW else within_sources(origin, reached, march.machine))
            length = largest(ahead.moves[number])
            if self._came_through(sequence, ahead.radius > SLOW):
                change = march.change
                if surprise(ahead, number, change) <= max(ERRS * length, self.tolerance):
                    self.blocked += int(number < longest - 2 * BACK)
                    self.failed, self.most = 0, number + 2 * BACK
                    if self.moved_from is None and self.sticks and not is_held(march.log):
                        self.moved_from = origin
                    is_near = ahead.radius <= SLOW and length <= NEAR
                    return heading_of(ahead.powers[0], change) if is_near else self._heading()
            number -= BACK
        march.restart(origin)
        return None

    def _came_through(self, sequence: int, calms: bool) -> bool:
        """March one period more, or until fast motions have died down; return whether events were those expected."""
        change = math.inf
        for _ in range(CALM if calms else 1):
            if not self._one_more() or int(self.march.progress["sequence"]) != sequence:
                return False
            last, change = change, largest(self.march.change)
            if change > CALMS * last:
                break
        return True


def _rtol_for(ahead: Heading) -> float:
    """Return the tolerance at which the errors of a period, adding up over many, leave the orbit right."""
    return max(TIGHTER * abs(1.0 - ahead.radius), LEAST_RTOL) if ahead.radius > BIASED else math.inf


@compiled
def _may_stick(machine: MachineRecord) -> bool:
    return can_stick(machine)
