"""A machine in equal slots of the period, its valve off or on: exact maps of a slot, and the cycle of a pattern."""

from typing import Any, NamedTuple

import numpy as np

from ltvpneu._arrays import BoolArray, FloatArray
from ltvpneu.models.linear.linearize import Linearization
from ltvpneu.models.linear.lti import lti_model
from ltvpneu.models.linear.model import assemble
from ltvpneu.models.linear.operating_points import LEAST_DISTANCE
from ltvpneu.models.machine.machine import Machine
from ltvpneu.models.machine.supply_flow import supply_flow_tangents
from ltvpneu.periodic.algebra.propagate import exponentials
from ltvpneu.periodic.orbits.exponential import ExponentialTrajectory
from ltvpneu.periodic.orbits.steady import periodic_states, steady_state
from ltvpneu.periodic.systems.system import PeriodicSystem

SAMPLES = 200
"""Random patterns from which the states' bounds are taken."""


class Slots(NamedTuple):
    """Exact maps of a slot, off and on, in scaled states; second axis for what is mapped to."""

    maps: FloatArray
    """(2, n, n)"""
    moves: FloatArray
    """(2, n)"""
    mean_maps: FloatArray
    """To the means over the slot, (2, n, n)."""
    mean_moves: FloatArray
    """(2, n)"""
    flow_rows: FloatArray
    """From those to the mean flow from the supply [kg/s], (2, n)."""
    flow_offsets: FloatArray
    """(2,)"""
    scales: FloatArray
    """(n,)"""


def two_positions(machine: Machine) -> FloatArray:
    """Return the areas with the valve off and on, (2, 2, n_paths)."""
    if machine.has_switching_times:
        raise ValueError("machine: found a valve with delays or travel times, expected one that switches at once")
    tables = [machine.with_duty(duty).openings for duty in (0.0, 1.0)]
    for table in tables:
        if table.fractions.size != 2 or table.ramped.any():
            raise ValueError("machine: found a valve with other positions than on and off; expected those two alone")
    if machine.with_duty(0.5).openings.ramped.any():
        raise ValueError("machine: found openings that ramp, expected a valve that is on or off (valve.ramp = 0)")
    return np.array([table.areas[0, (0, 2)] for table in tables])


def first_points(machine: Machine, frequency: float) -> FloatArray:
    """Return a first operating point for both positions, (2, n): the means of the averaged model's cycle."""
    model = lti_model(machine, frequency)
    means = (
        np.diff(model.system.switching_times)
        @ ExponentialTrajectory(system=model.system, step_states=periodic_states(model.system)).step_state_means()
    )
    point = means / model.system.period
    return _held(machine, np.tile(point, (2, 1)))


def _held(machine: Machine, points: FloatArray) -> FloatArray:
    """Return the points at rest, with pressures kept inside the sources'."""
    low, high = machine.exhaust_pressure, machine.supply_pressure
    points = points.copy()
    points[:, 1] = 0.0
    pressures = points[:, 2 : 2 + machine.n_volumes]
    np.clip(pressures, low * (1 + LEAST_DISTANCE), high * (1 - LEAST_DISTANCE), out=pressures)
    return points


def slots_of(
    machine: Machine, linearization: Linearization, points: FloatArray, areas: FloatArray, duration: float
) -> Slots:
    """Return the maps of a slot, the valve off and on, for linearizations about points that keep still."""
    n, scales = len(machine.states), machine.state_scales
    matrices = np.zeros((2, 2 * (n + 1), 2 * (n + 1)))
    inner = np.zeros((2, n + 1, n + 1))
    inner[:, :n, :n] = linearization.A * scales / scales[:, None]
    inner[:, :n, n] = linearization.f / scales
    matrices[:, : n + 1, : n + 1] = inner * duration
    matrices[:, : n + 1, n + 1 :] = np.eye(n + 1)
    whole_maps = exponentials(matrices)
    maps, means = whole_maps[:, : n + 1, : n + 1], whole_maps[:, : n + 1, n + 1 :]
    rows, inputs, offsets = supply_flow_tangents(points, areas, 1e-3, machine.record)
    return Slots(
        maps=maps[:, :n, :n],
        moves=maps[:, :n, n],
        mean_maps=means[:, :n, :n],
        mean_moves=means[:, :n, n],
        flow_rows=rows * scales,
        flow_offsets=inputs @ machine.levels + offsets,
        scales=scales,
    )


