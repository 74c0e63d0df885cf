"""Results and errors travel: pickled, copied and compared by what they hold, arrays closed to writing throughout."""

import copy
import inspect
import pickle
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import fields, is_dataclass, replace
from multiprocessing import get_context
from typing import Any

import control
import numba
import numpy as np
import pytest

import ltvpneu as lp
from ltvpneu import design, errors
from ltvpneu._values import Value, same
from tests.models.nonlinear.test_stroke import lift

MACHINE = lp.load_machine("kunt_singh_1990")
CLASSES = {
    name: kind
    for module in (lp, design)
    for name in module.__all__
    if inspect.isclass(kind := getattr(module, name)) and is_dataclass(kind)
}
ERRORS = {name: kind for name, kind in vars(errors).items() if inspect.isclass(kind) and issubclass(kind, Exception)}


def model() -> lp.LtvModel:
    return lp.ltv_model(MACHINE, 15.0, operating_points="fitted")


def sprung_less() -> lp.Machine:
    return replace(MACHINE, load=replace(MACHINE.load, spring_stiffness=0.0))


def closed_loop() -> design.ClosedLoop:
    law = control.ss([], [], [], [[0.0]], 1 / 15.0)
    return design.simulate_closed_loop(MACHINE, law, [0.05, 0.05], 15.0)


def optimum() -> design.DutySolution:
    return design.optimize_duty(MACHINE, 15.0, mean={"position": 0.045}, minimize="air_use", correct=True)


def forcing() -> Any:
    problem = design.forcing_problem(lp.ltv_model(MACHINE, 10.0), free=["supply_pressure"])
    import cvxpy as cp

    return problem.solve(cp.Minimize(problem.inputs["supply_pressure"]), [problem.mean("position") >= 0.045])


