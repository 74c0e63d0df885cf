"""Two periodic systems as one: the matrices of a connection.

Within a step all coefficients are constant, so that a connection is again a periodic system, on steps that both have.
"""

from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from ltvpneu._arrays import FloatArray
from ltvpneu.periodic.systems import bridge

if TYPE_CHECKING:
    # Whose operators come here.
    from ltvpneu.periodic.systems.coefficients import Coefficients

System = TypeVar("System", bound="Coefficients")


def in_series(first: Any, second: Any, lead: System) -> System:
    """Return the second operand driven by the outputs of the first; `lead` is one of them, as below."""
    a, b = _together(first, second, lead)
    if len(a.outputs) != len(b.inputs):
        raise ValueError(f"series: found {_ports('out', a)} into {_ports('in', b)}, expected as many")
    n_a, n_b = a.n_states, b.n_states
    A = _blocks(a.A, np.zeros((a.n_steps, n_a, n_b)), b.B @ a.C, b.A)
    return _joined(
        (a, b),
        A=A,
        B=np.concatenate([a.B, b.B @ a.D], axis=1),
        r=np.concatenate([a.r, _times(b.B, a.q) + b.r], axis=1),
        C=np.concatenate([b.D @ a.C, b.C], axis=2),
        D=b.D @ a.D,
        q=_times(b.D, a.q) + b.q,
        ports=(a.inputs, b.outputs, a.levels),
        name=f"{b.name}_after_{a.name}",
    )


def in_parallel(first: Any, second: Any, lead: System) -> System:
    """Return both with the same inputs and the sum of their outputs; names and levels are those of `lead`."""
    a, b = _together(first, second, lead)
    if len(a.inputs) != len(b.inputs) or len(a.outputs) != len(b.outputs):
        found = f"{_ports('in', a)} and {_ports('out', a)} beside {_ports('in', b)} and {_ports('out', b)}"
        raise ValueError(f"parallel: found {found}, expected as many")
    both = isinstance(first, type(lead)) and isinstance(second, type(lead))
    if both and not np.array_equal(a.levels, b.levels):
        raise ValueError(f"parallel: found input levels {a.levels} and {b.levels}, expected the same inputs")
    n_a, n_b, N = a.n_states, b.n_states, a.n_steps
    return _joined(
        (a, b),
        A=_blocks(a.A, np.zeros((N, n_a, n_b)), np.zeros((N, n_b, n_a)), b.A),
        B=np.concatenate([a.B, b.B], axis=1),
        r=np.concatenate([a.r, b.r], axis=1),
        C=np.concatenate([a.C, b.C], axis=2),
        D=a.D + b.D,
        q=a.q + b.q,
        ports=(lead.inputs, lead.outputs, lead.levels),
        name=f"{a.name}_beside_{b.name}",
    )


def side_by_side(first: Any, second: Any, lead: System) -> System:
    """Return both, each with its own inputs and outputs."""
    a, b = _together(first, second, lead)
    N, p_a, p_b, m_a, m_b = a.n_steps, len(a.outputs), len(b.outputs), len(a.inputs), len(b.inputs)
    n_a, n_b = a.n_states, b.n_states
    return _joined(
        (a, b),
        A=_blocks(a.A, np.zeros((N, n_a, n_b)), np.zeros((N, n_b, n_a)), b.A),
        B=_blocks(a.B, np.zeros((N, n_a, m_b)), np.zeros((N, n_b, m_a)), b.B),
        r=np.concatenate([a.r, b.r], axis=1),
        C=_blocks(a.C, np.zeros((N, p_a, n_b)), np.zeros((N, p_b, n_a)), b.C),
        D=_blocks(a.D, np.zeros((N, p_a, m_b)), np.zeros((N, p_b, m_a)), b.D),
        q=np.concatenate([a.q, b.q], axis=1),
        ports=(
            _told_apart(a.inputs, b.inputs, (a, b)),
            _told_apart(a.outputs, b.outputs, (a, b)),
            np.concatenate([a.levels, b.levels]),
        ),
        name=f"{a.name}_and_{b.name}",
    )


