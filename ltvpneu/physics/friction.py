"""Dry friction and stiction, eq. (7c) with erratum E5: stiction holds in both directions.

At rest the piston stays while the external force is at most F_s in size; it breaks away in the direction of that
force. In motion the dry friction F_d opposes the velocity. Viscous friction C_v v is a matter of the load.

Should F_d exceed F_s, a piston that breaks away between the two would be stopped at once, so the force that holds it
is the larger of the two (Filippov's reading of the sign function).
"""

from ltvpneu._compiled import compiled


@compiled
def holding_force(dry_friction: float, stiction: float) -> float:
    """Largest force that leaves a piston at rest [N]."""
    return max(dry_friction, stiction)


@compiled
def slip_direction(force: float, hold_down: float, hold_up: float) -> int:
    """Direction in which a piston at rest breaks away: +1, -1, or 0 while it sticks, eq. (7c).

    `hold_down` and `hold_up` are the forces [N] it withstands towards lower and higher positions; infinite at a stop.
    """
    if force > hold_up:
        return 1
    if force < -hold_down:
        return -1
    return 0
