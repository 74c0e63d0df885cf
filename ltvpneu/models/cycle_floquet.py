"""Stability of a linear model's cycle: through its operating points, where these follow the cycle.

The steps of a fitted or self-consistent model are linearized about the cycle that they make. A disturbance moves their
operating points too, and where a step covers a bend, as at an end stop, only that shows what becomes of it: with the
steps kept as they are, their product may grow without bound where the machine is as stable as can be.
"""

import numpy as np

from ltvpneu._arrays import FloatArray, read_only
from ltvpneu.errors import NotConvergedError
from ltvpneu.models.integrator import OK
from ltvpneu.models.linearize import LtvModel
from ltvpneu.models.march import march_period
from ltvpneu.models.own_cycle import Found, new_steps
from ltvpneu.models.parameters import STATE_STEP, TOLERANCE
from ltvpneu.models.variational import OrbitFloquet
from ltvpneu.periodic.floquet import Floquet, floquet
from ltvpneu.periodic.product import product_multipliers

MARGIN = TOLERANCE / STATE_STEP
"""How far differences may put a multiplier off [-]."""


def cycle_floquet(model: LtvModel) -> Floquet | OrbitFloquet:
    """Return the Floquet multipliers of a linear model's cycle.

    Parameters
    ----------
    model : LtvModel
        Of "fitted" and "self-consistent" models, by central differences of the march that fits the steps, over the
        cycle's own period; of others `floquet` of the system, whose operating points do not depend on its state.

    Returns
    -------
    Floquet or OrbitFloquet

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
    plan, steps = found.question.plan(found.cells, TOLERANCE), new_steps(found.question, found.cells)
    scales = model.machine.state_scales
    n = scales.size

    def end(start: FloatArray) -> FloatArray:
        state = np.append(start, 1.0)
        for _ in range(found.repeated.n_periods):
            marched = march_period(state, plan, steps)
            if marched.status != OK:
                raise NotConvergedError(
                    f"the march next to the {model.mode} model's cycle at {model.frequency:g} Hz did not come through, "
                    "so its stability is not known; take other steps, or lp.orbit_floquet of the nonlinear orbit",
                    residual=marched.defect,
                    iterations=1,
                )
            state = marched.state.copy()
        return state[:-1]

    start, moves = model.orbit.initial_state / scales, STATE_STEP * np.eye(n)
    scaled = np.column_stack([(end(start + move) - end(start - move)) / (2 * STATE_STEP) for move in moves])
    return OrbitFloquet(
        orbit=model.orbit,
        product=product_multipliers([scaled]),
        monodromy=read_only(scaled * scales[:, None] / scales),
        margin=MARGIN,
    )