def in_feedback(first: Any, second: Any, lead: System, sign: float) -> System:
    """Return the first operand with the second from its outputs back to its inputs."""
    a, b = _together(first, second, lead)
    if len(a.outputs) != len(b.inputs) or len(b.outputs) != len(a.inputs):
        found = f"{_ports('out', a)} into {_ports('in', b)}, and {_ports('out', b)} into {_ports('in', a)}"
        raise ValueError(f"feedback: found {found}, expected as many")
    loop = np.eye(len(a.inputs)) - sign * b.D @ a.D
    values = np.linalg.svd(loop, compute_uv=False)
    if values.size and (values[:, -1] <= 1e-14 * np.maximum(values[:, 0], 1.0)).any():
        step = int(np.argmin(values[:, -1])) + 1
        raise ValueError(f"feedback: the algebraic loop of D in step {step} has no solution; add a lag to one of them")
    # u_a = M (u + sign (C_b z_b + D_b (C_a z_a + q_a) + q_b)), y = C_a z_a + D_a u_a + q_a.
    M: FloatArray = np.asarray(np.linalg.inv(loop), dtype=np.float64)
    from_a, from_b = sign * M @ b.D @ a.C, sign * M @ b.C
    bias = sign * _times(M, _times(b.D, a.q) + b.q)
    C = np.concatenate([a.C + a.D @ from_a, a.D @ from_b], axis=2)
    D, q = a.D @ M, a.q + _times(a.D, bias)
    n_a = a.n_states
    return _joined(
        (a, b),
        A=_blocks(a.A + a.B @ from_a, a.B @ from_b, b.B @ C[:, :, :n_a], b.A + b.B @ C[:, :, n_a:]),
        B=np.concatenate([a.B @ M, b.B @ D], axis=1),
        r=np.concatenate([a.r + _times(a.B, bias), b.r + _times(b.B, q)], axis=1),
        C=C,
        D=D,
        q=q,
        ports=(a.inputs, a.outputs, a.levels),
        name=f"{a.name}_with_{b.name}",
    )


def _together(first: Any, second: Any, lead: System) -> tuple[System, System]:
    """Return both operands, of which `lead` is one, as periodic systems with the same steps over a common period."""
    a, b = (_periodic(x, lead) for x in (first, second))
    return a.beside(b)


def _periodic(operand: Any, lead: System) -> System:
    """Return an operand as a periodic system; a time-invariant one has the same coefficients in all of its steps."""
    if isinstance(operand, type(lead)):
        return operand
    A, B, C, D, names, name = bridge.matrices_of(operand, lead.dt)
    states, inputs, outputs = names
    N, n, p = lead.n_steps, len(A), len(C)
    A, B, C, D = (np.broadcast_to(part, (N, *part.shape)) for part in (A, B, C, D))
    return replace(
        lead.without_jumps(), A=A, B=B, r=np.zeros((N, n)), C=C, D=D, q=np.zeros((N, p)),
        levels=np.zeros(len(inputs)), states=states, inputs=inputs, outputs=outputs, name=name,
    )  # fmt: skip


def _joined(
    operands: tuple[System, System],
    *,
    ports: tuple[tuple[str, ...], tuple[str, ...], FloatArray],
    name: str,
    **matrices: FloatArray,
) -> System:
    a, b = operands
    inputs, outputs, levels = ports
    states = _told_apart(a.states, b.states, operands)
    return replace(
        a,
        **a.jumps_beside(b),
        levels=levels,
        states=states,
        inputs=inputs,
        outputs=outputs,
        name=name,
        **matrices,
    )


def _told_apart(first: tuple[str, ...], second: tuple[str, ...], operands: tuple[System, System]) -> tuple[str, ...]:
    """Return names of both systems, each after its system's name where some are the same."""
    if not set(first) & set(second):
        return (*first, *second)
    a, b = operands
    labels = (a.name, b.name) if a.name != b.name else (f"{a.name}_1", f"{b.name}_2")
    return tuple(f"{label}_{name}" for label, names in zip(labels, (first, second), strict=True) for name in names)


def _blocks(a: FloatArray, b: FloatArray, c: FloatArray, d: FloatArray) -> FloatArray:
    return np.concatenate([np.concatenate([a, b], axis=2), np.concatenate([c, d], axis=2)], axis=1)


def _times(matrices: FloatArray, vectors: FloatArray) -> FloatArray:
    return (matrices @ vectors[:, :, None])[:, :, 0]


def _ports(kind: str, system: "Coefficients") -> str:
    names = system.outputs if kind == "out" else system.inputs
    return f"{len(names)} {kind}puts ({', '.join(names)}) of {system.name}"
