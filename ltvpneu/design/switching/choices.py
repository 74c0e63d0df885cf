"""Lists to choose from: the same design with every valve, bore, number of pulses or other number of a list."""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from difflib import get_close_matches
from itertools import product
from typing import Any, NamedTuple

from ltvpneu._arrays import finite, whole
from ltvpneu.design.progress import Progress
from ltvpneu.design.switching.duty_solution import Chosen, DutySolution
from ltvpneu.errors import LtvpneuError
from ltvpneu.models.machine.catalogue import CatalogueCylinder, CatalogueValve, catalogue
from ltvpneu.models.machine.exchange import with_bore, with_valve
from ltvpneu.models.machine.machine import Machine
from ltvpneu.models.machine.parameters import present_value, with_values

Choices = Mapping[str, Sequence[Any]]
PARTS = ("valve", "bore", "pulses", "frequency")
"""What may be chosen beside numbers of the machine."""


class _Option(NamedTuple):
    """One entry of one list."""

    name: str
    """Of the list."""
    label: str | float
    value: Any


Solve = Callable[[Machine, dict[str, Any], Progress | None], DutySolution]
"""Of a machine, what else was chosen by keyword, and whom to tell."""


def over_choices(
    machine: Machine, choices: Choices, free: Collection[str], solve: Solve, progress: Progress | None
) -> tuple[Chosen, ...]:
    """Return the design with every combination of the lists' entries, best first.

    First come those that keep all goals on the nonlinear machine, by its objective; then those that do not, by how far
    off they are; then those without a solution.

    Parameters
    ----------
    machine : Machine
    choices : mapping of str to sequence
        Lists by name.
    free : collection of str
        Variables of the design, which cannot be chosen too.
    solve : callable
    progress : callable, optional

    Raises
    ------
    ValueError
        No list, an empty one, an unknown name or entry; or no combination has a solution.
    """
    options = _options(machine, choices, free)
    combinations = list(product(*options))
    found: list[Chosen] = []
    for number, combination in enumerate(combinations):
        choice = {option.name: option.label for option in combination}
        begin, share = number / len(combinations), 1 / len(combinations)
        told = None if progress is None else _part(progress, ", ".join(map(str, choice.values())), begin, share)
        try:
            changed, given = _with(machine, combination)
            found.append(Chosen(choice=choice, solution=solve(changed, given, told), failure=""))
        except (LtvpneuError, ValueError) as error:
            found.append(Chosen(choice=choice, solution=None, failure=str(error)))
    if all(one.solution is None for one in found):
        raise ValueError(f"choices: none has a solution; the first, {found[0].choice}: {found[0].failure}")
    return tuple(sorted(found, key=_rank))


def _part(progress: Progress, name: str, begin: float, share: float) -> Progress:
    return lambda text, done: progress(f"{name}: {text}", begin + share * done)


def _options(machine: Machine, choices: Choices, free: Collection[str]) -> list[list[_Option]]:
    if not choices:
        raise ValueError('choices: found none, expected lists by name, such as {"valve": ["SMC SY3000", "SMC SY5000"]}')
    found: list[list[_Option]] = []
    for name, entries in choices.items():
        asked: Any = entries
        if isinstance(asked, str) or not isinstance(asked, Sequence) or not len(entries):
            raise ValueError(f"choices[{name!r}]: found {asked!r}, expected a list with at least one entry")
        if name in free:
            raise ValueError(
                f"choices: found {name!r}, which is a variable of the design; expected it in one of the two"
            )
        if name not in PARTS:
            try:
                present_value(machine, 1.0, name)
            except ValueError as error:
                near = get_close_matches(name, PARTS, 1, 0.5)
                hint = f"; did you mean {near[0]!r}?" if near else ""
                raise ValueError(
                    f"choices: found {name!r}, expected {', '.join(PARTS)} or a number of the machine ({error}){hint}"
                ) from None
        found.append([_option(name, entry) for entry in entries])
    return found


def _option(name: str, entry: Any) -> _Option:
    if name == "valve":
        valve = entry if isinstance(entry, CatalogueValve) else catalogue().valve(str(entry))
        return _Option(name, valve.name, valve)
    if name == "bore" and isinstance(entry, CatalogueCylinder):
        return _Option(name, entry.name, entry)
    if name == "pulses":
        return _Option(name, whole("choices['pulses']", entry), entry)
    return _Option(name, finite(f"choices[{name!r}]", entry), float(entry))


def _with(machine: Machine, combination: Sequence[_Option]) -> tuple[Machine, dict[str, Any]]:
    """Return the machine with a combination's entries, parts first, and what else of the design is chosen."""
    given: dict[str, Any] = {}
    for option in sorted(combination, key=lambda one: one.name not in PARTS):
        if option.name == "valve":
            machine = with_valve(machine, option.value)
        elif option.name == "bore":
            machine = with_bore(machine, option.value)
        elif option.name in ("pulses", "frequency"):
            given[option.name] = option.value
        else:
            machine = with_values(machine, {option.name: option.value})
    return machine, given


def _rank(one: Chosen) -> tuple[int, float]:
    """Return what a design is sorted by, the best first."""
    found = one.final
    if found is None:
        return 2, 0.0
    if one.keeps_goals:
        value = found.nonlinear_objective
        return 0, value if math.isfinite(value) else found.objective
    missed = found.nonlinear_constraints
    if any(math.isnan(by) for by in missed.values()):
        return 1, math.inf
    return 1, max((by / found.tolerances[name] for name, by in missed.items() if by > 0), default=math.inf)
