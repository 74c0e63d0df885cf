"""A periodic system among python-control's blocks: exact with SwitchAware, never silently wrong without."""

import copy
import pickle

import control as ct
import numpy as np
import pytest
from scipy.integrate import Radau

import ltvpneu as lp

TIMES = np.linspace(0, 5, 11)


def pulsed() -> lp.PeriodicSystem:
    return lp.PeriodicSystem.from_matrices(
        [[[-1.0]]] * 3, [[0.0], [100.0], [0.0]], [0.47, 0.01, 0.52], B=[[[1.0]]] * 3, C=[[[1.0]]] * 3
    )


def closed_loop() -> tuple[ct.InterconnectedSystem, lp.PeriodicSystem]:
    """The pulsed circuit under a lag, as a diagram and as one periodic system."""
    controller = ct.ss([[-2.0]], [[1.0]], [[3.0]], [[0.0]], inputs=["e"], outputs=["u1"], name="controller")
    difference = ct.summing_junction(inputs=["r", "-y1"], output="e", name="difference")
    diagram = ct.interconnect([lp.to_iosys(pulsed(), name="plant"), controller, difference], inputs="r", outputs="y1")
    return diagram, lp.feedback(lp.series(controller, pulsed()), [[1.0]])


def simulated(block, inputs=0.0, **options):
    start = [0.0] * block.nstates
    return ct.input_output_response(block, TIMES, inputs * np.ones_like(TIMES), start, **options)


@pytest.mark.parametrize("options", [{}, {"base": Radau, "rtol": 1e-8, "atol": 1e-10}])
def test_switch_aware_hits_the_pulse(options):
    exact = lp.response(pulsed(), n_periods=5).outputs[0, -1]
    found = simulated(lp.to_iosys(pulsed()), solve_ivp_method=lp.SwitchAware, solve_ivp_kwargs=options)
    assert isinstance(found, ct.TimeResponseData)
    assert found.outputs[-1] == pytest.approx(exact, rel=1e-6 if options else 1e-10)


def test_switch_aware_hits_the_pulse_in_a_closed_loop():
    diagram, whole = closed_loop()
    exact = lp.response(whole.with_levels([1.0]), n_periods=5).outputs[0, -1]
    found = simulated(diagram, 1.0, solve_ivp_method=lp.SwitchAware)
    assert found.outputs[-1] == pytest.approx(exact, rel=1e-10)


@pytest.mark.parametrize("solver", ["RK45", "RK23", "DOP853", "Radau", "BDF", "LSODA"])
@pytest.mark.parametrize("is_closed", [False, True])
def test_a_plain_solver_that_jumps_over_the_pulse_raises(solver, is_closed):
    block = closed_loop()[0] if is_closed else lp.to_iosys(pulsed(), name="plant")
    with pytest.raises(lp.SkippedStepError, match="plant: the solver jumped over step 2 of 0.01 s at t = ") as caught:
        simulated(block, solve_ivp_method=solver)
    assert caught.value.step == 1
    assert caught.value.time % 1.0 == pytest.approx(0.47)


def test_a_plain_solver_asked_for_the_last_point_only_raises_too():
    with pytest.raises(lp.SkippedStepError):
        simulated(lp.to_iosys(pulsed()), evaluation_times=[5.0])


def test_a_plain_solver_with_short_steps_may_answer():
    exact = lp.response(pulsed(), n_periods=5).outputs[0, -1]
    for block in (lp.to_iosys(pulsed()), closed_loop()[0]):
        found = simulated(block, solve_ivp_kwargs={"max_step": 0.004, "rtol": 1e-8})
        assert found.outputs.shape == (11,)
    found = simulated(lp.to_iosys(pulsed()), solve_ivp_kwargs={"max_step": 0.004, "rtol": 1e-8})
    assert found.outputs[-1] == pytest.approx(exact, rel=1e-3)


def test_one_run_does_not_hide_what_the_next_one_skips():
    block = lp.to_iosys(pulsed())
    simulated(block, solve_ivp_kwargs={"max_step": 0.004})
    with pytest.raises(lp.SkippedStepError):
        simulated(block)
    simulated(block, solve_ivp_method=lp.SwitchAware)
    with pytest.raises(lp.SkippedStepError):
        simulated(block)


def test_a_pulse_of_the_input_is_hit_too():
    """One step for ever, at rest: only the input's own time points tell of the pulse."""
    system = lp.PeriodicSystem.from_matrices([[[-1.0]]], [[0.0]], [5.0], B=[[[1.0]]], C=[[[1.0]]])
    times = np.linspace(0, 5, 501)
    inputs = np.where((times > 3.295) & (times < 3.345), 1.0, 0.0)
    found = ct.input_output_response(lp.to_iosys(system), times, inputs, [0.0], solve_ivp_method=lp.SwitchAware)
    # Trapezoids from 3.29 to 3.35, by Simpson's rule on the smooth weight.
    nodes, weights = np.polynomial.legendre.leggauss(4)
    pieces = [(3.29 + 0.01 * k, 3.30 + 0.01 * k) for k in range(6)]
    exact = sum(
        w * 0.005 * np.interp(a + 0.005 * (x + 1), times, inputs) * np.exp(-(5 - a - 0.005 * (x + 1)))
        for a, _ in pieces
        for x, w in zip(nodes, weights, strict=True)
    )
    assert found.outputs[-1] == pytest.approx(exact, rel=1e-8)