def state_bounds(slots: Slots, n_slots: int) -> tuple[FloatArray, FloatArray]:
    """Return bounds of the scaled states over all patterns: of many patterns' cycles, widened by their own span."""
    random = np.random.default_rng(0)
    n = slots.scales.size
    patterns = random.random((SAMPLES, n_slots)) < random.random((SAMPLES, 1))
    patterns[0], patterns[1] = False, True
    low, high = np.full(n, np.inf), np.full(n, -np.inf)
    for pattern in patterns.astype(int):
        try:
            states = pattern_states(slots, pattern)
        except np.linalg.LinAlgError:
            # Always off, say, a volume inside the valve stays shut, and any pressure in it is a cycle.
            continue
        low, high = np.minimum(low, states.min(axis=0)), np.maximum(high, states.max(axis=0))
    span = np.maximum(high - low, 1e-6)
    return low - span, high + span


def pattern_states(slots: Slots, pattern: Any) -> FloatArray:
    """Return the scaled states at the starts of the slots on a pattern's cycle, (n_slots, n)."""
    n = slots.scales.size
    whole_map, move = np.eye(n), np.zeros(n)
    for on in pattern:
        whole_map, move = slots.maps[on] @ whole_map, slots.maps[on] @ move + slots.moves[on]
    state: FloatArray = np.linalg.solve(np.eye(n) - whole_map, move).astype(np.float64)
    found: list[FloatArray] = []
    for on in pattern:
        found.append(state)
        state = slots.maps[on] @ state + slots.moves[on]
    return np.array(found)


def pattern_system(
    machine: Machine, linearization: Linearization, pattern: BoolArray, frequency: float
) -> PeriodicSystem:
    """Return the linear model of a pattern, one step a slot."""
    chosen = pattern.astype(int)
    one = Linearization(
        A=linearization.A[chosen], B=linearization.B[chosen], r=linearization.r[chosen], f=linearization.f[chosen]
    )
    durations = np.full(pattern.size, 1 / (frequency * pattern.size))
    return assemble(machine, durations, one, f"{machine.identifier}_pattern")


def points_of(machine: Machine, system: PeriodicSystem, pattern: BoolArray, before: FloatArray) -> FloatArray:
    """Return a pattern's means over all its slots off, and over all on; as before where it has none."""
    trajectory = ExponentialTrajectory(system=system, step_states=steady_state(system).step_states)
    means = trajectory.step_state_means()
    points = before.copy()
    for row, chosen in enumerate((~pattern, pattern)):
        if chosen.any():
            points[row] = means[chosen].mean(axis=0)
    points[:, 0] = means[:, 0].mean()
    return _held(machine, points)


def with_pattern(machine: Machine, pattern: BoolArray) -> Machine:
    """Return the machine with its valve on in those slots of the turn."""
    N = pattern.size
    if pattern.all() or not pattern.any():
        return machine.with_duty(float(pattern.all()))
    starts = np.flatnonzero(pattern & ~np.roll(pattern, 1))
    ends = np.flatnonzero(~pattern & np.roll(pattern, 1))
    pulses: list[tuple[float, float]] = []
    for start in starts.tolist():
        after = ends[ends > start]
        end = int(after[0]) if after.size else int(ends[0]) + N
        pulses.append((start * 2 * np.pi / N, end * 2 * np.pi / N))
    return machine.with_pulses(pulses)


def count_pulses(patterns: BoolArray) -> FloatArray:
    """Return how often the valve goes on in a period of patterns, (..., n_slots) to (...)."""
    return np.asarray(np.sum(patterns & ~np.roll(patterns, 1, axis=-1), axis=-1), dtype=np.float64)
