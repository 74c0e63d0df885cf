"""Step matrices of a machine over a box of operating points, for a certificate of their stability."""

from collections.abc import Sequence
from itertools import product

import numpy as np

from ltvpneu._arrays import FloatArray, read_only
from ltvpneu.models.linear.linearize import Tangent
from ltvpneu.models.machine.machine import Machine, expect_machine
from ltvpneu.models.machine.tangent import tangents

PLACES, PRESSURES = 65, 257
"""Points of the grid over the box."""
MOST_VARYING = 14
"""Entries that vary: each doubles the number of matrices."""


def operating_box(
    machine: Machine,
    *,
    position: tuple[float, float],
    pressures: Sequence[tuple[float, float]] | None = None,
    velocity: tuple[float, float] | None = None,
    tangent: Tangent = "paper",
) -> FloatArray:
    """Return step matrices whose convex hull holds every linearization over a box of operating points.

    Which linearization decides what a certificate of them says. The paper's G (8b) is that of the LTV model: its steps
    are in the hull. Of the machine's own motions the full tangent tells: where all of its matrices share one function,
    two motions of the frictionless machine within the box approach each other.

    Parameters
    ----------
    machine : Machine
    position : tuple of float
        Least and greatest position [m].
    pressures : sequence of tuple of float, optional
        Least and greatest absolute pressure of each chamber [Pa]; by default from 2 % above the exhaust's to 2 % below
        the supply's. Nearer to a source that is open, the flow's slope grows beyond all bounds.
    velocity : tuple of float, optional
        Least and greatest velocity [m/s]; of the full tangent, which depends on it.
    tangent : {"paper", "full"}
        As of `linearize`: the paper's G, whose pressure rows are those at rest and have no column for the position; or
        every derivative.

    Returns
    -------
    ndarray, shape (n_matrices, n, n)
        Every entry that varies takes its least and its greatest value. The extremes are those in the cells of a fine
        grid over box and openings, each widened by as much as the entry changes between its own corners.

    Raises
    ------
    ValueError
        Limits out of order, outside the cylinder, or a pressure not above zero; a velocity where the tangent does not
        depend on it, or none where it does. Or a machine with temperatures among its states, or volumes that feed each
        other: there the entries of different rows change together (the same mass leaves one and enters the other), and
        taken one by one their extremes make unstable matrices that the machine never has.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> from ltvpneu import design
    >>> box = design.operating_box(lp.load_machine("kunt_singh_1990"), position=(0.02, 0.08))
    >>> box.shape
    (4, 3, 3)
    """
    expect_machine(machine)
    reason = why_no_box(machine)
    if reason:
        raise ValueError(reason)
    n_chambers = len(machine.cylinder.chambers)
    if pressures is None:
        pressures = [(1.02 * machine.exhaust_pressure, 0.98 * machine.supply_pressure)] * n_chambers
    if len(pressures) != n_chambers:
        raise ValueError(f"pressures: found {len(pressures)} pairs, expected {n_chambers}, one for each chamber")
    stops = machine.cylinder.lower_stop, machine.cylinder.upper_stop
    for name, (low, high), (least, most) in (
        ("position", position, stops),
        *((f"pressures[{k}]", pair, (0.0, np.inf)) for k, pair in enumerate(pressures)),
    ):
        if not (np.isfinite([low, high]).all() and least <= low <= high <= most) or (name != "position" and low <= 0):
            raise ValueError(f"{name}: found {low:g} to {high:g}, expected rising values within {least:g} to {most:g}")
    velocities = _velocities(velocity, tangent)
    least, most = _entry_ranges(machine, position, pressures, velocities)
    varying = np.argwhere(most > least)
    if len(varying) > MOST_VARYING:
        raise ValueError(
            f"machine: found {len(varying)} entries that vary, so {2 ** len(varying)} matrices; expected "
            f"{MOST_VARYING} at most"
        )
    found = np.tile(least, (2 ** len(varying), 1, 1))
    for number, choice in enumerate(product((0, 1), repeat=len(varying))):
        for (i, j), which in zip(varying, choice, strict=True):
            found[number, i, j] = (least, most)[which][i, j]
    return read_only(found)


def why_no_box(machine: Machine) -> str:
    """Return why a machine has no box of operating points, taken entry by entry; empty where it has."""
    feeds = any(path.source >= 0 for path in machine.path_fields)
    if len(machine.states) == 2 + len(machine.cylinder.chambers) and not feeds:
        return ""
    return (
        f"machine: found states {', '.join(machine.states)}, or flow between its volumes; expected a box over "
        "position and one pressure a chamber that no other volume feeds, since other entries change together. "
        "Certify the linearizations at chosen states instead: common_lyapunov([linearize(machine, state, "
        "angle=angle).A, ...]), or the steps of a model: common_lyapunov(ltv_model(...))"
    )


def _velocities(velocity: tuple[float, float] | None, tangent: Tangent) -> tuple[float, ...]:
    """Return the velocities at which the tangent is taken, full if there are any: it is linear between them."""
    if tangent not in ("paper", "full"):
        raise ValueError(f'tangent: found {tangent!r}, expected "paper" or "full"')
    if tangent == "paper":
        if velocity is not None:
            raise ValueError("velocity: found a range, expected none: the paper's G is that at rest; or tangent='full'")
        return ()
    if velocity is None:
        raise ValueError("velocity: found none, expected a least and a greatest one [m/s] for tangent='full'")
    low, high = velocity
    if not (np.isfinite([low, high]).all() and low <= high):
        raise ValueError(f"velocity: found {low:g} to {high:g} m/s, expected finite rising values")
    return low, high


def _entry_ranges(
    machine: Machine,
    position: tuple[float, float],
    pressures: Sequence[tuple[float, float]],
    velocities: tuple[float, ...],
) -> tuple[FloatArray, FloatArray]:
    """Return the least and greatest value of each entry of G, or of the full tangent, over the box and all openings."""
    # A valve with delays has the same positions at every frequency at which it opens and shuts.
    machine = machine.at(machine.switching_frequency or 1.0)
    areas = np.concatenate([machine.openings.areas[:, (0, 2)], machine.openings.areas[:, (1, 3)]])
    areas = np.unique(areas, axis=0)
    n = len(machine.states)
    least, most = np.full((n, n), np.inf), np.full((n, n), -np.inf)
    # A chamber's row knows its own pressure only, so one grid over position and pressure serves all chambers.
    places, shares = np.linspace(*position, PLACES), np.linspace(0.0, 1.0, PRESSURES)
    for openings, velocity in product(areas, velocities or (0.0,)):
        grid = np.zeros((places.size, shares.size, n))
        grid[:, :, 0], grid[:, :, 1] = places[:, None], velocity
        for k, (low, high) in enumerate(pressures):
            grid[:, :, 2 + k] = low + shares * (high - low)
        flat = grid.reshape(-1, n)
        every = np.broadcast_to(openings, (len(flat), *openings.shape)).copy()
        A, _ = tangents(flat, every, machine.record, bool(velocities))
        if not np.isfinite(A).all():
            raise ValueError(
                "pressures: found a range that holds the pressure of an open source, where the flow's slope is "
                "infinite; expected one apart from the sources'"
            )
        A = A.reshape(*grid.shape[:2], n, n)
        corners = np.array([A[:-1, :-1], A[1:, :-1], A[:-1, 1:], A[1:, 1:]])
        low, high = corners.min(axis=0), corners.max(axis=0)
        spread = high - low
        least = np.minimum(least, (low - spread).min(axis=(0, 1)))
        most = np.maximum(most, (high + spread).max(axis=(0, 1)))
    return least, most