DRIVE = lp.load_machine("double_acting_5_2")
SAMPLES: dict[str, Callable[[], Any]] = {
    "ISO6358": lambda: lp.ISO6358(sonic_conductance=0.7e-8),
    "Stroke": lambda: lp.stroke(lift()),
    "TradeOff": lambda: design.trade_off(
        MACHINE, (14.0, 15.0), {"duty": (0.42, 0.45)}, mean={"position": 0.045}, points=2
    ),
    "Tube": lambda: lp.Tube(length=1.0, inner_diameter=0.004),
    "AmplitudeResponse": lambda: lp.amplitude_response(sprung_less(), [5.0, 9.0]),
    "Attractors": lambda: lp.attractors(MACHINE, 8.0),
    "Balance": lambda: lp.balance(MACHINE, lp.nonlinear_orbit(MACHINE, 8.0)),
    "Box": lambda: design.Box(position=(0.0, 0.1), pressures=((1e5, 2e5),)),
    "Branch": lambda: lp.orbit_map(MACHINE, [0.5], [8.0]).branches[0][0][0],
    "Catalogue": lp.catalogue,
    "CatalogueCylinder": lambda: lp.catalogue().cylinders[0],
    "CatalogueValve": lambda: lp.catalogue().valves[0],
    "Certificate": lambda: design.common_lyapunov(lp.ltv_model(MACHINE, 15.0)),
    "ClosedLoop": closed_loop,
    "Command": lambda: lp.Command(angles=(0.0, 2.0), openings=(-0.8, 1.0)),
    "Cylinder": lambda: MACHINE.cylinder,
    "Chosen": lambda: design.optimize_duty(
        MACHINE, 15.0, {"supply_pressure": (4e5, 4.2e5)}, choices={"duty": [0.45]}
    ).choices[0],
    "DataSheet": lambda: lp.data_sheet(lift(), 20.0),
    "DormandPrince": lp.DormandPrince,
    "DutyMap": lambda: design.duty_map(MACHINE, [0.4, 0.5], [8.0]),
    "DutySolution": optimum,
    "EnergyBalance": lp.EnergyBalance,
    "ErrorEstimate": lambda: lp.ltv_model(MACHINE, 15.0).error_estimate,
    "Estimator": lambda: lp.kalman(lp.ltv_model(MACHINE, 15.0).system, np.eye(3), np.eye(3)),
    "Event": lambda: lp.Event(time=0.1, kind="stops"),
    "FailedPoint": lambda: lp.amplitude_response(sprung_less(), [5.0]).failures[0],
    "Floquet": lambda: lp.orbit_floquet(MACHINE, lp.nonlinear_orbit(MACHINE, 8.0)),
    "FlowPath": lambda: DRIVE.flow_paths[0],
    "ForcingSolution": forcing,
    "Gas": lp.Gas,
    "GoalCheck": lambda: design.check_goals(
        MACHINE, 15.0, {"load.mass": "+-5 %"}, goals=design.Goals(mean={"position": (None, 0.06)}), n=2
    ),
    "Goals": lambda: design.Goals(mean={"position": 0.045}, cycle={"position": (np.array([0.0]), np.array([0.04]))}),
    "Gradient": lambda: lp.sensitivity(lp.ltv_model(MACHINE, 15.0).system).of_mean("position"),
    "Gramians": lambda: lp.gramians(lp.ltv_model(MACHINE, 15.0).system),
    "InnerVolume": lambda: MACHINE.valve.inner_volumes[0],
    "Linearization": lambda: lp.linearize(MACHINE, [0.05, 0.0, 2.5e5]),
    "Liquid": lp.Liquid,
    "Load": lambda: MACHINE.load,
    "LtvModel": model,
    "Machine": lambda: DRIVE,
    "Measurement": lambda: design.Measurement(
        number=1, time=0.1, reference=0.05, mean_position=0.04, state=np.array(MACHINE.rest_state)
    ),
    "OnOffValve": lambda: DRIVE.valve,
    "Orbit": lambda: lp.nonlinear_orbit(MACHINE, 8.0),
    "OrbitMap": lambda: lp.orbit_map(sprung_less(), [0.5], [8.0]),
    "ParameterSensitivity": lambda: lp.parameter_sensitivity(model(), ["duty"]),
    "MoveSolution": lambda: design.optimize_move(MACHINE, 0.02, {"position": 0.07}, switches=0),
    "PatternSolution": lambda: design.optimize_pattern(MACHINE, 10.0, 6, mean={"position": (0.03, 0.06)}),
    "DiscretePeriodicSystem": lambda: lp.sampled(lp.ltv_model(MACHINE, 15.0).system),
    "PeriodicSystem": lambda: lp.ltv_model(MACHINE, 15.0).system,
    "PeriodMap": lambda: lp.PeriodMap(machine=MACHINE, frequency=8.0),
    "Port": lambda: MACHINE.valve.ports[0],
    "ProductMultipliers": lambda: lp.product_multipliers([np.eye(2), 0.5 * np.eye(2)]),
    "Profile": lambda: MACHINE.connections[0].first,
    "ProportionalValve": lambda: lp.ProportionalValve(command=lp.Command(angles=(0.0, 2.0), openings=(-0.8, 1.0))),
    "RealGas": lambda: lp.RealGas(fluid="Nitrogen"),
    "Regulator": lambda: lp.lqr(lp.ltv_model(MACHINE, 15.0).system, np.eye(3), np.eye(4)),
    "RotaryValve": lambda: MACHINE.valve,
    "RungeKutta4": lp.RungeKutta4,
    "Sensitivity": lambda: lp.sensitivity(lp.ltv_model(MACHINE, 15.0).system),
    "Sized": lambda: design.size(0.1, 5.0, 0.5, 7e5).best,
    "Sizing": lambda: design.size(0.1, 5.0, 0.5, 7e5),
    "Sensor": lambda: design.Sensor(noise=5e-5, quantization=1e-4, delay=2e-3),
    "StabilityMap": lambda: design.stability_map(MACHINE, [0.4, 0.5], [8.0]),
    "Step": lambda: lp.ltv_model(MACHINE, 15.0).system.steps[0],
    "StictionBand": lambda: lp.stiction_band(MACHINE.with_duty(0.7), 20.0),
    "SwitchingSolution": lambda: design.optimize_switching(lp.ltv_model(MACHINE, 15.0).system, MACHINE.rest_state),
    "Turn": lambda: lp.PeriodMap(machine=MACHINE, frequency=8.0).turn(MACHINE.rest_state),
    "ValidityMap": lambda: lp.validity_map(MACHINE, [0.5], [8.0]),
    "ValveLimits": lambda: design.ValveLimits(opening_delay=1e-3),
    "Variation": lambda: lp.sensitivity(lp.ltv_model(MACHINE, 15.0).system).along(A=np.ones((2, 3, 3))),
    "Window": lambda: MACHINE.valve.on_window(),
}


