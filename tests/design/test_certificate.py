"""Certificates of stability under any switching, with known answers."""

import numpy as np
import pytest
from scipy.linalg import expm

import ltvpneu as lp
from ltvpneu import design
from ltvpneu.design.certificate import verified_rate
from ltvpneu.models.linear.linearize import areas_at


def holds(certificate):
    """An independent check: P positive, and every A' P + P A + 2 alpha P negative, by eigenvalues."""
    (P,) = certificate.functions
    scale = 1 / np.sqrt(np.diag(P))
    P = P * scale[:, None] * scale
    worst = -np.inf
    for A in certificate.matrices * (scale / scale[:, None]):
        worst = max(worst, np.linalg.eigvalsh(A.T @ P + P @ A + 2 * certificate.decay_rate * P)[-1])
    return np.linalg.eigvalsh(P)[0] > 0 and worst <= 1e-9 * np.abs(certificate.matrices).max()


def test_normal_matrices_share_a_function_of_the_slowest_rate():
    matrices = [np.diag([-1.0, -3.0]), [[-2.0, 5.0], [-5.0, -2.0]], np.diag([-4.0, -1.5])]
    found = design.common_lyapunov(matrices)
    assert found.kind == "common"
    assert found.is_stable
    # With P = I the rate is 1, and no function shows more than the slowest eigenvalue.
    assert found.upper_bound == pytest.approx(1.0)
    assert 0.997 < found.decay_rate <= 1.0
    assert holds(found)


def test_commuting_triangular_matrices_share_a_function():
    found = design.common_lyapunov([[[-1.0, 100.0], [0.0, -2.0]], [[-3.0, 10.0], [0.0, -1.0]]])
    assert found.kind == "common"
    assert holds(found)


def test_switching_that_can_be_unstable_has_no_common_function_but_a_dwell_time():
    one, two = np.array([[-1.0, 10.0], [-0.1, -1.0]]), np.array([[-1.0, 0.1], [-10.0, -1.0]])
    # A quarter turn of each, over and over, grows.
    turns = expm(one * np.pi / 2) @ expm(two * np.pi / 2)
    assert np.abs(np.linalg.eigvals(turns)).max() > 1
    found = design.common_lyapunov([one, two])
    assert found.kind == "dwell time"
    assert not found.is_stable
    assert found.dwell_time > np.pi / 2
    for stay in found.dwell_time * np.array([1.0, 1.3, 2.0]):
        random = np.random.default_rng(0)
        state = random.normal(size=2)
        for _ in range(20):
            before = np.linalg.norm(state)
            state = expm(two * stay * random.uniform(1, 2)) @ expm(one * stay * random.uniform(1, 2)) @ state
        assert np.linalg.norm(state) < before


def test_an_unstable_matrix_has_none():
    found = design.common_lyapunov([[[-1.0, 0.0], [0.0, -1.0]], [[0.1, 0.0], [0.0, -1.0]]])
    assert found.kind == "none"
    assert np.isnan(found.decay_rate)
    assert np.isnan(found.dwell_time)
    assert found.upper_bound == pytest.approx(-0.1)
    assert design.common_lyapunov([[[0.0, 1.0], [-1.0, 0.0]]]).kind == "none"


@pytest.mark.parametrize("size", [3, 4, 6])
def test_random_sets_that_share_a_function_by_construction(size):
    random = np.random.default_rng(size)
    root = random.normal(size=(size, size)) + 2 * np.eye(size)
    matrices = []
    for _ in range(5):
        skew = random.normal(size=(size, size))
        decaying = (skew - skew.T) - np.diag(random.uniform(0.5, 3.0, size))
        matrices.append(np.linalg.solve(root, decaying @ root))
    found = design.common_lyapunov(matrices)
    assert found.kind == "common"
    assert found.decay_rate >= 0.5 * 0.99
    assert holds(found)


def test_a_claimed_function_is_checked_and_not_believed():
    A = np.array([[[-1.0, 10.0], [0.0, -1.0]]])
    assert verified_rate(A, np.eye(2)) < 0
    assert verified_rate(A, np.diag([1.0, -1.0])) == -np.inf
    assert verified_rate(A, np.zeros((2, 2))) == -np.inf
    assert verified_rate(-np.eye(2)[None], np.eye(2)) == pytest.approx(1.0, abs=1e-12)
    # A rate of nothing but rounding is none.
    assert verified_rate(np.zeros((1, 2, 2)), np.eye(2)) <= 0


def test_steps_of_the_machine_share_a_function_and_every_duty_decays_at_its_rate():
    machine = lp.load_machine("kunt_singh_1990")
    model = lp.ltv_model(machine, 4.0)
    found = design.common_lyapunov(model)
    assert found.kind == "common"
    assert found.decay_rate > 0.95 * found.upper_bound
    assert holds(found)
    for duty in (0.1, 0.5, 0.9):
        for frequency in (1.0, 5.0, 30.0):
            durations = np.array([duty, 1 - duty]) / frequency
            system = lp.PeriodicSystem.from_matrices(model.system.A, np.zeros((2, 3)), durations)
            assert lp.floquet(system).log_moduli[0] * frequency <= -found.decay_rate * (1 - 1e-9)


