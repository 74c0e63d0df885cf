"""Outcomes that a caller may catch by name.

Wrong input raises `ValueError` or `TypeError`; the classes here are for questions that were well put and have no
answer, or not the one asked for. Each carries its figures as attributes. numpy loads where it is needed only, so that
the command line can name an error before anything else is loaded.
"""

from typing import Any


class LtvpneuError(Exception):
    """Base of every outcome in this module.

    Errors can be pickled, so that a pool of processes hands them on, and equal ones compare equal.
    """

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how to make the error anew: with its message and its figures, past its own constructor."""
        from ltvpneu._values import packed

        return _rebuilt, (type(self), self.args, packed(vars(self)))

    def __eq__(self, other: object) -> bool:
        """Whether another error is of the same class and carries the same message and figures."""
        if not isinstance(other, LtvpneuError) or type(self) is not type(other):
            return NotImplemented
        from ltvpneu._values import same

        return same(self.args, other.args) and same(vars(self), vars(other))

    def __hash__(self) -> int:
        """Return a number that equal errors share."""
        return hash((type(self), str(self)))


def _rebuilt(kind: type[LtvpneuError], args: tuple[Any, ...], figures: dict[str, Any]) -> LtvpneuError:
    error = kind.__new__(kind, *args)
    error.args = args
    from ltvpneu._values import unpacked

    vars(error).update(unpacked(figures))
    return error


class MachineFileError(LtvpneuError, ValueError):
    """A machine file that cannot be read; the message names the file, the key and what was expected."""


class NoOrbitError(LtvpneuError):
    """No periodic steady state exists: every period drifts by `drift`.

    Attributes
    ----------
    drift : ndarray, shape (n_states,)
        What the state gains in each period along the directions that do not return.
    """

    def __init__(self, message: str, *, drift: Any) -> None:
        super().__init__(message)
        self.drift = drift


class NonUniqueOrbitError(LtvpneuError):
    """A whole family of periodic steady states exists: a Floquet multiplier equals one.

    Attributes
    ----------
    least_norm : ndarray, shape (n_states,)
        The initial state nearest the origin among all periodic ones.
    free_directions : ndarray, shape (n_states, n_free)
        Unit vectors along which the initial state may be moved.
    """

    def __init__(self, message: str, *, least_norm: Any, free_directions: Any) -> None:
        super().__init__(message)
        self.least_norm = least_norm
        self.free_directions = free_directions


class StepOverflowError(LtvpneuError):
    """A step of a periodic system grows by more than double precision holds."""


class NotStableError(LtvpneuError):
    """A quantity that only a stable system has was asked of one that is not, or not safely.

    Attributes
    ----------
    floquet : Floquet
        The system's multipliers and the margin of the verdict.
    """

    def __init__(self, message: str, *, floquet: Any) -> None:
        super().__init__(message)
        self.floquet = floquet


class NotStabilizableError(LtvpneuError):
    """A periodic Riccati equation has no stabilizing solution.

    Attributes
    ----------
    multipliers : ndarray of complex
        Of the closed loop nearest to stability that was found, largest first; the system's own where none was.
    """

    def __init__(self, message: str, *, multipliers: Any) -> None:
        super().__init__(message)
        self.multipliers = multipliers


class SkippedStepError(LtvpneuError):
    """A solver that knows nothing of switches jumped over a whole step of a periodic system.

    Attributes
    ----------
    time : float
        When the step began [s].
    step : int
        Which, from 0.
    """

    def __init__(self, message: str, *, time: float, step: int) -> None:
        super().__init__(message)
        self.time = time
        self.step = step


class NotSettledError(LtvpneuError):
    """A nonlinear simulation did not settle on a periodic orbit.

    Attributes
    ----------
    residual : float
        Largest scaled change of the state over the best-matching number of valve periods [-].
    n_simulated : int
        Valve periods simulated.
    last_state : ndarray, shape (n_states,)
        The state at the end; not periodic.
    """

    def __init__(self, message: str, *, residual: float, n_simulated: int, last_state: Any) -> None:
        super().__init__(message)
        self.residual = residual
        self.n_simulated = n_simulated
        self.last_state = last_state


class TimeLimitError(LtvpneuError):
    """A call took longer than its `max_seconds`.

    Attributes
    ----------
    seconds : float
        That it was allowed.
    """

    def __init__(self, message: str, *, seconds: float) -> None:
        super().__init__(message)
        self.seconds = seconds


class NotConvergedError(LtvpneuError):
    """An iteration did not reach its tolerance.

    For a linear model's operating points or cycle, for multipliers of close moduli, or for steps that stand for smooth
    coefficients.

    Attributes
    ----------
    residual : float
        Largest scaled difference that was left [-]: of operating points and step means, of the state over a period, or
        of the map over a part; infinite where none is known.
    iterations : int
        Rounds; of a linear model, valve periods marched.
    """

    def __init__(self, message: str, *, residual: float, iterations: int) -> None:
        super().__init__(message)
        self.residual = residual
        self.iterations = iterations


class IntegrationError(LtvpneuError):
    """The nonlinear equations could not be integrated on.

    Attributes
    ----------
    time : float
        When it stopped [s].
    state : ndarray, shape (n_states,)
        Where it stopped.
    """

    def __init__(self, message: str, *, time: float, state: Any) -> None:
        super().__init__(message)
        self.time = time
        self.state = state


class ChamberVolumeError(IntegrationError):
    """The piston swept a chamber's volume down to zero."""


class CavitationError(IntegrationError):
    """The pressure of a liquid fell to its vapor pressure, below which the model has no laws."""


class GasRangeError(LtvpneuError, ValueError):
    """A real gas asked for where it is no gas, or where its equation of state ends or is too rough to tabulate.

    Attributes
    ----------
    pressure, temperature : float
        The state in question [Pa, K].
    """

    def __init__(self, message: str, *, pressure: float, temperature: float) -> None:
        super().__init__(message)
        self.pressure = pressure
        self.temperature = temperature


class NotConvexError(LtvpneuError, ValueError):
    """An objective or constraint that convex programming cannot take; the message passes on cvxpy's reason."""


class SolverError(LtvpneuError):
    """A solver ended without an answer that can be trusted.

    Attributes
    ----------
    status : str
        The solver's own word for it.
    """

    def __init__(self, message: str, *, status: str) -> None:
        super().__init__(message)
        self.status = status
