"""Openings of the paths over a turn: the table of the profiles, and areas at a time."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ltvpneu._arrays import BoolArray, FloatArray, IntArray, read_only
from ltvpneu._compiled import inlined
from ltvpneu.models.machine.connections import Connection
from ltvpneu.physics.profile import merge_angles

LEAST_JUMP = 1e-9
"""Relative change of an area that counts as a jump [-]; where pieces of a ramp meet, rounding makes smaller ones."""


class OpeningTable(NamedTuple):
    """Effective areas over the turn, linear between switching instants, as the compiled kernels read them."""

    fractions: FloatArray
    """Piece ends as shares of the period, from 0 to 1, shape (n_pieces + 1,)."""
    areas: FloatArray
    """First area at start and end, second at start and end [m^2], per piece and path; (n_pieces, 4, n_paths)."""
    rises: FloatArray
    """Largest change of any area over each piece, relative to that area's maximum [-], shape (n_pieces,)."""
    jumps: FloatArray
    """Shares of the period at which any area jumps; 0 if one does from the end of the turn to its start."""

    @property
    def ramped(self) -> BoolArray:
        """Whether any area changes within the piece, shape (n_pieces,)."""
        return self.rises > 0


def opening_table(connections: Sequence[Connection]) -> OpeningTable:
    """Return the effective areas of all connections on a common set of pieces."""
    profiles = [p for c in connections for p in (c.first, c.second) if p is not None]
    angles = merge_angles(*(profile.angles for profile in profiles))
    areas = np.full((angles.size - 1, 4, len(connections)), np.inf)
    for number, connection in enumerate(connections):
        for row, profile in ((0, connection.first), (2, connection.second)):
            if profile is not None:
                cut = profile.refined(angles)
                areas[:, row, number] = cut.starts
                areas[:, row + 1, number] = cut.ends
    fractions = angles / angles[-1]
    at_start, at_end = areas[:, (0, 2)], areas[:, (1, 3)]
    # An absent second restriction is infinite throughout, a path never open zero throughout: neither changes.
    with np.errstate(invalid="ignore"):
        largest = np.max(areas, axis=0)[(0, 2),]
        rises = np.nan_to_num(np.abs(at_end - at_start) / largest)
        jumps = np.nan_to_num(np.abs(at_start - np.roll(at_end, 1, axis=0)) / largest) > LEAST_JUMP
    return OpeningTable(
        read_only(fractions),
        read_only(areas),
        read_only(np.max(rises, axis=(1, 2))),
        read_only(fractions[:-1][jumps.any(axis=(1, 2))]),
    )


class Schedule(NamedTuple):
    """One valve period: when the openings change, and what they are between."""

    times: FloatArray
    """Piece ends [s], from 0 to the period, shape (n_pieces + 1,)."""
    areas: FloatArray
    """As `OpeningTable.areas`."""
    ramped: BoolArray
    """Whether any area changes within the piece, shape (n_pieces,)."""


@inlined
def write_areas(time: float, piece: int, schedule: Schedule, areas: FloatArray) -> None:
    """Write the effective areas at a time within a piece into `areas`, shape (2, n_paths)."""
    begin, end = schedule.times[piece], schedule.times[piece + 1]
    share = (time - begin) / (end - begin)
    for path in range(areas.shape[1]):
        for row in range(2):
            at_start = schedule.areas[piece, 2 * row, path]
            at_end = schedule.areas[piece, 2 * row + 1, path]
            # Not interpolated where equal: an absent second restriction is infinite at both ends.
            areas[row, path] = at_start if at_start == at_end else at_start + share * (at_end - at_start)


def schedule_of(table: OpeningTable, period: float) -> Schedule:
    """Return the openings over one valve period [s]."""
    return Schedule(table.fractions * period, table.areas, table.ramped)


def step_means(table: OpeningTable, fractions: FloatArray) -> FloatArray:
    """Means of the areas over each step, shape (n_steps, 2, n_paths)."""
    if fractions is table.fractions:
        return (table.areas[:, (0, 2)] + table.areas[:, (1, 3)]) / 2
    cuts = np.union1d(table.fractions, fractions)
    middles, widths = (cuts[:-1] + cuts[1:]) / 2, np.diff(cuts)
    piece = np.searchsorted(table.fractions, middles) - 1
    share = (middles - table.fractions[piece]) / np.diff(table.fractions)[piece]
    at_start, at_end = table.areas[piece][:, (0, 2)], table.areas[piece][:, (1, 3)]
    with np.errstate(invalid="ignore"):
        values = at_start + share[:, None, None] * (at_end - at_start)
    values = np.where(np.isinf(at_start), np.inf, values)
    step = np.searchsorted(fractions, middles) - 1
    sums = np.zeros((fractions.size - 1, *values.shape[1:]))
    np.add.at(sums, step, widths[:, None, None] * values)
    return sums / np.diff(fractions)[:, None, None]


def cut_schedule(table: OpeningTable, cells: FloatArray, period: float) -> tuple[Schedule, IntArray, FloatArray]:
    """Return the openings on pieces that end at the cells' boundaries too, each cell's first piece, and its mean areas.

    Shapes: cells (n_cells + 1,) to first pieces (n_cells + 1,) and areas (n_cells, 2, n_paths).
    """
    if np.array_equal(table.fractions, cells):
        schedule = Schedule(table.fractions * period, table.areas, table.ramped)
        return schedule, np.arange(cells.size), np.array(step_means(table, table.fractions), order="C")
    fractions = np.union1d(table.fractions, cells)
    middles = (fractions[:-1] + fractions[1:]) / 2
    piece = np.searchsorted(table.fractions, middles) - 1
    begin, width = table.fractions[:-1][piece], np.diff(table.fractions)[piece]
    shares = ((fractions[:-1] - begin) / width, (fractions[1:] - begin) / width)
    areas = np.empty((middles.size, *table.areas.shape[1:]))
    for row in (0, 2):
        at_start, at_end = table.areas[piece, row], table.areas[piece, row + 1]
        for which, share in enumerate(shares):
            with np.errstate(invalid="ignore"):
                between = at_start + share[:, None] * (at_end - at_start)
            # Not interpolated where equal: an absent second restriction is infinite at both ends.
            areas[:, row + which] = np.where(at_start == at_end, at_start, between)
    ramped: BoolArray = table.ramped[piece]
    areas.setflags(write=False)
    schedule = Schedule(fractions * period, areas, ramped)
    return schedule, np.searchsorted(fractions, cells), np.array(step_means(table, cells), order="C")
