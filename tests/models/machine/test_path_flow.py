"""Slopes of the flow through a path by ISO 6358, in series and in both directions, against differences."""

import math
from dataclasses import replace

import numpy as np
import pytest

import ltvpneu as lp
from ltvpneu.models.machine.records import GENERAL
from ltvpneu.physics.gas import GasState
from ltvpneu.physics.medium import path_flow, path_flow_slopes

LAW = lp.ISO6358(sonic_conductance=0.7e-8, critical_pressure_ratio=0.3)
OTHER = lp.ISO6358(sonic_conductance=0.9e-8, critical_pressure_ratio=0.15, subsonic_index=0.58)
CHECK = lp.ISO6358(sonic_conductance=0.8e-8, critical_pressure_ratio=0.25, cracking_pressure=2e4)
SHUT = lp.ISO6358(sonic_conductance=0.0)
SILENCER = lp.ISO6358(sonic_conductance=0.5e-8, critical_pressure_ratio=0.4)
WAYS = {
    "one": {"law": LAW},
    "other back": {"law": LAW, "law_back": OTHER},
    "in series": {"law": LAW, "law_back": OTHER, "in_series": SILENCER},
    "nozzle in series": {"area": 3e-6, "in_series": SILENCER},
    "check valve": {"law": CHECK, "law_back": SHUT},
    "check valve in series": {"law": CHECK, "law_back": SHUT, "in_series": SILENCER},
}
GASES = {"ideal": lp.Gas(), "real": lp.RealGas(fluid="Air")}


@pytest.mark.parametrize("gas", GASES)
@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize(
    ("source", "chamber"),
    [(7e5, 1.5e5), (7e5, 5e5), (7e5, 6.7e5), (6e5, 5.999e5), (2e5, 6e5), (5.5e5, 6e5), (5.99e5, 6e5), (3e5, 2.9e5)],
)
def test_slopes_equal_differences(double_acting: lp.Machine, gas: str, way: str, source: float, chamber: float) -> None:
    path = lp.FlowPath(source="supply", chamber="chamber_1", **WAYS[way])  # pyright: ignore[reportArgumentType]
    paths = (path, *double_acting.flow_paths)
    record = replace(double_acting, flow_paths=paths).with_gas(GASES[gas]).as_record(GENERAL)
    law, medium = record["laws"][0], record["medium"]  # pyright: ignore[reportIndexIssue, reportUnknownVariableType]
    second = math.inf if path.in_series is None else path.effective_area
    first = path.effective_area if path.in_series is None else path.in_series.area

    def flow(values: np.ndarray) -> float:
        here, there = GasState(float(values[0]), float(values[2])), GasState(float(values[1]), float(values[3]))
        return path_flow(first, second, here, there, law, medium)  # pyright: ignore[reportUnknownArgumentType]

    base = np.array([source, chamber, 285.0, 300.0])
    steps = np.diag([0.5, 0.5, 0.05, 0.05])
    expected = [(flow(base + step) - flow(base - step)) / (2 * step.max()) for step in steps]
    found = path_flow_slopes(
        first,
        second,
        GasState(source, 285.0),
        GasState(chamber, 300.0),
        law,
        medium,  # pyright: ignore
    )
    size = path.effective_area * 0.0404 / math.sqrt(293.15)
    assert found[0] == pytest.approx(flow(base), rel=1e-12, abs=1e-18)
    np.testing.assert_allclose(found[1:3], expected[:2], rtol=1e-5, atol=1e-6 * size)
    upstream = 2 if source > chamber else 3
    assert found[3] == pytest.approx(expected[upstream], rel=1e-5, abs=1e-12)
    # Only upwind temperature counts.
    assert expected[5 - upstream] == pytest.approx(0.0, abs=1e-12)


def test_flow_in_series_passes_both(double_acting: lp.Machine) -> None:
    """At some pressure between, valve and silencer pass the same by their own laws."""
    path = lp.FlowPath(source="exhaust", chamber="chamber_1", law=LAW, in_series=SILENCER)
    machine = replace(double_acting, flow_paths=(path, *double_acting.flow_paths))
    record = machine.as_record(GENERAL)
    law, medium = record["laws"][0], record["medium"]  # pyright: ignore[reportIndexIssue, reportUnknownVariableType]
    outside, inside = GasState(1e5, 293.15), GasState(5e5, 293.15)
    found = -path_flow(SILENCER.area, LAW.area, outside, inside, law, medium)  # pyright: ignore[reportUnknownArgumentType]
    middle = np.linspace(1e5, 5e5, 200001)
    gaps = [LAW.mass_flow(5e5, p) - SILENCER.mass_flow(p, 1e5) for p in middle[[0, -1]].tolist()]
    assert gaps[0] > 0 > gaps[1]
    low, high = 1e5, 5e5
    for _ in range(60):
        p = (low + high) / 2
        low, high = (p, high) if LAW.mass_flow(5e5, p) > SILENCER.mass_flow(p, 1e5) else (low, p)
    assert found == pytest.approx(LAW.mass_flow(5e5, low), rel=1e-6)
