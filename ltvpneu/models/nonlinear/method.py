"""How the nonlinear equations are integrated: the adaptive method, and the paper's with a fixed step."""

from dataclasses import dataclass
from typing import final

from ltvpneu._arrays import positive, whole
from ltvpneu._values import Value
from ltvpneu.models.machine.machine import Machine
from ltvpneu.models.nonlinear.runge_kutta import AdaptiveSettings, FixedSettings, Settings


@final
@dataclass(frozen=True, kw_only=True)
class DormandPrince(Value):
    """The adaptive method: step control, stick and slip located as events.

    Parameters
    ----------
    rtol : float
        Relative error tolerated in a step [-].
    """

    rtol: float = 1e-8

    def __post_init__(self) -> None:
        if not 1e-13 <= positive("rtol", self.rtol) < 1:
            raise ValueError(f"rtol: found {self.rtol:g}, expected 1e-13 to 1")


@final
@dataclass(frozen=True, kw_only=True)
class RungeKutta4(Value):
    """The paper's method: fourth order with a fixed step, stick and slip as they are at the end of a step.

    Parameters
    ----------
    steps_per_period : int
        Least number of steps in a valve period; each interval between switching instants has a whole number of them.
    """

    steps_per_period: int = 1000

    def __post_init__(self) -> None:
        whole("steps_per_period", self.steps_per_period)


Method = DormandPrince | RungeKutta4
DEFAULT = DormandPrince()


# Where pressures meet the slope of the flow is infinite, and steps that resolve small differences multiply: of an orbit
# pressures need not be right to less than 1e-7 of the supply; what is differenced is asked for more tightly.
LEAST_PRESSURE_TOLERANCE, TIGHTER = 1e-7, 100.0
MAX_STEPS = 5_000_000
"""Steps that a period may take before the integration is given up."""


def settings_of(machine: Machine, period: float, method: Method) -> Settings:
    """Return the settings of a method for valve periods of a length [s]."""
    if isinstance(method, RungeKutta4):
        return FixedSettings(period / method.steps_per_period, MAX_STEPS)
    return integration_settings(machine, method.rtol)


def integration_settings(machine: Machine, rtol: float) -> AdaptiveSettings:
    """Return the adaptive method's settings for a relative tolerance."""
    scales = machine.state_scales
    atol = rtol * scales
    pressures = slice(2, 2 + machine.n_volumes)
    atol[pressures] = max(rtol, min(LEAST_PRESSURE_TOLERANCE, TIGHTER * rtol)) * scales[pressures]
    return AdaptiveSettings(float(rtol), MAX_STEPS, atol)