def test_a_box_of_operating_points_is_certified_or_has_a_dwell_time():
    machine = lp.load_machine("kunt_singh_1990")
    small = design.operating_box(machine, position=(0.04, 0.06), pressures=[(1.5e5, 3.5e5)])
    found = design.common_lyapunov(small)
    assert found.kind == "common"
    assert holds(found)
    random = np.random.default_rng(2)
    (P,) = found.functions
    for _ in range(100):
        state = [random.uniform(0.04, 0.06), 0.0, random.uniform(1.5e5, 3.5e5)]
        A = lp.linearize(machine, state, areas=areas_at(machine, random.uniform(0, 2 * np.pi))).A
        assert verified_rate(A[None], P) >= found.decay_rate * (1 - 1e-6)
    large = design.operating_box(machine, position=(0.02, 0.08))
    assert design.common_lyapunov(large).kind == "dwell time"


def test_every_linearization_in_the_box_is_in_the_hull():
    machine = lp.load_machine("kunt_singh_1990")
    position, pressures = (0.03, 0.07), [(1.2e5, 3.8e5)]
    box = design.operating_box(machine, position=position, pressures=pressures)
    least, most = box.min(axis=0), box.max(axis=0)
    random = np.random.default_rng(1)
    for _ in range(200):
        state = [random.uniform(*position), 0.0, random.uniform(*pressures[0])]
        areas = areas_at(machine, random.uniform(0, 2 * np.pi))
        A = lp.linearize(machine, state, areas=areas).A
        assert (least - 1e-12 * np.abs(A) <= A).all()
        assert (most + 1e-12 * np.abs(A) >= A).all()
    assert len(box) == 2 ** np.count_nonzero(most > least)


def test_the_hull_is_no_wider_than_the_grid_asks_for():
    box = design.operating_box(lp.load_machine("kunt_singh_1990"), position=(0.02, 0.08))
    # The true maximum, by samples, is -13.9 1/s.
    assert -13.9 <= box[:, 2, 2].max() < -13.4


def test_every_full_tangent_in_the_box_is_in_the_hull():
    machine = lp.load_machine("kunt_singh_1990")
    position, pressures, velocity = (0.04, 0.06), [(1.5e5, 3.5e5)], (-0.2, 0.3)
    box = design.operating_box(machine, position=position, pressures=pressures, velocity=velocity, tangent="full")
    least, most = box.min(axis=0), box.max(axis=0)
    random = np.random.default_rng(1)
    rates = []
    for _ in range(200):
        state = [random.uniform(*position), random.uniform(*velocity), random.uniform(*pressures[0])]
        areas = areas_at(machine, random.uniform(0, 2 * np.pi))
        A = lp.linearize(machine, state, areas=areas, tangent="full").A
        rates.append(np.linalg.eigvals(A).real.max())
        assert (least - 1e-12 * np.abs(A) <= A).all()
        assert (most + 1e-12 * np.abs(A) >= A).all()
    # Some are unstable, so no function is there to be found; the paper's G, at rest, has one.
    assert max(rates) > 0
    assert design.common_lyapunov(box).kind == "none"


def test_bad_sets_and_boxes_are_named():
    machine = lp.load_machine("kunt_singh_1990")
    with pytest.raises(ValueError, match="systems: found shape"):
        design.common_lyapunov(np.zeros((2, 3, 2)))
    with pytest.raises(ValueError, match="expected as many in each"):
        design.common_lyapunov(
            [
                lp.ltv_model(machine, 4.0),
                lp.PeriodicSystem.from_matrices([[[-1.0]]], [[0.0]], [1.0]),
            ]
        )
    with pytest.raises(ValueError, match="position: found 0.08 to 0.02"):
        design.operating_box(machine, position=(0.08, 0.02))
    with pytest.raises(ValueError, match="pressures: found 2 pairs, expected 1"):
        design.operating_box(machine, position=(0.02, 0.08), pressures=[(1e5, 2e5)] * 2)
    with pytest.raises(ValueError, match="velocity: found none, expected a least and a greatest one"):
        design.operating_box(machine, position=(0.02, 0.08), tangent="full")
    with pytest.raises(ValueError, match="velocity: found a range, expected none"):
        design.operating_box(machine, position=(0.02, 0.08), velocity=(0.0, 1.0))
    with pytest.raises(ValueError, match="velocity: found 1 to 0 m/s"):
        design.operating_box(machine, position=(0.02, 0.08), velocity=(1.0, 0.0), tangent="full")
    with pytest.raises(ValueError, match="tangent: found 'half'"):
        design.operating_box(machine, position=(0.02, 0.08), tangent="half")
    with pytest.raises(ValueError, match="pressure of an open source"):
        design.operating_box(machine, position=(0.02, 0.08), pressures=[(1e5, 4.1e5)])


def test_a_box_is_refused_where_it_would_not_bound_what_the_machine_does(table_1):
    from ltvpneu import design

    for machine in (table_1.with_thermal("adiabatic"), table_1.with_collapse("dynamic")):
        with pytest.raises(ValueError, match="expected a box over position and one pressure a chamber"):
            design.operating_box(machine, position=(0.02, 0.06))


def test_the_dwell_time_is_that_of_the_tight_inequalities():
    """Example of [Geromel2006]: 2.751 s by their inequalities; switching every 2.677 s can be unstable."""
    matrices = np.array([[[0.0, 1.0], [-10.0, -1.0]], [[0.0, 1.0], [-0.1, -0.5]]])
    found = design.common_lyapunov(matrices)
    assert found.kind == "dwell time"
    assert found.decay_rate > 0
    assert found.dwell_time == pytest.approx(2.751, abs=1e-3)
    maps = [expm(A * found.dwell_time) for A in matrices]
    for (A, P), map_, other in zip(
        zip(matrices, found.functions, strict=True), maps, found.functions[::-1], strict=True
    ):
        assert np.linalg.eigvalsh(A.T @ P + P @ A).max() < 0
        assert np.linalg.eigvalsh(map_.T @ other @ map_ - P).max() < 0
