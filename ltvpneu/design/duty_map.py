"""The duty map: where the piston is on average, and how it ripples, over duty and frequency."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from ltvpneu._arrays import FloatArray, finite
from ltvpneu._values import Value
from ltvpneu.models.cycles.orbit_map import OrbitMap, orbit_map
from ltvpneu.models.machine.machine import Machine


@final
@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class DutyMap(Value):
    """Orbits of the nonlinear machine over frequency (rows) and duty (columns)."""

    orbits: OrbitMap

    def __repr__(self) -> str:
        shape = self.orbits.means.shape
        return f"<DutyMap of {self.orbits.machine.name}: {shape[0]} frequencies, {shape[1]} duties>"

    @property
    def means(self) -> FloatArray:
        """Mean positions from rest at zero [m], (n_frequencies, n_duties); nan where there is no orbit.

        Where the position depends on the start, `orbits.branches` has them all.
        """
        return self.orbits.means

    @property
    def amplitudes(self) -> FloatArray:
        """Amplitudes of the position [m], likewise."""
        return self.orbits.amplitudes

    def row(self, frequency: float) -> int:
        """Return the number of a frequency of the map."""
        return self.orbits.row(frequency)

    def curve(self, frequency: float) -> tuple[FloatArray, FloatArray]:
        """Return the duties at which the piston moves, rising, and its mean positions there [m].

        Parameters
        ----------
        frequency : float
            One of the map's [Hz].

        Raises
        ------
        ValueError
            Fewer than two such duties, or the mean does not rise or fall with the duty throughout.
        """
        row = self.row(frequency)
        moving = np.array([kind in ("unique", "subharmonic") for kind in self.orbits.kinds[row]])
        duties, means = self.orbits.duties[moving], self.means[row][moving]
        order = np.argsort(duties)
        duties, means = duties[order], means[order]
        if duties.size < 2:
            raise ValueError(
                f"duty_map: found {duties.size} duties at which the piston moves at {frequency:g} Hz, expected two or "
                "more"
            )
        rises = np.diff(means)
        if not ((rises > 0).all() or (rises < 0).all()):
            raise ValueError(
                f"mean: at {frequency:g} Hz the mean position does not rise or fall with the duty throughout, so no "
                "duty belongs to it; take fewer duties, or look at the map"
            )
        return duties, means

    def duty_for(self, mean: float, frequency: float) -> float:
        """Return the duty at which the piston is at a mean position, between the map's points on a straight line.

        Where it rests by stiction, or goes one way or the other, its place depends on how it came there; those points
        are left out.

        Parameters
        ----------
        mean : float
            [m]
        frequency : float
            One of the map's [Hz].

        Raises
        ------
        ValueError
            No duty of the map reaches it or holds it, or the mean does not rise or fall with the duty throughout.
        """
        mean = finite("mean", mean, "m")
        gap = self.orbits.unheld(frequency)
        if gap is not None and gap[0] < mean < gap[1]:
            raise ValueError(f"mean: found {1e3 * mean:.4g} mm. {self.orbits.remark(frequency)}")
        duties, means = self.curve(frequency)
        if means[0] > means[-1]:
            duties, means = duties[::-1], means[::-1]
        if not means[0] <= mean <= means[-1]:
            raise ValueError(
                f"mean: found {1e3 * mean:.4g} mm, expected {1e3 * means[0]:.4g} to {1e3 * means[-1]:.4g} mm, which "
                f"the map reaches at {frequency:g} Hz"
            )
        return float(np.interp(mean, means, duties))


def duty_map(
    machine: Machine, duties: ArrayLike, frequencies: ArrayLike, *, progress: Callable[[int], object] | None = None
) -> DutyMap:
    """Return mean position and ripple of the nonlinear machine over duty and frequency.

    Parameters
    ----------
    machine : Machine
    duties : array_like, shape (n_duties,)
    frequencies : array_like, shape (n_frequencies,)
        [Hz]
    progress : callable, optional
        Called with 1 after each point.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> from ltvpneu import design
    >>> found = design.duty_map(lp.load_machine("kunt_singh_1990"), [0.3, 0.4, 0.5], [15.0])
    >>> print(f"{found.duty_for(0.045, 15.0):.3f}")
    0.421
    """
    return DutyMap(orbits=orbit_map(machine, duties, frequencies, progress=progress))
