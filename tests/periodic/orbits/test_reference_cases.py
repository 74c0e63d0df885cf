"""Every quantity of every case that was computed in 40 digits or more, within the case's own tolerance."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

import ltvpneu as lp

CASES = json.loads((Path(__file__).parents[2] / "reference" / "periodic_cases.json").read_text())["cases"]


def system_of(case) -> lp.PeriodicSystem:
    steps = case["segments"]
    matrices = {name: [step[name] for step in steps] if name in steps[0] else None for name in "BCD"}
    return lp.PeriodicSystem.from_matrices(
        [step["A"] for step in steps], [step["f"] for step in steps], [step["duration"] for step in steps], **matrices
    )


def complex_of(pairs) -> np.ndarray:
    return np.array([complex(*pair) for pair in pairs])


def cases_with(*quantities):
    chosen = [case for case in CASES if any(quantity in case["expect"] for quantity in quantities)]
    assert chosen
    return pytest.mark.parametrize("case", chosen, ids=[case["name"] for case in chosen])


def check(case, found, expected) -> None:
    """As the file defines it: relative to the largest value, and to one too unless the case's note says otherwise."""
    expected = np.asarray(expected)
    size = np.abs(expected).max(initial=0.0)
    if "tol_note" not in case:
        size = max(1.0, size)
    assert np.abs(np.asarray(found) - expected).max() <= case["tol"] * size


@cases_with("multipliers")
def test_multipliers(case):
    found, expect = lp.floquet(system_of(case)), case["expect"]
    check(case, found.multipliers, complex_of(expect["multipliers"]))
    if "log10_abs_multipliers" in expect:
        logs = np.array(expect["log10_abs_multipliers"])
        differences = np.abs(found.log_moduli / math.log(10) - logs)
        assert (differences <= case["tol"] * np.maximum(1.0, np.abs(logs))).all()
    if "exponents" in expect:
        check(case, found.exponents, complex_of(expect["exponents"]))
    if "spectral_radius" in expect:
        check(case, found.spectral_radius, expect["spectral_radius"])
    assert found.is_stable == expect["stable"]
    assert found.is_marginal == expect["marginal"]


@cases_with("monodromy")
def test_monodromy(case):
    check(case, lp.monodromy(system_of(case)), case["expect"]["monodromy"])


@cases_with("multipliers")
def test_modes_are_eigenvectors_of_the_monodromy_matrix(case):
    found, Phi = lp.floquet(system_of(case)), lp.monodromy(system_of(case))
    # Rounding of Phi, relative to its largest entry.
    np.testing.assert_allclose(Phi @ found.modes, found.modes * found.multipliers, atol=1e-13 * np.abs(Phi).max())


@cases_with("steady_state_z0")
def test_steady_state(case):
    orbit, expect = lp.steady_state(system_of(case)), case["expect"]
    check(case, orbit.initial_state, expect["steady_state_z0"])
    check(case, orbit.step_states, expect["steady_state_at_segment_starts"])
    check(case, [orbit.mean(i) for i in range(len(orbit.states))], expect["steady_state_mean"])
    assert orbit.residual < 1e-13


@cases_with("d_steady_state_z0_d_duty", "d_steady_state_z0_d_tau1_with_tau4_shrinking")
def test_sensitivity_of_the_steady_state(case):
    system, expect = system_of(case), case["expect"]
    by_duration = lp.sensitivity(system).initial_state_by_duration
    if "d_steady_state_z0_d_duty" in expect:
        found = (by_duration[:, 0] - by_duration[:, 1]) * system.period
        check(case, found, expect["d_steady_state_z0_d_duty"])
    else:
        found = by_duration[:, 0] - by_duration[:, 3]
        check(case, found, expect["d_steady_state_z0_d_tau1_with_tau4_shrinking"])


@cases_with("h2_norm")
def test_norms_and_gramians(case):
    system, expect = system_of(case), case["expect"]
    check(case, lp.h2_norm(system), expect["h2_norm"])
    check(case, lp.hinf_norm(system), expect["hinf_norm"])
    found = lp.gramians(system)
    if "P0" in expect:
        check(case, found.controllability[0], expect["P0"])
        check(case, found.observability[0], expect["Q0"])
    else:
        check(case, found.controllability, expect["P_at_segment_starts"])
        check(case, found.observability, expect["Q_at_segment_starts"])


@cases_with("h2_norm")
def test_harmonic_transfer_functions(case):
    system = system_of(case)
    for name, values in case["expect"].items():
        if name.startswith("htf_at_s="):
            found = lp.harmonic_transfer(system, complex(name.removeprefix("htf_at_s=")), [int(k) for k in values])
            check(case, found.ravel(), complex_of(values.values()))


@cases_with("riccati_Q")
def test_periodic_riccati(case):
    expect = case["expect"]
    found = lp.lqr(system_of(case), expect["riccati_Q"], expect["riccati_R"])
    check(case, found.cost_to_go, expect["X_at_segment_starts"])
    check(case, found.multipliers, complex_of(expect["closed_loop_multipliers"]))


@cases_with("steady_state_unique", "drift_per_period")
def test_systems_without_one_orbit(case):
    expect = case["expect"]
    if expect["steady_state_exists"]:
        with pytest.raises(lp.NonUniqueOrbitError) as several:
            lp.steady_state(system_of(case))
        check(case, several.value.least_norm, expect["steady_state_z0_least_norm"])
    else:
        with pytest.raises(lp.NoOrbitError) as none:
            lp.steady_state(system_of(case))
        check(case, none.value.drift, expect["drift_per_period"])
