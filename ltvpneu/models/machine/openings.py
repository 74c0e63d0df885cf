"""Openings of the paths over a turn: the table of the profiles, and areas at a time."""

from collections.abc import Sequence
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ltvpneu._arrays import BoolArray, FloatArray, IntArray, layout, read_only
from ltvpneu._compiled import inlined
from ltvpneu.models.machine.connections import Connection
from ltvpneu.models.machine.records import MAX_PATHS
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

    def pieces_at(self, fractions: FloatArray) -> IntArray:
        """Return the pieces that shares of the period lie in, of the same shape; at an instant, the later one."""
        found: IntArray = np.searchsorted(self.fractions, fractions, side="right") - 1
        return np.clip(found, 0, self.rises.size - 1)

    def areas_at(self, fractions: FloatArray, pieces: IntArray) -> FloatArray:
        """Return the effective areas at shares of the period, each within a piece, shape (..., 2, n_paths)."""
        share = (fractions - self.fractions[pieces]) / np.diff(self.fractions)[pieces]
        begin, end = self.areas[pieces][..., (0, 2), :], self.areas[pieces][..., (1, 3), :]
        with np.errstate(invalid="ignore"):
            between = begin + share[..., None, None] * (end - begin)
        # Not interpolated where equal: an absent second restriction is infinite at both ends.
        return np.ascontiguousarray(np.where(begin == end, begin, between))


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


class PieceRecord(NamedTuple):
    """A piece of the valve period, as the compiled kernels read it: the openings are linear over it."""

    begin: float
    """[s]"""
    end: float
    ramped: bool
    """Whether any area changes."""
    areas: Annotated[FloatArray, 4, MAX_PATHS]
    """As a row of `OpeningTable.areas` [m^2]."""


PIECE = layout(PieceRecord)
Pieces = NDArray[Any]
"""The pieces of a valve period, one `PieceRecord` each, shape (n_pieces,)."""


@inlined
def write_areas(time: float, piece: PieceRecord, areas: FloatArray) -> None:
    """Write the effective areas at a time within a piece into `areas`, shape (2, n_paths)."""
    share = (time - piece.begin) / (piece.end - piece.begin)
    for path in range(areas.shape[1]):
        for row in range(2):
            at_start, at_end = piece.areas[2 * row, path], piece.areas[2 * row + 1, path]
            # Not interpolated where equal: an absent second restriction is infinite at both ends.
            areas[row, path] = at_start if at_start == at_end else at_start + share * (at_end - at_start)


def pieces_of(table: OpeningTable, period: float) -> Pieces:
    """Return the openings over one valve period [s]."""
    return _pieces(table.fractions * period, table.areas, table.ramped)


def _pieces(times: FloatArray, areas: FloatArray, ramped: BoolArray) -> Pieces:
    pieces = np.zeros(ramped.size, PIECE)
    pieces["begin"], pieces["end"], pieces["ramped"] = times[:-1], times[1:], ramped
    pieces["areas"][:, :, : areas.shape[2]] = areas
    return pieces


def step_means(table: OpeningTable, fractions: FloatArray) -> FloatArray:
    """Means of the areas over each step, shape (n_steps, 2, n_paths)."""
    if fractions is table.fractions:
        return (table.areas[:, (0, 2)] + table.areas[:, (1, 3)]) / 2
    cuts = np.union1d(table.fractions, fractions)
    middles, widths = (cuts[:-1] + cuts[1:]) / 2, np.diff(cuts)
    values = table.areas_at(middles, table.pieces_at(middles))
    step = np.searchsorted(fractions, middles) - 1
    sums = np.zeros((fractions.size - 1, *values.shape[1:]))
    np.add.at(sums, step, widths[:, None, None] * values)
    return sums / np.diff(fractions)[:, None, None]


def cut_pieces(table: OpeningTable, cells: FloatArray, period: float) -> tuple[Pieces, IntArray, FloatArray]:
    """Return the openings on pieces that end at the cells' boundaries too, each cell's first piece, and its mean areas.

    Shapes: cells (n_cells + 1,) to first pieces (n_cells + 1,) and areas (n_cells, 2, n_paths).
    """
    if np.array_equal(table.fractions, cells):
        return pieces_of(table, period), np.arange(cells.size), np.array(step_means(table, table.fractions), order="C")
    fractions = np.union1d(table.fractions, cells)
    middles = (fractions[:-1] + fractions[1:]) / 2
    piece = table.pieces_at(middles)
    areas = np.empty((middles.size, *table.areas.shape[1:]))
    areas[:, (0, 2)], areas[:, (1, 3)] = table.areas_at(fractions[:-1], piece), table.areas_at(fractions[1:], piece)
    pieces = _pieces(fractions * period, areas, table.ramped[piece])
    return pieces, np.searchsorted(fractions, cells), np.array(step_means(table, cells), order="C")
