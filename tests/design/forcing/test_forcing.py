"""Orbits as affine expressions of the inputs, against orbits computed anew and against dense problems built by hand."""

import cvxpy as cp
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import lsq_linear

import ltvpneu as lp
from ltvpneu import design
from ltvpneu.design.air_use import mean_flow
from ltvpneu.design.forcing.affine import AffineOrbit
from ltvpneu.design.forcing.forcing import with_inputs


@pytest.fixture(scope="module")
def machine():
    return lp.load_machine("kunt_singh_1990")


@pytest.fixture(scope="module")
def model(machine):
    return lp.ltv_model(machine, 10.0, n_steps=6)


def random_system(seed, n_steps=4, n=3, m=2, p=2):
    random = np.random.default_rng(seed)
    A = random.normal(size=(n_steps, n, n)) - 2.5 * np.eye(n)
    system = lp.PeriodicSystem.from_matrices(
        A,
        random.normal(size=(n_steps, n)),
        random.uniform(0.1, 0.6, n_steps),
        B=random.normal(size=(n_steps, n, m)),
        C=random.normal(size=(n_steps, p, n)),
        D=random.normal(size=(n_steps, p, m)),
    )
    return system.with_levels(random.normal(size=m))


@pytest.mark.parametrize("seed", range(4))
def test_every_expression_is_that_of_the_orbit_computed_anew(seed):
    system = random_system(seed)
    problem = design.forcing_problem(system, per_step=["u2"])
    random = np.random.default_rng(seed + 100)
    values = {"u1": random.normal(), "u2": random.normal(size=4)}
    for variable in problem.inputs["u1"].variables() + problem.inputs["u2"].variables():
        size = abs(system.levels[int(variable.name()[1]) - 1])
        variable.value = np.asarray(values[variable.name()]) / size
    orbit = lp.steady_state(with_inputs(system, {k: np.asarray(v) for k, v in values.items()}))
    angles = random.uniform(0, 2 * np.pi, 20)
    times = angles / (2 * np.pi) * system.period
    for row, signal in enumerate(orbit.signals):
        np.testing.assert_allclose(problem.at(signal, angles).value, orbit.at(times)[row], rtol=1e-8, atol=1e-10)
        assert problem.mean(signal).value == pytest.approx(orbit.mean(signal), rel=1e-8, abs=1e-10)
        real, imaginary = problem.fourier(signal, 2)
        expected = [
            sum(
                quad(
                    lambda t, wave=wave, row=row: orbit.at([t])[row, 0] * wave(t * 4 * np.pi / orbit.period),
                    a + 1e-12,
                    b - 1e-12,
                )[0]
                for a, b in zip(system.switching_times[:-1], system.switching_times[1:], strict=True)
            )
            / system.period
            for wave in (np.cos, lambda x: -np.sin(x))
        ]
        np.testing.assert_allclose([real.value, imaginary.value], expected, rtol=1e-7, atol=1e-9)


def dense(system, signal, angles):
    """Responses to unit inputs, one a step, by orbits alone."""
    N, m = system.n_steps, len(system.inputs)
    levels = {name: np.full(N, level) for name, level in zip(system.inputs, system.levels, strict=True)}

    def at(inputs):
        orbit = lp.steady_state(with_inputs(system, inputs))
        return orbit.at(angles / (2 * np.pi) * system.period)[orbit.signals.index(signal)]

    base, columns = at(levels), []
    for k in range(N):
        moved = levels["supply_pressure"].copy()
        moved[k] += 1e4
        columns.append((at({**levels, "supply_pressure": moved}) - base) / 1e4)
    assert m == 4
    return base, np.array(columns).T


def test_a_quadratic_problem_with_active_bounds_equals_the_dense_one(model):
    angles = np.linspace(0, 6, 12)
    wanted = 0.045 + 0.003 * np.cos(angles)
    problem = design.forcing_problem(model, free=["supply_pressure"], per_step=["supply_pressure"])
    supply = problem.inputs["supply_pressure"]
    objective = cp.sum_squares((problem.at("position", angles) - wanted) / 1e-3) + 1e-2 * cp.sum_squares(
        (supply - 4e5) / 1e5
    )
    found = problem.solve(cp.Minimize(objective), {"low": supply >= 3.5e5, "high": supply <= 4.2e5})
    base, columns = dense(model.system, "position", angles)
    level = model.system.levels[0]
    matrix = np.vstack([columns * 1e5 / 1e-3, 0.1 * np.eye(6)])
    right = np.concatenate([(wanted - base + columns @ np.full(6, level)) / 1e-3, 0.1 * np.full(6, 4.0)])
    by_hand = lsq_linear(matrix, right, bounds=(3.5, 4.2), method="bvls", tol=1e-15)
    assert np.sum(by_hand.active_mask != 0) >= 2
    assert found.value == pytest.approx(2 * by_hand.cost, rel=1e-7)
    np.testing.assert_allclose(found.inputs["supply_pressure"] / 1e5, by_hand.x, atol=1e-6)
    assert found.residual < 1e-8
    # What is predicted is what the system with these inputs does.
    orbit = lp.steady_state(found.system)
    np.testing.assert_allclose(
        orbit.at(angles / (2 * np.pi) * orbit.period)[0], problem.at("position", angles).value, rtol=1e-8
    )


