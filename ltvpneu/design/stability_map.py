"""Stability and ripple over duty and frequency, and where one Lyapunov function proves the stability.

Two regions are certified, by one function of a box of operating points. Where it proves decay for every step matrix of
a point's LTV model, that model is stable at any duty, pattern and frequency of these steps. Where moreover the
nonlinear machine's whole cycle stays in the box, the same holds of every G (8b) along the cycle, at any instant. G is
the paper's linearization, whose pressure rows are those at rest and which leaves dry friction out: of the machine's own
motions the full tangent tells (`operating_box(..., tangent="full")`), and `orbit_floquet`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from ltvpneu._arrays import BoolArray, FloatArray, read_only
from ltvpneu._values import Value
from ltvpneu.design.certificate import Certificate, common_lyapunov, verified_rate
from ltvpneu.design.operating_box import operating_box, why_no_box
from ltvpneu.errors import LtvpneuError
from ltvpneu.models.cycles.floquet import cycle_floquet
from ltvpneu.models.cycles.orbit_map import MAP_SPREAD, grid_of
from ltvpneu.models.linear.ltv import ltv_model
from ltvpneu.models.linear.model import LtvModel
from ltvpneu.models.linear.modes import OperatingPoints
from ltvpneu.models.machine.machine import Machine, expect_machine
from ltvpneu.models.nonlinear.attractors import attractors
from ltvpneu.models.nonlinear.failed_point import FailedPoint

SHRINKINGS = 7
"""Rounds in which the widest box with a common function is closed in on."""


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class Box(Value):
    """Limits of operating points."""

    position: tuple[float, float]
    """[m]"""
    pressures: tuple[tuple[float, float], ...]
    """Of each chamber, absolute [Pa]."""


@final
@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class StabilityMap(Value):
    """Stability and ripple over frequency (rows) and duty (columns), each array (n_frequencies, n_duties)."""

    machine: Machine
    frequencies: FloatArray
    """[Hz]"""
    duties: FloatArray
    box: Box | None
    """Of operating points that the certificate is for; None where no box has a common function."""
    certificate: Certificate | None
    """Of the box."""
    spectral_radii: FloatArray
    """Of the LTV model over its period: below one it is stable; nan where there is no model."""
    margins: FloatArray
    """To which the radii are computed."""
    decay_rates: FloatArray
    """That the certificate's function proves for the steps of that point's LTV model, whatever the switching [1/s];
    zero or less, or nan: nothing is proved."""
    amplitudes: FloatArray
    """Of the position on the cycle that the nonlinear machine settles on from rest [m]; nan where it has none."""
    is_isolated: BoolArray
    """Whether that cycle is isolated, not one of a stiction band."""
    depends_on_start: BoolArray
    """Whether other starts lead the nonlinear machine to other cycles (`attractors`)."""
    stays_in_box: BoolArray
    """Whether the whole of that cycle stays in the box."""
    failures: tuple[FailedPoint, ...]
    remark: str = ""
    """Why there is no certificate, where a machine of this kind has no box."""

    def __repr__(self) -> str:
        n, found = self.spectral_radii.size, self.is_certified
        return (
            f"<StabilityMap of {self.machine.name}: {n} points, {int(self.is_stable.sum())} stable, "
            f"{int(found.sum())} certified, {int((found & self.stays_in_box).sum())} with their whole cycle>"
        )

    @property
    def is_stable(self) -> BoolArray:
        """Whether the LTV model's multipliers lie inside the unit circle."""
        return self.spectral_radii < 1 - self.margins

    @property
    def is_certified(self) -> BoolArray:
        """Whether the certificate proves the LTV model's steps stable under any switching."""
        return self.decay_rates > 0


