"""The best pattern on the nonlinear machine, of many more than can be tried.

What the machine makes of a pattern is predicted from the linear model's figures of it, by least squares over the
patterns tried so far, those near the goals and the best value counting most. The most promising are tried, the
prediction is made anew, and so on, until every pattern that would be better, were its prediction off by
`ERRORS` standard errors in its favour, has been tried.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ltvpneu._arrays import BoolArray, FloatArray
from ltvpneu.design.pattern.enumeration import LinearFigures
from ltvpneu.design.pattern.pattern_machine import PatternsOnMachine, Tried
from ltvpneu.design.pattern.pattern_problem import Asked
from ltvpneu.design.pattern.slots import count_pulses
from ltvpneu.design.progress import Progress

AT_ONCE = 24
"""Patterns tried between two predictions."""
FIRST_AT_RANDOM = 48
"""Patterns tried first, beside the most promising on the linear model."""
MOST_TRIED = 1000
ERRORS = 4.0
"""Standard errors by which a prediction may be off."""
NEARNESS = 0.4
"""Distance from the goals, and from the best value, at which a trial counts 0.6, over the spread of all trials [-]."""
RIDGE, LEAST_WEIGHT = 1e-3, 1e-3

Indices = NDArray[np.intp]


class Searched(NamedTuple):
    """The best pattern that was found."""

    best: Tried
    bound: float
    """No pattern is predicted to be worth less, were its prediction off by `ERRORS` standard errors; nan where none was
    found that keeps the goals."""
    ended: bool
    """Whether all were tried that could have been better."""


class _Predicted(NamedTuple):
    """Predicted figures of all patterns, (n_figures, n_patterns), and their standard errors, (n_figures,)."""

    figures: FloatArray
    errors: FloatArray


def search_patterns(
    trials: PatternsOnMachine, patterns: BoolArray, linear: LinearFigures, progress: Progress | None
) -> Searched:
    """Return the best of patterns on the nonlinear machine."""
    ask = trials.ask
    known: dict[int, Tried] = {}
    pulses = count_pulses(patterns)
    features = _features(patterns, linear, pulses)
    usable = np.isfinite(features).all(axis=1)
    features[~usable] = 0.0

    def try_these(chosen: Indices) -> Tried:
        for i in chosen.tolist():
            if progress is not None:
                progress("trying patterns on the machine", len(known) / min(MOST_TRIED, len(patterns)))
            known[i] = trials.tried(patterns[i])
        return min(known.values(), key=lambda one: one.rank)

    distance, value = _worth(ask, _linear_figures(ask, linear), np.zeros(len(_names(ask))), pulses)
    random = np.random.default_rng(0)
    first = np.lexsort((np.nan_to_num(value, nan=np.inf), np.nan_to_num(distance, nan=np.inf)))[:AT_ONCE]
    best = try_these(np.union1d(first, random.permutation(len(patterns))[:FIRST_AT_RANDOM]))
    while True:
        predicted = _predict(ask, known, features, best)
        distance, value = _worth(ask, predicted.figures, ERRORS * predicted.errors, pulses)
        better = (distance < best.distance) | ((distance == best.distance) & (value < best.value))
        better[~usable] = True
        better[list(known)] = False
        left = np.flatnonzero(better)
        if not left.size or len(known) >= MOST_TRIED:
            break
        # The likeliest first: as predicted, without errors in its favour.
        likely = _worth(ask, predicted.figures[:, left], predicted.errors, pulses[left])
        best = try_these(left[np.lexsort((likely[1], likely[0]))[:AT_ONCE]])
    bound = np.nan
    if best.kept:
        value[list(known)] = np.inf
        bound = float(min(best.value, np.min(value, where=distance == 0, initial=np.inf)))
    return Searched(best, bound, not left.size)


def _names(ask: Asked) -> list[tuple[str, str]]:
    """Return the figures that goals and objective are made of, each a kind and a state."""
    found: list[tuple[str, str]] = [(goal.kind, goal.state) for goal in ask.goals]
    if ask.minimize == "amplitude":
        found.append(("amplitude", "position"))
    elif ask.minimize == "air_use":
        found.append(("air_use", ""))
    elif ask.minimize == "mean_error":
        found += [(goal.kind, goal.state) for goal in ask.wanted_means]
    return found


def _worth(ask: Asked, figures: FloatArray, within: FloatArray, pulses: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return patterns' distances from the goals, each over its state's size, and their objectives, from their figures.

    With the figures off by as much as `within` in a pattern's favour.
    """
    distance = np.zeros_like(pulses)
    for goal, figure, by in zip(ask.goals, figures, within, strict=False):
        distance = distance + goal.beyond(figure, float(by)) / ask.scales[goal.state]
    if ask.minimize == "switching":
        return distance, pulses
    k = len(ask.goals)
    if ask.minimize == "mean_error":
        parts = zip(ask.wanted_means, figures[k:], within[k:], strict=True)
        return distance, sum(
            (goal.beyond(figure, float(by)) / ask.scales[goal.state] for goal, figure, by in parts),
            np.zeros_like(pulses),
        )
    return distance, np.maximum(figures[k] - within[k], 0.0)


