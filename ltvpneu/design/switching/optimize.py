"""Duty cycle, offset and frequency for a wanted motion."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import cvxpy as cp

from ltvpneu._arrays import whole
from ltvpneu.design.progress import Progress
from ltvpneu.design.switching.choices import Choices, over_choices
from ltvpneu.design.switching.duty_problem import DutyProblem, ModelKind, Scenario, duty_problem
from ltvpneu.design.switching.duty_solution import DutySolution
from ltvpneu.design.switching.duty_variables import Bounds, least_shares
from ltvpneu.design.switching.goals import Goals, Wanted, check_objective, constraints_of, objective_of
from ltvpneu.design.switching.pulses_along import pulses_along
from ltvpneu.design.switching.tolerances import Ranges, over_ranges, spans_of
from ltvpneu.design.valve_limits import ValveLimits
from ltvpneu.errors import LtvpneuError
from ltvpneu.models.machine.machine import Machine, expect_machine
from ltvpneu.models.machine.parameters import present_value, pulse_edges

WAYS = ("on", "off")


def optimize_duty(  # noqa: PLR0913 - keyword-only, each with its default
    machine: Machine,
    frequency: float | Bounds,
    variables: Mapping[str, Bounds] | None = None,
    *,
    minimize: str = "amplitude",
    goals: Goals | None = None,
    mean: Mapping[str, Wanted] | None = None,
    amplitude: Mapping[str, Wanted] | None = None,
    scenarios: Mapping[str, Scenario] | None = None,
    valve: ValveLimits | None = None,
    model: ModelKind = "fitted",
    steps_per_piece: int = 1,
    globally: bool = False,
    correct: bool = False,
    slopes: Sequence[str] = (),
    pulses: int | None = None,
    choices: Choices | None = None,
    ranges: Ranges | None = None,
    progress: Progress | None = None,
) -> DutySolution:
    """Return the duty, or other switching angles, frequency and pressures, that reach a wanted motion best.

    For an objective or constraints of your own, see `duty_problem`.

    Parameters
    ----------
    machine : Machine
    frequency : float or (float, float)
        Switching frequency [Hz], or bounds of it.
    variables : mapping of str to (float, float), optional
        Bounds of what is free, as of `duty_problem`; by default the duty, or the edges of several pulses.
    minimize : str
        "amplitude", of the position or as "amplitude pressure_1"; "air_use"; "mean_error", the square of the distance
        from the wanted means; "tracking", the mean square distance from the wanted cycle, from pulses along it where
        the valve has several; "switching", how often the valve switches. In several scenarios, the worst one's.
    goals : Goals, optional
        What is wanted.
    mean, amplitude : mapping, optional
        The two most usual goals, as of `Goals`.
    scenarios, valve
        As of `duty_problem`.
    model, steps_per_piece, globally, slopes, progress
        As of `DutyProblem.solve`.
    pulses : int, optional
        How often the valve goes on in a period; by default as the machine's does. For "tracking" without `variables`,
        the turn is cut into as many equal slots, and every edge is free within its own.
    choices : mapping of str to sequence, optional
        Lists to choose from. Every combination is solved, and the best is returned, with all of them in `.choices`:
        "valve" (names of `lp.catalogue()`, or `CatalogueValve`), "bore" ([m], or `CatalogueCylinder`), "pulses",
        "frequency" [Hz], or any number of the machine by its name, as "load.mass". See `lp.with_valve` and
        `lp.with_bore` for what changes with a valve and a bore.
    ranges : mapping of str to (float, float) or str, optional
        What is not known well: least and greatest values of numbers of the machine, or texts as "+-10 %". The goals
        that are bounds hold, and the objective counts, at the worst of corners and points inside, on the nonlinear
        machine; `.ranges` says what was checked. See `check_goals` for how likely goals are kept.
    correct : bool
        Go on from the linear model's optimum on the nonlinear machine; the result is in `.corrected`, or why there is
        none, as where stiction holds the machine there, in `.not_corrected`.

    Returns
    -------
    DutySolution

    Raises
    ------
    ValueError
        Unknown signals, variables or objectives; bounds that contradict each other.
    LtvpneuError
        No setting looked at has a cycle.

    Examples
    --------
    45 mm with less than 4 mm of ripple, for the least air:

    >>> import ltvpneu as lp
    >>> from ltvpneu import design
    >>> found = design.optimize_duty(
    ...     lp.load_machine("kunt_singh_1990"), (6.0, 18.0), mean={"position": 0.045}, amplitude={"position": 4e-3},
    ...     minimize="air_use")
    >>> print(found.status, f"{found.frequency:.1f} Hz, duty {found.values['duty']:.3f}")
    optimal 14.5 Hz, duty 0.424
    >>> print(f"nonlinear: {1e3 * found.nonlinear['nominal'].mean('position'):.1f} mm")
    nonlinear: 45.0 mm
    """
    expect_machine(machine)
    goals = Goals() if goals is None else goals
    goals = replace(
        goals,
        mean={**(goals.mean or {}), **(mean or {})},
        amplitude={**(goals.amplitude or {}), **(amplitude or {})},
    )
    minimize = str(minimize).strip()
    if goals.cycle and minimize != "tracking":
        raise ValueError(f'goals: found a wanted cycle with minimize={minimize!r}, expected minimize="tracking"')
    if choices is not None or ranges is not None:

        def again(machine: Machine, **changed: Any) -> DutySolution:
            asked: dict[str, Any] = {
                "frequency": frequency, "variables": variables, "minimize": minimize, "goals": goals,
                "scenarios": scenarios, "valve": valve, "model": model, "steps_per_piece": steps_per_piece,
                "globally": globally, "correct": correct, "slopes": slopes, "pulses": pulses, "progress": progress,
            }  # fmt: skip
            return optimize_duty(machine, **{**asked, **changed})

        free = set(variables or {"duty": ()}) | ({"frequency"} if isinstance(frequency, tuple) else set[str]())
        if choices is not None:

            def solve_one(machine: Machine, given: dict[str, Any], told: Progress | None) -> DutySolution:
                return again(machine, ranges=ranges, progress=told, **given)

            chosen = over_choices(machine, choices, free, solve_one, progress)
            assert chosen[0].solution is not None
            return replace(chosen[0].solution, choice=chosen[0].choice, choices=chosen)
        assert ranges is not None
        spans = spans_of(machine, frequency[0] if isinstance(frequency, tuple) else frequency, ranges, free)

        def solve_for(worst: Mapping[str, Scenario]) -> DutySolution:
            return again(machine, scenarios={**(scenarios or {}), **worst})

        return over_ranges(spans, (goals, check_objective(minimize)), solve_for, progress)
    if pulses is not None:
        machine = _pulsed(machine, frequency, whole("pulses", pulses))
        if variables is None and minimize == "tracking":
            variables = _slots(pulses)
    problem = duty_problem(machine, frequency, variables, scenarios=scenarios, valve=valve)
    constraints = constraints_of(problem, goals, minimize)
    objective = cp.Minimize(objective_of(problem, goals, minimize))

    def solve(start: Mapping[str, float] | None) -> DutySolution:
        return problem.solve(
            objective, constraints, model=model, steps_per_piece=steps_per_piece, start=start, globally=globally,
            slopes=slopes, progress=progress,
        )  # fmt: skip

    start = None if globally or minimize != "tracking" else _start_along(problem, goals)
    try:
        found = solve(start)
    except LtvpneuError:
        if start is None:
            raise
        found = solve(None)
    if not correct or model == "nonlinear":
        return found
    try:
        corrected = problem.solve(
            objective, constraints, model="nonlinear", start=found.values, slopes=slopes, progress=progress
        )
    except (LtvpneuError, ValueError) as error:
        return replace(found, not_corrected=str(error))
    return replace(found, corrected=corrected)


def _pulsed(machine: Machine, frequency: float | Bounds, n: int) -> Machine:
    """Return the machine with its duty spread over n pulses of equal distance."""
    slowest = min(frequency) if isinstance(frequency, tuple) else frequency
    least_on, least_off = least_shares(machine.at(slowest))
    if n * (least_on + least_off) > 1:
        raise ValueError(
            f"pulses: found {n}; a pulse and a pause in which the valve opens and shuts fully take "
            f"{least_on + least_off:.2g} of the period at {slowest:g} Hz, so expected at most "
            f"{int(1 / (least_on + least_off))}"
        )
    slot = 2 * math.pi / n
    width = slot * min(max(machine.duty, least_on * n), 1 - least_off * n)
    return machine.with_pulses([(i * slot, i * slot + width) for i in range(n)])


def _slots(n: int) -> dict[str, Bounds]:
    """Return bounds by which every edge of n pulses stays within its slot of the turn."""
    slot = 2 * math.pi / n
    return {f"{way}_{i + 1}": (i * slot, (i + 1) * slot) for i in range(n) for way in WAYS}


def _start_along(problem: DutyProblem, goals: Goals) -> dict[str, float] | None:
    """Return where to start with several pulses: along the wanted cycle; nothing where there is no such start."""
    n, wanted = len(pulse_edges(problem.machine)) // 2, (goals.cycle or {}).get("position")
    if n < 2 or wanted is None:
        return None
    try:
        pulses = pulses_along(problem.machine, problem.frequency, *wanted, n)
    except LtvpneuError:
        return None
    edges = {f"{way}_{i + 1}": edge for i, pair in enumerate(pulses) for way, edge in zip(WAYS, pair, strict=True)}
    start: dict[str, float] = {}
    for name, (low, high) in problem.bounds.items():
        value = edges.get(name, present_value(problem.machine, problem.frequency, name))
        start[name] = min(max(value, low), high)
    return start