def test_an_equality_constrained_problem_equals_its_kkt_system(model):
    angles = np.linspace(0, 6, 12)
    problem = design.forcing_problem(model, free=["supply_pressure"], per_step=["supply_pressure"])
    problem.limits.clear()
    position, supply = problem.at("position", angles), problem.inputs["supply_pressure"]
    mean = cp.sum(position) / 12
    found = problem.solve(
        cp.Minimize(cp.sum_squares((position - 0.05) / 1e-3) + 1e-3 * cp.sum_squares(supply / 1e5)),
        {"mean": mean == 0.045},
    )
    base, columns = dense(model.system, "position", angles)
    offset = base - columns @ np.full(6, model.system.levels[0])
    M, v = columns * 1e8, (offset - 0.05) / 1e-3
    row = columns.mean(axis=0) * 1e5
    kkt = np.block([[2 * M.T @ M + 2e-3 * np.eye(6), row[:, None]], [row[None], np.zeros((1, 1))]])
    x = np.linalg.solve(kkt, np.append(-2 * M.T @ v, 0.045 - offset.mean()))
    assert found.value == pytest.approx(np.sum((M @ x[:6] + v) ** 2) + 1e-3 * np.sum(x[:6] ** 2), rel=1e-7)
    assert abs(found.duals["mean"]) == pytest.approx(abs(x[6]), rel=1e-5)


def test_scenarios_share_their_inputs(machine):
    """The least supply pressure that holds 40 mm however the load pulls by 50 N."""
    first = design.forcing_problem(lp.ltv_model(machine, 10.0), free=["supply_pressure"])
    supply = first.inputs["supply_pressure"]
    pulled = design.forcing_problem(
        lp.ltv_model(machine, 10.0), free=[], given={"supply_pressure": supply, "load_force": -50.0}
    )
    limits = {"free": first.mean("position") >= 0.04, "pulled": pulled.mean("position") >= 0.04}
    found = first.solve(cp.Minimize(supply), limits)
    assert found.status == "optimal"
    assert pulled.mean("position").value == pytest.approx(0.04, abs=1e-9)
    assert first.mean("position").value > 0.0401
    assert found.duals["pulled"] > 0
    assert abs(found.duals["free"]) < 1e-6 * found.duals["pulled"]


def test_an_infeasible_problem_has_a_status_and_no_figures(model):
    problem = design.forcing_problem(model, free=["supply_pressure"])
    supply = problem.inputs["supply_pressure"]
    found = problem.solve(cp.Minimize(supply), [problem.mean("position") >= 0.05, supply <= 1e5])
    assert found.status == "infeasible"
    assert np.isnan(found.value)
    assert np.isnan(found.inputs["supply_pressure"])
    assert found.system is None
    # The linear model alone would take the supply below the exhaust, and below vacuum.
    lowest = problem.solve(cp.Minimize(supply))
    assert lowest.inputs["supply_pressure"] == pytest.approx(1e5)
    assert lowest.duals["supply above exhaust"] > 0
    problem.limits.clear()
    assert problem.solve(cp.Minimize(supply)).status == "unbounded"


