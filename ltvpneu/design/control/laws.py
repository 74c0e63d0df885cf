"""What a controller sees, and every kind of controller as one: a function from that to what each valve is told."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, final

import numpy as np

from ltvpneu._arrays import FloatArray, finite, not_negative
from ltvpneu._values import Value
from ltvpneu.models.machine.machine import Machine
from ltvpneu.periodic.systems import bridge
from ltvpneu.physics.on_off_valve import OnOffValve

if TYPE_CHECKING:
    import control


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class Measurement(Value):
    """What a controller sees at the start of a period."""

    number: int
    """Of the period, from 0."""
    time: float
    """[s]"""
    reference: float
    """Wanted mean position [m]."""
    mean_position: float
    """Over the last period, as the sensor has it [m]; at first, over one that the machine's own duty makes from the
    initial state."""
    state: FloatArray
    """(n_states,), now, as it is."""
    duty: float = math.nan
    """Share of the last period that the valve was open; at first, the machine's own; nan where it is not known."""
    position: float = math.nan
    """Now, as the sensor has it [m]."""


@final
@dataclass(frozen=True, kw_only=True)
class Sensor(Value):
    """What a position sensor makes of the position.

    Examples
    --------
    >>> import numpy as np
    >>> from ltvpneu import design
    >>> round(design.Sensor(quantization=1e-4).seen(0.04567, np.random.default_rng(0)), 6)
    0.0457
    """

    noise: float = 0.0
    """Standard deviation of every number measured, normally distributed [m]."""
    quantization: float = 0.0
    """Step of the numbers measured [m]; zero for none."""
    delay: float = 0.0
    """By which they are old [s]."""

    def __post_init__(self) -> None:
        not_negative("noise", self.noise, "m")
        not_negative("quantization", self.quantization, "m")
        not_negative("delay", self.delay, "s")

    def seen(self, position: float, generator: np.random.Generator) -> float:
        """Return what is measured of a position [m]."""
        if self.noise:
            position += self.noise * float(generator.standard_normal())
        return self.quantization * round(position / self.quantization) if self.quantization else position


Told = float | bool | Mapping[str, float] | Sequence[float]
Controller = Callable[[Measurement], Told]
"""From a measurement to the duty of the next period; or to those of all valves, by name or in order. True is always on,
False always off."""
Law = Callable[[Measurement], FloatArray]
"""Likewise, to an array of what each valve is told, (n_valves,)."""


def valve_names(machine: Machine) -> tuple[str, ...]:
    """Return the names of a machine's valves: "valve", "valve_2" and so on."""
    return ("valve", *(f"valve_{i + 2}" for i in range(len(machine.more_valves))))


def own_duties(machine: Machine) -> FloatArray:
    """Return the duties of a machine's valves, (n_valves,).

    Raises
    ------
    ValueError
        A valve is proportional.
    """
    others = [valve.duty for valve in machine.more_valves if isinstance(valve, OnOffValve)]
    if len(others) < len(machine.more_valves):
        raise ValueError("machine: found a proportional valve, expected valves that switch")
    return np.array([machine.duty, *others])


def law_of(controller: "Controller | control.StateSpace | control.TransferFunction", machine: Machine,
           period: float) -> Law:  # fmt: skip
    """Return a controller as a function from a measurement to what each valve is told.

    Raises
    ------
    TypeError
        It is no controller.
    ValueError
        A system of another dt, or of inputs and outputs that are not there. Later, from the law: values that are no
        numbers, or are not one for each valve.
    """
    if _is_system(controller):
        return _law_of_system(controller, machine, period)
    if not callable(controller):
        raise TypeError(
            f"controller: found {type(controller).__name__}, expected a function of a Measurement, a "
            "control.StateSpace or a control.TransferFunction"
        )
    names, own = valve_names(machine), own_duties(machine)

    def law(measured: Measurement) -> FloatArray:
        told: Any = controller(measured)
        where = f"controller: at {measured.time:g} s"
        if isinstance(told, Mapping):
            given: Mapping[str, Any] = told  # pyright: ignore[reportUnknownVariableType]
            if set(given) != set(names):
                raise ValueError(
                    f"{where}: found values for {', '.join(map(str, given)) or 'no valve'}, expected one for each of "
                    f"{', '.join(names)}"
                )
            return np.array([finite(f"{where}: {name}", float(given[name])) for name in names])
        if np.ndim(told) == 0:
            # Of several valves the others keep their own.
            return np.array([finite(where, float(told)), *own[1:]])
        values = np.asarray(told, dtype=np.float64).ravel()
        if values.size != len(names):
            raise ValueError(f"{where}: found {values.size} values, expected one for each of {', '.join(names)}")
        return np.array([finite(f"{where}: {name}", value) for name, value in zip(names, values.tolist(), strict=True)])

    return law


def _is_system(controller: object) -> bool:
    return hasattr(controller, "dt") and (hasattr(controller, "A") or hasattr(controller, "num"))


def _law_of_system(system: Any, machine: Machine, period: float) -> Law:
    if system.dt is True or system.dt is None or not np.isclose(float(system.dt), period, rtol=1e-9):
        raise ValueError(f"controller: found dt = {system.dt}, expected the period, {period:g} s")
    labels = list(system.input_labels)
    system = bridge.as_state_space(system)
    A, B, C, D = (np.asarray(matrix, dtype=np.float64) for matrix in (system.A, system.B, system.C, system.D))
    names, own = valve_names(machine), own_duties(machine)
    if D.shape[0] not in (1, len(names)):
        raise ValueError(f"controller: found {D.shape[0]} outputs, expected one, or one for each of {', '.join(names)}")
    inputs = ["error"] if D.shape[1] == 1 and labels[0] not in known_inputs(machine) else labels
    for label in inputs:
        if label not in known_inputs(machine):
            raise ValueError(f"controller: found input {label!r}, expected some of {', '.join(known_inputs(machine))}")
    state = np.zeros(len(A))

    def law(measured: Measurement) -> FloatArray:
        nonlocal state
        seen = np.array([_seen(label, measured, machine) for label in inputs])
        change = C @ state + D @ seen
        state = A @ state + B @ seen
        told = own.copy()
        told[: change.size] += change
        if not np.isfinite(told).all():
            raise ValueError(f"controller: at {measured.time:g} s: found {told}, expected finite numbers")
        return told

    return law


def known_inputs(machine: Machine) -> tuple[str, ...]:
    """Return what a system's inputs may be called."""
    return ("error", "reference", "mean_position", "measured_position", *machine.states)


def _seen(label: str, measured: Measurement, machine: Machine) -> float:
    if label == "error":
        return measured.reference - measured.mean_position
    if label == "measured_position":
        return measured.position
    if label in ("reference", "mean_position"):
        return float(getattr(measured, label))
    return float(measured.state[machine.states.index(label)])
