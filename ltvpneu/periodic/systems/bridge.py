"""The one door to python-control, which is loaded on first use: it takes longer to load than most analyses to run."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ltvpneu._arrays import ComplexArray, FloatArray, finite_array

if TYPE_CHECKING:
    import control

CONSTANT_INPUT = "one"
"""Name of the input, of level 1, that carries affine terms."""


def state_space(
    matrices: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    names: tuple[Sequence[str], Sequence[str], Sequence[str]],
    name: str,
    dt: float = 0.0,
) -> "control.StateSpace":
    """Return A, B, C, D as a `control.StateSpace` with names of states, inputs and outputs; dt = 0: continuous time."""
    import control

    states, inputs, outputs = names
    A, B, C, D = matrices
    if not inputs:
        # python-control knows no system without inputs: one that does nothing stands in.
        B, D, inputs = np.zeros((len(A), 1)), np.zeros((len(C), 1)), (CONSTANT_INPUT,)
    # Copies: python-control's arrays are writable, and ours are not to be.
    return control.StateSpace(
        *(matrix.copy() for matrix in (A, B, C, D)),
        dt,
        states=list(states),
        inputs=list(inputs),
        outputs=list(outputs),
        name=name,
    )


def time_response(
    times: FloatArray,
    states: tuple[Sequence[str], FloatArray],
    outputs: tuple[Sequence[str], FloatArray],
    name: str,
) -> "control.TimeResponseData":
    """Return a `control.TimeResponseData`, values with time last.

    Parameters
    ----------
    times : ndarray, shape (n_times,)
    states, outputs : (names, ndarray of shape (n, n_times))
    name : str
        Of the system.
    """
    import control

    return control.TimeResponseData(
        times,
        outputs[1],
        states[1],
        state_labels=list(states[0]),
        output_labels=list(outputs[0]),
        sysname=name,
        issiso=False,
    )


def frequency_response(
    omega: FloatArray, values: ComplexArray, names: tuple[Sequence[str], Sequence[str]], name: str
) -> "control.FrequencyResponseData":
    """Return a `control.FrequencyResponseData`.

    Parameters
    ----------
    omega : ndarray, shape (n_frequencies,)
        [rad/s]
    values : ndarray, shape (n_outputs, n_inputs, n_frequencies)
    names : (outputs, inputs)
    name : str
        Of the system.
    """
    import control

    outputs, inputs = names
    return control.FrequencyResponseData(
        values, omega.copy(), outputs=list(outputs), inputs=list(inputs), sysname=name, name=f"{name}_response"
    )


def as_state_space(system: Any) -> Any:
    """Return a `control.TransferFunction` as a `control.StateSpace`; anything else as it is."""
    import control

    return control.ss(system) if isinstance(system, control.TransferFunction) else system


Names = tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]
"""Of states, inputs and outputs."""


def matrices_of(
    operand: Any, dt: float | None = 0.0
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, Names, str]:
    """Return A, B, C, D, the names and the name of a time-invariant system or of a constant gain.

    Raises
    ------
    TypeError, ValueError
        Neither, or a system of another sampling time than dt [s], zero in continuous time.
    """
    import control

    operand = as_state_space(operand)
    if isinstance(operand, control.StateSpace):
        if dt == 0 and operand.isdtime(strict=True):
            raise ValueError(f"{operand.name}: found discrete time (dt = {operand.dt}), expected continuous time")
        # In python-control, a dt of True stands for any sampling time, and None for either kind of time.
        if dt != 0 and not (operand.dt is None or operand.dt is True or _is_close(operand.dt, dt)):
            wanted = "a gain, as the steps differ in length" if dt is None else f"dt = {dt:g} s"
            raise ValueError(f"{operand.name}: found dt = {operand.dt}, expected {wanted}")
        parts = [finite_array(letter, getattr(operand, letter)) for letter in "ABCD"]
        names = (tuple(operand.state_labels), tuple(operand.input_labels), tuple(operand.output_labels))
        return parts[0], parts[1], parts[2], parts[3], names, operand.name
    if isinstance(operand, control.InputOutputSystem | str) or operand is None:
        raise TypeError(
            f"operand: found {type(operand).__name__}, expected a PeriodicSystem, a control.StateSpace or a gain matrix"
        )
    gain = finite_array("gain", np.atleast_2d(operand), (None, None))
    p, m = gain.shape
    names = ((), tuple(f"u{i + 1}" for i in range(m)), tuple(f"y{i + 1}" for i in range(p)))
    return np.zeros((0, 0)), np.zeros((0, m)), np.zeros((p, 0)), gain, names, "gain"


def _is_close(dt: float, wanted: float | None) -> bool:
    return wanted is not None and abs(dt - wanted) <= 1e-9 * wanted
