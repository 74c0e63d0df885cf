"""Stability of a linear model's cycle: through its operating points, where these follow the cycle.

The steps of a fitted or self-consistent model are linearized about the cycle that they make. A disturbance moves their
operating points too, and where a step covers a bend, as at an end stop, only that shows what becomes of it: with the
steps kept as they are, their product may grow without bound where the machine is as stable as can be.
"""

from dataclasses import replace

import numpy as np

from ltvpneu._arrays import FloatArray, read_only
from ltvpneu.models.cycles.turns import TOLERANCE, march_beside, slopes_along_turn
from ltvpneu.models.linear.model import LtvModel
from ltvpneu.models.linear.own_cycle import Found
from ltvpneu.models.linear.repeat import STATE_STEP
from ltvpneu.models.machine.machine import Machine
from ltvpneu.models.nonlinear.method import TIGHTER
from ltvpneu.periodic.orbits.floquet import Floquet, floquet, orbit_multipliers
from ltvpneu.periodic.orbits.modes import Maps

MARGIN = TIGHTER * TOLERANCE / STATE_STEP
"""How far differences may put a multiplier off [-]: what pressures are marched to, over the step."""


def cycle_floquet(model: LtvModel) -> Floquet:
    """Return the Floquet multipliers of a linear model's cycle.

    Parameters
    ----------
    model : LtvModel
        Of "fitted" and "self-consistent" models, by central differences of the march that fits the steps, over the
        cycle's own period; of others `floquet` of the system, whose operating points do not depend on its state.

    Returns
    -------
    Floquet

    Raises
    ------
    NotConvergedError
        A march next to the cycle did not come through.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> model = lp.ltv_model(lp.load_machine("kunt_singh_1990"), 8.0, operating_points="fitted")
    >>> print(f"{lp.cycle_floquet(model).spectral_radius:.2f}")
    0.22
    """
    found = model.found
    if not isinstance(found, Found):
        return floquet(model.system)
    question, scales = found.question, model.machine.state_scales

    def end(start: FloatArray, machine: Machine, frequency: float) -> FloatArray:
        same = replace(question, machine=machine, frequency=frequency)
        return march_beside(start, same, found.cells, found.repeated.n_periods)[0]

    at = model.machine, model.frequency, model.orbit.initial_state
    monodromy = slopes_along_turn(end, at, ()).by_state
    if not model.orbit.is_isolated:
        # Set beside, within the stiction band, the piston stays, also where this cycle creeps to the band's edge.
        monodromy[0, 0], monodromy[1, 0] = 1.0, 0.0
    maps = Maps(
        factors=read_only(monodromy * scales / scales[:, None])[None],
        durations=np.array([model.orbit.period]),
        starts=np.zeros(1, dtype=np.int64),
        scales=scales,
    )
    return orbit_multipliers(model.orbit, maps, MARGIN)