def test_blocks_of_other_periods_and_zero_durations_switch_together():
    fast = lp.PeriodicSystem.from_matrices([[[-1.0]]] * 3, [[1.0], [9.0], [0.0]], [0.1, 0.0, 0.2], B=[[[1.0]]] * 3)
    slow = lp.PeriodicSystem.from_matrices([[[-2.0]]] * 2, [[1.0], [0.0]], [0.25, 0.5], B=[[[1.0]]] * 2)
    a, b = lp.to_iosys(fast, name="fast"), lp.to_iosys(slow, name="slow")
    found = simulated(ct.series(a, b), solve_ivp_method=lp.SwitchAware)
    exact = lp.response(lp.series(fast, slow), n_periods=4)
    assert lp.series(fast, slow).period == pytest.approx(1.5)
    at = np.argmin(np.abs(exact.time - 4.5))
    assert found.outputs[9] == pytest.approx(exact.outputs[0, at], rel=1e-9)


def test_the_step_at_a_switch_is_the_new_one_whatever_rounding_does():
    system = lp.PeriodicSystem.from_matrices([[[-1.0]], [[-2.0]], [[-3.0]]], [[0.0]] * 3, [0.1, 0.1, 0.1])
    block = lp.to_iosys(system)
    for count in range(3000):
        assert block.linearize([0], t=count * 0.1).A[0, 0] == -1 - count % 3


def test_a_step_without_inputs_is_a_state_space_system_all_the_same():
    system = lp.PeriodicSystem.from_matrices([[[-1.0]]], [[0.0]], [1.0])
    assert system.steps[0].sys.input_labels == ["one"]
    assert system.steps[0].sys.poles() == pytest.approx([-1.0])


def test_linearization_is_exact_and_keeps_its_names():
    machine = lp.load_machine("kunt_singh_1990")
    system = lp.ltv_model(machine, frequency=4.0).system
    found = ct.linearize(
        lp.to_iosys(system), np.zeros(system.n_states), np.zeros(len(system.inputs)), t=0.9 * system.period
    )
    np.testing.assert_array_equal(found.A, system.A[-1])
    np.testing.assert_array_equal(found.B, system.B[-1])
    assert found.state_labels == list(system.states)


@pytest.mark.parametrize(
    ("operation", "message"),
    [
        (ct.poles, "poles: has no meaning for plant, a periodic system; .* ltvpneu.floquet"),
        (ct.zeros, "zeros: has no meaning"),
        (ct.damp, "damp: has no meaning"),
        (ct.dcgain, "dcgain: has no meaning"),
        (lambda block: ct.sample_system(block, 0.1), "sample: has no meaning"),
        (lambda block: ct.frequency_response(block, [1.0]), "frequency_response: has no meaning"),
        (lambda block: ct.evalfr(block, 1j), "evaluation at a frequency: has no meaning"),
        (lambda block: ct.lqr(block, [[1.0]], [[1.0]]), "design with ltvpneu.lqr"),
        (ct.bode_plot, "bode_plot: has no meaning"),
        (lambda block: ct.find_operating_point(block, [0.0], [0.0]), "periodic and has no equilibrium"),
    ],
)
def test_operations_without_meaning_refuse_with_a_sentence(operation, message):
    with pytest.raises(TypeError, match=message):
        operation(lp.to_iosys(pulsed(), name="plant"))


def test_a_diagram_has_no_equilibrium_either():
    with pytest.raises(TypeError, match="plant is periodic and has no equilibrium"):
        ct.find_operating_point(closed_loop()[0], [0.0, 0.0], [0.0])


def test_blocks_copy_pickle_and_combine():
    block = lp.to_iosys(pulsed(), name="plant")
    for twin in (copy.deepcopy(block), pickle.loads(pickle.dumps(block)), block.copy("other")):
        assert simulated(twin, solve_ivp_method=lp.SwitchAware).outputs[-1] == pytest.approx(
            simulated(block, solve_ivp_method=lp.SwitchAware).outputs[-1], rel=1e-12
        )
    assert (block * ct.ss(-1, 1, 1, 0)).nstates == 2
    assert ct.feedback(block, ct.ss(-1, 1, 1, 0)).nstates == 2


def test_going_backward_in_time_is_refused():
    with pytest.raises(ValueError, match="found an end at 0 s before the start at 1 s"):
        lp.SwitchAware(lambda t, y: -y, 1.0, np.zeros(1), 0.0)


def test_only_a_periodic_system_becomes_a_block():
    with pytest.raises(TypeError, match="system: found StateSpace, expected a PeriodicSystem"):
        lp.to_iosys(ct.ss(-1, 1, 1, 0))


def test_the_name_of_the_constant_input_is_kept():
    with pytest.raises(ValueError, match="inputs: found 'one', which is kept for the input"):
        lp.PeriodicSystem(
            durations=[1.0], A=[[[0.0]]], B=[[[1.0]]], r=[[0.0]], C=[[[1.0]]], D=[[[0.0]]], q=[[0.0]],
            levels=[0.0], states=("x",), inputs=("one",), outputs=("y",),
        )  # fmt: skip