def arrays_of(value: Any, seen: set[int] | None = None) -> Iterator[np.ndarray]:
    """Every array that a value holds."""
    seen = set() if seen is None else seen
    if id(value) in seen:
        return
    seen.add(id(value))
    if isinstance(value, np.ndarray):
        yield value
    elif isinstance(value, Value):
        for field in fields(value):
            yield from arrays_of(getattr(value, field.name), seen)
    elif isinstance(value, tuple | list):
        for item in value:
            yield from arrays_of(item, seen)
    elif isinstance(value, dict):
        for item in value.values():
            yield from arrays_of(item, seen)


def test_every_public_value_has_a_sample():
    assert set(CLASSES) <= set(SAMPLES), sorted(set(CLASSES) - set(SAMPLES))
    assert all(issubclass(kind, Value) for kind in CLASSES.values())


@pytest.mark.parametrize("name", sorted(CLASSES))
def test_values_can_be_pickled_copied_and_compared(name):
    value = SAMPLES[name]()
    assert isinstance(value, CLASSES[name])
    repr(value)
    for way, other in (
        ("pickle", pickle.loads(pickle.dumps(value))),
        ("copy", copy.copy(value)),
        ("deep copy", copy.deepcopy(value)),
    ):
        assert other == value, way
        assert hash(other) == hash(value), way
        before, after = list(arrays_of(value)), list(arrays_of(other))
        assert [array.flags.writeable for array in after] == [array.flags.writeable for array in before], way
    assert value != object()


def test_a_copied_machine_reaches_the_kernels_as_the_one_it_was_copied_from():
    for machine in (MACHINE, DRIVE, MACHINE.with_collapse("dynamic")):
        machine.record, machine.openings  # noqa: B018 - what is cached does not travel
        other = pickle.loads(pickle.dumps(machine))
        assert "record" not in vars(other)
        assert numba.typeof(other.record) == numba.typeof(machine.record)
        assert numba.typeof(other.openings) == numba.typeof(machine.openings)
    found = model()
    other = pickle.loads(pickle.dumps(found))
    assert numba.typeof(other.found.plan) == numba.typeof(found.found.plan)
    assert lp.cycle_floquet(other) == lp.cycle_floquet(found)


def test_values_that_differ_are_not_equal():
    orbit = lp.nonlinear_orbit(MACHINE, 8.0)
    assert orbit != lp.nonlinear_orbit(MACHINE, 8.5)
    assert orbit == lp.nonlinear_orbit(MACHINE, 8.0)
    assert MACHINE.with_duty(0.4) != MACHINE
    assert lp.load_machine("kunt_singh_1990") == MACHINE
    states = orbit.step_states.copy()
    states[0, 0] += 1e-12
    assert orbit != replace(orbit, step_states=states)


def test_what_is_no_number_is_the_same_as_itself():
    assert same({"a": (np.nan, np.array([1.0, np.nan]))}, {"a": (float("nan"), np.array([1.0, np.nan]))})
    assert not same(np.array([1, 2]), np.array([1.0, 2.0]))
    assert not same((1.0, 2.0), (1.0,))
    assert not same(1.0, 1)


def an_error(kind: type[Exception]) -> Exception:
    """Return an error of a class with a figure for each that its constructor asks for."""
    names = [p.name for p in inspect.signature(kind.__init__).parameters.values() if p.kind is p.KEYWORD_ONLY]
    closed = np.array([1.0, np.nan])
    closed.setflags(write=False)
    return kind("what happened", **dict.fromkeys(names, closed))


@pytest.mark.parametrize("name", sorted(ERRORS))
def test_errors_can_be_pickled_copied_and_compared(name):
    error = an_error(ERRORS[name])
    for other in (pickle.loads(pickle.dumps(error)), copy.copy(error), copy.deepcopy(error)):
        assert type(other) is type(error)
        assert other == error
        assert hash(other) == hash(error)
        assert str(other) == "what happened"
        for figure in vars(other).values():
            assert not figure.flags.writeable
    assert error != ERRORS[name].__new__(ERRORS[name], "something else")


def failing(frequency: float) -> float:
    return lp.nonlinear_orbit(sprung_less(), frequency, max_periods=20).amplitude(0)


def test_a_failed_point_in_a_pool_of_processes_comes_back():
    with ProcessPoolExecutor(1, mp_context=get_context("forkserver")) as pool:
        with pytest.raises(lp.NotSettledError, match="no periodic orbit after 20 valve periods") as caught:
            pool.submit(failing, 9.0).result(timeout=300)
        assert caught.value.n_simulated == 20
        assert caught.value.last_state.shape == (3,)
