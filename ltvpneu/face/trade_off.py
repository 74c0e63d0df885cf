"""`ltvpneu optimize --trade-off`: a front of two objectives as a table, a picture and JSON."""

from typing import TYPE_CHECKING, Any

import numpy as np

from ltvpneu._arrays import FloatArray
from ltvpneu.face.optimize import asked, progress_bar, setting_shown
from ltvpneu.face.request import Request
from ltvpneu.face.results import Results
from ltvpneu.face.shown import objective_unit
from ltvpneu.face.tables import heading, table
from ltvpneu.models.machine.machine import Machine

if TYPE_CHECKING:
    from ltvpneu.design import TradeOff


def run_trade_off(machine: Machine, request: Request, pair: str, *, points: int, model: Any) -> "TradeOff":
    """Trace the front, with a progress bar."""
    # A lazy door, as of the optimum.
    from ltvpneu import design

    objectives = [name.strip() for name in pair.split(",")]
    if len(objectives) != 2:
        raise ValueError(f"--trade-off: found {pair!r}, expected two objectives, such as air_use,amplitude")
    given = asked(machine, request)
    if request.variables is not None:
        given["variables"] = request.variables
    with progress_bar("trade-off") as progress:
        return design.trade_off(
            machine, request.frequency, minimize=objectives, points=points, model=model, progress=progress, **given
        )


def trade_off_text(found: "TradeOff") -> str:
    """Return the table of a front."""
    units = [objective_unit(name) for name in found.minimize]
    pairs = zip(found.minimize, units, strict=True)
    names = [f"{name} [{unit.symbol}]" if unit.symbol else name for name, unit in pairs]
    ratio = f"{units[0].symbol} per {units[1].symbol}".strip()
    settings = list(found.solutions[0].values)
    header = [*names, *(f"{name}, machine" for name in names), f"worth [{ratio}]", *settings, "status"]
    rows: list[list[str]] = []
    for i, one in enumerate(found.solutions):
        figures = [
            f"{unit.factor * value:.5g}" if np.isfinite(value) else "-"
            for values in (found.values[i], found.nonlinear_values[i])
            for value, unit in zip(values, units, strict=True)
        ]
        slope = found.slopes[i] * units[0].factor / units[1].factor
        around = one.machine.ambient_pressure
        rows.append(
            [
                *figures,
                f"{slope:.3g}" if np.isfinite(slope) else "-",
                *(setting_shown(name, one.values[name], around) for name in settings),
                one.status,
            ]
        )
    parts = [heading("Trade-off"), table(header, rows)]
    if found.is_single:
        parts.append(f"\n{found.minimize[0]} and {found.minimize[1]} do not conflict: one setting is best for both.")
    else:
        parts.append(
            f"\nWorth: by how much {found.minimize[0]} gets less for each unit more of {found.minimize[1]}. "
            '"Machine": of the nonlinear one.'
        )
    unit = units[1]
    parts += [
        f"no setting with {found.minimize[1]} at most {unit.factor * bound:.5g} {unit.symbol}: {why}"
        for bound, why in found.failures
    ]
    return "\n".join(parts)


def trade_off_data(found: "TradeOff") -> dict[str, Any]:
    """Return a front as plain values for JSON, in SI units; None stands for what is not known."""

    def known(values: FloatArray) -> list[Any]:
        rows = np.atleast_2d(values).tolist()
        found = [[value if np.isfinite(value) else None for value in row] for row in rows]
        return found if values.ndim == 2 else found[0]

    return {
        "minimize": list(found.minimize),
        "values": known(found.values),
        "nonlinear_values": known(found.nonlinear_values),
        "slopes": known(found.slopes),
        "settings": [one.values for one in found.solutions],
        "statuses": [one.status for one in found.solutions],
        "is_dominated": found.is_dominated.tolist(),
        "failures": [{"bound": bound, "why": why} for bound, why in found.failures],
    }


def write_trade_off(found: "TradeOff", results: Results) -> None:
    """Write the JSON and the picture."""
    from ltvpneu.face import pictures

    results.data("trade_off", trade_off_data(found))
    results.picture("trade_off", pictures.draw(found))
