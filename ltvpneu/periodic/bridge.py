"""The one door to python-control, which is loaded on first use: it takes longer to load than most analyses to run."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from ltvpneu._arrays import ComplexArray, FloatArray

if TYPE_CHECKING:
    import control


def state_space(
    matrices: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    names: tuple[Sequence[str], Sequence[str], Sequence[str]],
    name: str,
    dt: float = 0.0,
) -> "control.StateSpace":
    """Return A, B, C, D as a `control.StateSpace` with names of states, inputs and outputs; dt = 0: continuous time."""
    import control

    states, inputs, outputs = names
    # Copies: python-control's arrays are writable, and ours are not to be.
    return control.StateSpace(
        *(matrix.copy() for matrix in matrices),
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
