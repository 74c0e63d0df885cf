"""Flow by sonic conductance: a maker's printed flows, the nozzle of the paper, slopes and branches."""

import math
from typing import Any

import numpy as np
import pytest

from ltvpneu.physics.flow import mass_flux
from ltvpneu.physics.gas import Gas
from ltvpneu.physics.iso6358 import ISO6358, KV_OF_CV, share_of_choked

# SMC's catalog of 5-port valves: C [dm^3/(s bar)], b, flow from 0.6 to 0.5 MPa (gauge) [l/min ANR].
CATALOG = [(1.1, 0.28, 276.0), (2.8, 0.37, 746.0), (4.5, 0.28, 1130.0), (10.0, 0.29, 2527.0)]


def law(**changes: float) -> ISO6358:
    given: dict[str, Any] = {"sonic_conductance": 0.7e-8, "critical_pressure_ratio": 0.3, **changes}
    return ISO6358(**given)


@pytest.mark.parametrize(("conductance", "b", "flow"), CATALOG)
def test_flows_are_those_of_a_makers_catalog(conductance: float, b: float, flow: float) -> None:
    valve = law(sonic_conductance=conductance * 1e-8, critical_pressure_ratio=b)
    assert valve.volume_flow(701325.0, 601325.0) * 6e4 == pytest.approx(flow, rel=3e-3)


def test_flow_is_that_of_a_makers_worked_example() -> None:
    """SMC's manual: C = 2, b = 0.3, 0.4 to 0.3 MPa (gauge): 600 l/min choked, a share of 0.7."""
    valve = law(sonic_conductance=2e-8)
    assert valve.volume_flow(5e5, 1e5) * 6e4 == pytest.approx(600.0, rel=1e-12)
    assert valve.volume_flow(5e5, 4e5) * 6e4 == pytest.approx(419.91, rel=1e-4)


def test_choked_flow_falls_with_the_root_of_the_temperature_upstream() -> None:
    assert law().volume_flow(5e5, 1e5, 4 * 293.15) == pytest.approx(law().volume_flow(5e5, 1e5) / 2, rel=1e-12)


def test_flow_back_is_the_same_with_the_other_sign() -> None:
    assert law().mass_flow(2e5, 3e5) == -law().mass_flow(3e5, 2e5)


@pytest.mark.parametrize("ratio", [0.1, 0.5, 0.6, 0.8, 0.9, 0.99])
def test_with_the_nozzles_critical_ratio_the_flow_is_the_nozzles(ratio: float) -> None:
    gas = Gas()
    valve = law(critical_pressure_ratio=gas.critical_pressure_ratio)
    nozzle = valve.area * mass_flux(4e5, 4e5 * ratio, 293.15, gas.constants)
    assert valve.mass_flow(4e5, 4e5 * ratio) == pytest.approx(nozzle, rel=3e-3)


def test_line_next_to_equal_pressures_is_that_of_the_laminar_ratio() -> None:
    """k_1 = C rho_0 phi(B) / (1 - B); the slope over r at r = 1 for b = 0.3 and B = 0.999 is 53.4 of the choked flow."""
    slope = share_of_choked(5e5, 5e5, law()._record).by_downstream * 5e5  # pyright: ignore[reportPrivateUsage]
    edge = math.sqrt(1 - ((0.999 - 0.3) / 0.7) ** 2)
    assert slope == pytest.approx(-edge / 0.001, rel=1e-12)
    assert slope == pytest.approx(-53.4, rel=2e-3)


VARIANTS = [
    {}, {"critical_pressure_ratio": 0.0}, {"subsonic_index": 0.56}, {"laminar_ratio": 0.98},
    {"cracking_pressure": 2e4}, {"cracking_pressure": 3e5},
]  # fmt: skip