def stability_map(  # noqa: PLR0913 - keyword-only, each with its default
    machine: Machine,
    duties: ArrayLike,
    frequencies: ArrayLike,
    *,
    box: Box | None = None,
    n_steps: int | None = None,
    operating_points: OperatingPoints = "lti",
    progress: Callable[[int], object] | None = None,
) -> StabilityMap:
    """Return where the machine's cycle is stable, how it ripples, and where one Lyapunov function proves it.

    Parameters
    ----------
    machine : Machine
    duties : array_like, shape (n_duties,)
    frequencies : array_like, shape (n_frequencies,)
        [Hz]
    box : Box, optional
        Of operating points to certify; by default the widest one about the middle of those on the map, in proportion to
        their spread, that has a common function. A machine that has no such box gets none, and `.remark` says why.
    n_steps, operating_points
        As of `ltv_model`.
    progress : callable, optional
        Called with 1 after each point.

    Returns
    -------
    StabilityMap
        Points that fail are kept in `.failures`, their figures nan.

    Raises
    ------
    ValueError
        Duties or frequencies out of range, a box out of order, or one for a machine that has none.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> from ltvpneu import design
    >>> found = design.stability_map(lp.load_machine("kunt_singh_1990"), [0.4, 0.5], [8.0, 15.0])
    >>> found.is_stable.all(), found.is_certified.all()
    (np.True_, np.True_)
    """
    expect_machine(machine)
    duty_grid, frequency_grid = grid_of(duties, frequencies)
    shape = (frequency_grid.size, duty_grid.size)
    models, failures = dict[tuple[int, int], LtvModel](), list[FailedPoint]()
    arrays = {name: np.full(shape, np.nan) for name in ("spectral_radii", "margins", "decay_rates", "amplitudes")}
    is_isolated, depends = np.zeros(shape, dtype=np.bool_), np.zeros(shape, dtype=np.bool_)
    ranges = np.full((*shape, 2, len(machine.states)), np.nan)
    for place in np.ndindex(shape):
        present, frequency = machine.with_duty(float(duty_grid[place[1]])), float(frequency_grid[place[0]])
        try:
            model = models[place] = ltv_model(present, frequency, n_steps=n_steps, operating_points=operating_points)
            found = cycle_floquet(model)
            arrays["spectral_radii"][place], arrays["margins"][place] = found.spectral_radius, found.margin
        except (LtvpneuError, ValueError) as error:
            failures.append(FailedPoint(model="ltv", frequency=frequency, duty=present.duty, error=error))
        settled = attractors(present, frequency, n_spread=MAP_SPREAD)
        depends[place] = bool(settled.orbits) and not settled.is_single
        if settled.reached[0] >= 0:
            orbit = settled.orbits[settled.reached[0]]
            is_isolated[place], arrays["amplitudes"][place] = orbit.is_isolated, orbit.amplitude("position")
            ranges[place] = [[side(name) for name in machine.states] for side in (orbit.minimum, orbit.maximum)]
        else:
            failures.append(settled.failures[0])
        if progress is not None:
            progress(1)
    remark = why_no_box(machine) if box is None else ""
    certificate = None
    if box is None and not remark:
        box, certificate = _widest_box(machine, [model.operating_points for model in models.values()])
    elif box is not None:
        certificate = common_lyapunov(operating_box(machine, position=box.position, pressures=box.pressures))
    stays = np.zeros(shape, dtype=np.bool_)
    if certificate is not None and certificate.is_stable and box is not None:
        for place, model in models.items():
            arrays["decay_rates"][place] = verified_rate(model.system.A, certificate.functions[0])
        limits = np.array([box.position, *box.pressures])
        visited = np.delete(ranges, 1, axis=3)
        inside = (visited[:, :, 0] >= limits[:, 0]) & (visited[:, :, 1] <= limits[:, 1])
        stays = np.logical_and.reduce(inside, axis=2)
    return StabilityMap(
        machine=machine,
        frequencies=frequency_grid,
        duties=duty_grid,
        box=box,
        certificate=certificate,
        is_isolated=read_only(is_isolated),
        depends_on_start=read_only(depends),
        stays_in_box=read_only(stays),
        failures=tuple(failures),
        remark=remark,
        **{name: read_only(values) for name, values in arrays.items()},
    )


def _widest_box(machine: Machine, points: Sequence[FloatArray]) -> tuple[Box | None, Certificate | None]:
    """Return the widest box about the middle of operating points that has a common function, and that function."""
    if not points:
        return None, None
    visited = np.delete(np.concatenate(points), 1, axis=1)
    middle, low, high = np.median(visited, axis=0), visited.min(axis=0), visited.max(axis=0)
    best: tuple[Box | None, Certificate | None] = None, None
    least, most = 0.0, 1.0
    for attempt in range(SHRINKINGS):
        share = 1.0 if attempt == 0 else 0.5 * (least + most)
        limits = np.column_stack([middle + share * (low - middle), middle + share * (high - middle)]).tolist()
        box = Box(position=(limits[0][0], limits[0][1]), pressures=tuple((a, b) for a, b in limits[1:]))
        try:
            found = common_lyapunov(operating_box(machine, position=box.position, pressures=box.pressures))
        except ValueError:
            # Reaches an open source's pressure, or an end of the cylinder.
            found = None
        if found is not None and found.is_stable:
            best, least = (box, found), share
            if share == 1.0:
                break
        else:
            most = share
    return best