def _linear_figures(ask: Asked, linear: LinearFigures) -> FloatArray:
    """Return the figures on the linear model, (n_figures, n_patterns)."""
    of: dict[str, Callable[[str], FloatArray]] = {
        "mean": lambda state: linear.means[:, ask.states.index(state)],
        "amplitude": lambda state: linear.amplitudes[:, ask.states.index(state)],
        "air_use": lambda _: linear.flows,
    }
    rows = [of[kind](state) for kind, state in _names(ask)]
    return np.array(rows).reshape(len(rows), len(linear.flows))


def _features(patterns: BoolArray, linear: LinearFigures, pulses: FloatArray) -> FloatArray:
    """Return what figures are predicted from, standardized, the first column ones, (n_patterns, n_features)."""
    mean, amplitude = linear.means[:, :1], linear.amplitudes[:, :1]
    columns = np.hstack([
        linear.means, linear.amplitudes, linear.flows[:, None], patterns.mean(axis=1)[:, None], pulses[:, None],
    ])  # fmt: skip
    columns, mean, amplitude = _standardized(columns), _standardized(mean), _standardized(amplitude)
    pulses = _standardized(pulses[:, None])
    products = _standardized(np.hstack([mean * amplitude, mean**2, amplitude**2, amplitude * pulses]))
    return np.hstack([np.ones((len(patterns), 1)), columns, products])


def _standardized(columns: FloatArray) -> FloatArray:
    finite = columns[np.isfinite(columns).all(axis=1)]
    middle, spread = finite.mean(axis=0), finite.std(axis=0)
    return (columns - middle) / np.where(spread > 1e-9 * np.abs(middle), spread, np.inf)


def _predict(ask: Asked, known: dict[int, Tried], features: FloatArray, best: Tried) -> _Predicted:
    """Return the figures that the patterns tried so far lead to expect of all."""
    names = _names(ask)
    having = [i for i, one in known.items() if np.isfinite(one.distance)]
    if not having:
        return _Predicted(np.zeros((len(names), len(features))), np.full(len(names), np.inf))
    made = np.array([[_figure(known[i], *name) for name in names] for i in having]).reshape(-1, len(names)).T
    spreads = np.maximum(NEARNESS * made.std(axis=1), 1e-300)
    far = np.zeros(len(having))
    for goal, figure, spread in zip(ask.goals, made, spreads, strict=False):
        far = np.hypot(far, goal.beyond(figure) / spread)
    values = np.array([known[i].value for i in having])
    if np.isfinite(best.value) and np.ptp(values) > 0:
        far = np.hypot(far, np.maximum(values - best.value, 0.0) / (NEARNESS * values.std()))
    weights = np.exp(-0.5 * far**2) + LEAST_WEIGHT
    rows = features[having] * np.sqrt(weights)[:, None]
    inverse = np.linalg.inv(rows.T @ rows + RIDGE * np.eye(rows.shape[1]))
    fitted = inverse @ (rows.T @ (made * np.sqrt(weights)).T)
    # Each trial's error is that of a prediction made without it.
    own = np.einsum("ij,jk,ik->i", rows, inverse, rows)
    off = (made - (features[having] @ fitted).T) / np.maximum(1.0 - own, 1e-6)
    errors = np.sqrt(np.average(off**2, axis=1, weights=weights))
    return _Predicted((features @ fitted).T, errors)


def _figure(one: Tried, kind: str, state: str) -> float:
    assert not isinstance(one.orbit, str)
    if kind == "air_use":
        return one.value
    return float(getattr(one.orbit, kind)(state))