def test_bad_problems_are_named(model):
    problem = design.forcing_problem(model)
    with pytest.raises(ValueError, match="found 'positon', expected one of .* did you mean 'position'"):
        problem.mean("positon")
    with pytest.raises(lp.NotConvexError, match="the objective.*cvxpy says"):
        problem.solve(cp.Maximize(cp.square(problem.mean("position"))))
    with pytest.raises(lp.NotConvexError, match="not convex: floor"):
        problem.solve(cp.Minimize(0), {"floor": cp.square(problem.mean("position")) >= 1})
    with pytest.raises(ValueError, match="found 'supply above exhaust', which is the name of one of the limits"):
        problem.solve(cp.Minimize(0), {"supply above exhaust": problem.mean("position") >= 0})
    with pytest.raises(TypeError, match="objective: found int"):
        problem.solve(3)
    with pytest.raises(ValueError, match="constraint 1: found True"):
        problem.solve(cp.Minimize(0), [1 < 2])
    with pytest.raises(TypeError, match="constraint 1: found str"):
        problem.solve(cp.Minimize(0), ["x"])
    with pytest.raises(lp.SolverError, match="the solver failed"):
        problem.solve(cp.Minimize(0), solver="NOSUCH")
    with pytest.raises(ValueError, match="free: found 'supply', expected one of .*did you mean 'supply_pressure'"):
        design.forcing_problem(model, free=["supply"])
    with pytest.raises(ValueError, match="which is free too"):
        design.forcing_problem(model, free=["load_force"], given={"load_force": 1.0})
    with pytest.raises(ValueError, match="per_step: found 'load_force', which is not free"):
        design.forcing_problem(model, free=["supply_pressure"], per_step=["load_force"])
    with pytest.raises(ValueError, match="curvature CONVEX"):
        design.forcing_problem(model, given={"load_force": cp.square(cp.Variable())})
    with pytest.raises(ValueError, match=r"shape \(2,\)"):
        design.forcing_problem(model, given={"load_force": [1.0, 2.0]})
    with pytest.raises(TypeError, match="expected a PeriodicSystem"):
        design.forcing_problem(3)


def test_an_orbit_must_exist(model):
    drifting = lp.PeriodicSystem.from_matrices([[[0.0]]], [[1.0]], [1.0])
    with pytest.raises(lp.NoOrbitError):
        design.forcing_problem(drifting)


def test_fixed_systems_have_constant_expressions():
    system = lp.PeriodicSystem.from_matrices([[[-1.0]], [[-1.0]]], [[1.0], [0.0]], [0.25, 0.75])
    assert design.forcing_problem(system).mean("z1").value == pytest.approx(0.25)
    np.testing.assert_allclose(AffineOrbit(system=system).coefficient("z1", 0), [0.25], atol=1e-14)


@pytest.mark.parametrize("name", ["kunt_singh_1990", "double_acting_5_2"])
@pytest.mark.parametrize("frequency", [1.0, 8.0])
def test_the_air_taken_from_the_supply_leaves_to_the_exhaust(name, frequency):
    machine = lp.load_machine(name).with_duty(0.4)
    # Where a chamber lies at its source's pressure, what is left of the flow is the root of the pressures' tolerance.
    orbit = lp.nonlinear_orbit(machine, frequency, method=lp.DormandPrince(rtol=1e-10))
    taken, left = design.air_use(machine, orbit), -mean_flow(machine, orbit, from_supply=False)
    assert taken > 0
    assert taken == pytest.approx(left, rel=1e-5)


@pytest.mark.parametrize(("mode", "n_steps", "tolerance"), [("fitted", 2, 0.06), ("self-consistent", 40, 0.01)])
def test_the_linear_models_take_the_same_air(machine, mode, n_steps, tolerance):
    for frequency in (4.0, 10.0):
        model = lp.ltv_model(machine, frequency, n_steps=n_steps, operating_points=mode)
        linear = lp.steady_state(design.with_air_use(model)).mean("air_use")
        assert linear == pytest.approx(design.air_use(machine, lp.nonlinear_orbit(machine, frequency)), rel=tolerance)


@pytest.mark.parametrize("sense", [cp.Minimize, cp.Maximize])
def test_duals_say_how_fast_the_objective_gets_better(sense):
    system = random_system(3)
    better = -1 if sense is cp.Minimize else 1

    def solved(right: float, bound: float) -> design.ForcingSolution:
        problem = design.forcing_problem(system)
        u1, u2 = problem.inputs["u1"], problem.inputs["u2"]
        cost = cp.square(u1) + cp.square(u2 - 3)
        constraints = {"equation": problem.mean("z1") == right, "inequality": u2 <= bound}
        return problem.solve(sense(cost if sense is cp.Minimize else -cost), constraints)

    found, step = solved(0.2, 1.0), 1e-3
    for name, ahead, behind in (
        ("equation", solved(0.2 + step, 1.0), solved(0.2 - step, 1.0)),
        ("inequality", solved(0.2, 1.0 + step), solved(0.2, 1.0 - step)),
    ):
        gain = better * (ahead.value - behind.value) / (2 * step)
        assert float(found.duals[name]) == pytest.approx(gain, rel=1e-4, abs=1e-6)
    assert float(found.duals["inequality"]) > 0
