"""`Step`: one step of a periodic system, on its own."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, final

import numpy as np

from ltvpneu._arrays import FloatArray
from ltvpneu._values import Value
from ltvpneu.periodic.systems import bridge
from ltvpneu.periodic.systems.bridge import CONSTANT_INPUT

if TYPE_CHECKING:
    import control


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class Step(Value):
    """One step: z' = A z + B u + r, y = C z + D u + q over a duration."""

    duration: float
    """[s]"""
    A: FloatArray
    """(n, n)"""
    B: FloatArray
    """(n, m)"""
    r: FloatArray
    """(n,)"""
    C: FloatArray
    """(p, n)"""
    D: FloatArray
    """(p, m)"""
    q: FloatArray
    """(p,)"""
    f: FloatArray
    """B u + r at the system's input levels, (n,)"""
    names: tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]
    """Of states, inputs and outputs."""
    name: str

    @property
    def sys(self) -> "control.StateSpace":
        """The step as a named `control.StateSpace`.

        Where the step has a remainder r or an output offset q, a last input named "one" carries them.
        """
        states, inputs, outputs = self.names
        B, D = self.B, self.D
        if self.r.any() or self.q.any():
            B, D = np.column_stack([B, self.r]), np.column_stack([D, self.q])
            inputs = (*inputs, CONSTANT_INPUT)
        return bridge.state_space((self.A, B, self.C, D), (states, inputs, outputs), self.name)
