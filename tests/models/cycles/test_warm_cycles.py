"""A cycle found from the map of one beside is the one that is found from rest."""

import numpy as np
import pytest

import ltvpneu as lp
from ltvpneu.models.cycles import linear_cycles
from ltvpneu.models.cycles.figures import Figure
from ltvpneu.models.cycles.linear_cycles import LinearCycles

FIGURES = [Figure("mean", 0), Figure("minimum", 0), Figure("maximum", 0), Figure("air_use")]


@pytest.mark.parametrize("name", ["kunt_singh_1990", "double_acting_5_2", "hydraulic_4_2"])
def test_figures_do_not_depend_on_what_was_found_before(name):
    machine, names = lp.load_machine(name), ["duty", "frequency"]
    warm = LinearCycles(machine, 10.0)
    for duty, frequency in ((0.45, 12.0), (0.47, 12.5), (0.5, 11.0), (0.42, 15.0)):
        values = {"duty": duty, "frequency": frequency}
        one = warm.figures(values, FIGURES, names)
        other = LinearCycles(machine, 10.0).figures(values, FIGURES, names)
        np.testing.assert_allclose(one.values, other.values, rtol=1e-7, atol=1e-9)
        np.testing.assert_allclose(one.jacobian, other.jacobian, rtol=1e-4, atol=1e-7)


def test_a_cycle_beside_takes_a_few_periods(monkeypatch):
    marched = []
    march = linear_cycles.repeat_march

    def counted(*args, **keywords):
        found = march(*args, **keywords)
        marched.append(found.n_marched)
        return found

    monkeypatch.setattr(linear_cycles, "repeat_march", counted)
    cycles = LinearCycles(lp.load_machine("kunt_singh_1990"), 10.0)
    for duty in (0.45, 0.451, 0.452):
        assert cycles.figures({"duty": duty}, FIGURES, ["duty"]).spectral_radius < 0.9
    assert len(marched) == 3
    assert max(marched[1:]) <= 6
