"""Mass that an orbit or a transient draws from a source, from what its integration recorded."""

import numpy as np

from ltvpneu.models.machine.machine import Machine
from ltvpneu.models.machine.supply_flow import source_flow
from ltvpneu.models.nonlinear.integrator import Record

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(4)


def mass_drawn(record: Record, machine: Machine, frequency: float, *, from_supply: bool = True) -> float:
    """Return the mass that came out of the supply, or out of the exhaust, over a record [kg]; negative what went in."""
    table = machine.openings
    pieces = record.pieces % (table.fractions.size - 1)
    local = 0.5 * (_NODES + 1) * record.spans[:, None]
    states = np.einsum("itk,ikn->itn", local[:, :, None] ** np.arange(5), record.coefficients)
    turn = np.mod(record.starts * frequency + 1e-12, 1.0)[:, None] + local * frequency
    areas = table.areas_at(turn, np.broadcast_to(pieces[:, None], turn.shape))
    flows = source_flow(
        np.ascontiguousarray(states.reshape(-1, states.shape[2])),
        np.ascontiguousarray(areas.reshape(-1, *areas.shape[2:])),
        from_supply,
        machine.record,
    )
    return float((0.5 * _WEIGHTS * record.spans[:, None]).ravel() @ flows)