@pytest.mark.parametrize("changes", VARIANTS)
@pytest.mark.parametrize("upstream", [3.5e5, 7e5])
def test_slopes_are_those_of_differences(changes: dict[str, float], upstream: float) -> None:
    record = law(**changes)._record  # pyright: ignore[reportPrivateUsage]
    ratios = np.concatenate([np.linspace(0.01, 0.997, 301), 1 - np.geomspace(1e-6, 2e-3, 60)])
    for downstream in (upstream * ratios).tolist():
        found, step = share_of_choked(upstream, downstream, record), 0.02
        down = share_of_choked(upstream, downstream + step, record).share
        down -= share_of_choked(upstream, downstream - step, record).share
        up = share_of_choked(upstream + step, downstream, record).share
        up -= share_of_choked(upstream - step, downstream, record).share
        # In shares of the choked flow over the whole pressure; the difference rounds at 1e-16 p / h.
        assert found.by_downstream * upstream == pytest.approx(down / (2 * step) * upstream, rel=1e-6, abs=2e-5)
        assert found.by_upstream * upstream == pytest.approx(up / (2 * step) * upstream, rel=1e-6, abs=2e-5)


@pytest.mark.parametrize("changes", VARIANTS)
def test_value_and_slope_have_no_jump_at_any_branch(changes: dict[str, float]) -> None:
    valve = law(**changes)
    record, upstream = valve._record, 7e5  # pyright: ignore[reportPrivateUsage]
    opens = 1 - valve.cracking_pressure / upstream
    b, B = min(valve.critical_pressure_ratio, opens - 0.01), valve.laminar_ratio
    laminar = b + (B - valve.critical_pressure_ratio) / (1 - valve.critical_pressure_ratio) * (opens - b)
    for edge in (b, laminar, (opens + laminar) / 2, opens):
        if edge <= 0:
            continue
        low, high = (share_of_choked(upstream, upstream * (edge + side * 1e-12), record) for side in (-1, 1))
        size = 1 / (1 - B)
        assert low.share == pytest.approx(high.share, abs=1e-9)
        if edge < 1 - 1e-9:
            assert low.by_downstream * upstream == pytest.approx(high.by_downstream * upstream, abs=1e-6 * size)


def test_slope_goes_on_in_reverse_flow() -> None:
    """At equal pressures the slopes over one side's pressure from above and from below are the same."""
    p, step = 5e5, 1.0
    forward, back = law().mass_flow(p + step, p) / step, -law().mass_flow(p - step, p) / step
    assert forward == pytest.approx(back, rel=1e-5)


def test_nominal_flow_and_flow_of_water_give_the_conductance() -> None:
    valve = ISO6358.from_nominal_flow(100 / 6e4, 0.3)
    assert valve.volume_flow(7e5, 6e5) * 6e4 == pytest.approx(100.0, rel=1e-12)
    # Makers' own rows have 3.6 to 3.8 dm^3/(s bar) for Cv = 1; this is the limit of small drops, where b counts.
    assert 3.6 < ISO6358.from_kv(KV_OF_CV, 0.4).sonic_conductance * 1e8 < 4.2
    # A drop of 100 Pa moves air like a liquid of its density.
    density = 5e5 / (287.05 * 293.15)
    plain = 1 / 3600 / math.sqrt(2e5 / 1000) * math.sqrt(2 * density * 2000.0)
    assert ISO6358.from_kv(1.0, 0.3).mass_flow(5e5, 5e5 - 2000.0) == pytest.approx(plain, rel=3e-3)


def test_check_valve_opens_at_its_cracking_pressure() -> None:
    valve = law(cracking_pressure=2e4)
    assert valve.mass_flow(5e5, 5e5 - 1.99e4) == 0.0
    assert valve.mass_flow(5e5, 5e5 - 2.01e4) > 0.0


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"sonic_conductance": 0.7}, "0.7 dm\\^3/\\(s bar\\) is 7e-9"),
        ({"critical_pressure_ratio": 1.2}, "expected b, 0 to below 1"),
        ({"laminar_ratio": 0.2}, "above the critical pressure ratio"),
        ({"subsonic_index": 0.0}, "expected m, above 0"),
        ({"cracking_pressure": -1.0}, "cracking_pressure"),
        ({"sonic_conductance": math.nan}, "sonic_conductance"),
    ],
)
def test_bad_numbers_are_named(changes: dict[str, float], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        law(**changes)
