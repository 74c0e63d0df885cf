"""The command line, its exit codes and files; pictures of every result."""

import json
import re
import subprocess
import sys
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

import ltvpneu as lp
from ltvpneu import design
from ltvpneu.face import study_design
from ltvpneu.face.cli import main
from ltvpneu.face.report import remarks


@pytest.fixture(autouse=True)
def _few_points(monkeypatch):
    """The design part of a study on a few points: `test_optimize_command` looks at its figures."""
    monkeypatch.setattr(study_design, "DUTIES", np.array([0.3, 0.5]))
    monkeypatch.setattr(study_design, "MAP_DUTIES", np.array([0.5]))
    monkeypatch.setattr(study_design, "N_FREQUENCIES", 2)


def test_importing_the_package_loads_no_heavy_library():
    code = "import sys, ltvpneu; print([m for m in ('control', 'cvxpy', 'matplotlib') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_every_public_name_exists_and_is_documented():
    for name in lp.__all__:
        assert getattr(lp, name).__doc__, name


def test_study_prints_tables_and_writes_pictures_and_json(tmp_path, capsys):
    code = main(["study", "--frequency", "1", "4", "10", "--points", "5", "--out", str(tmp_path)])
    printed = capsys.readouterr().out
    assert code == 0
    names = {path.name for path in tmp_path.iterdir()}
    cycles = {f"cycle_{f}_Hz.png" for f in (1, 4, 10)}
    others = {"valve_areas", "amplitude", "multipliers", "duty_map", "stability_map", "optimum"}
    assert names == {"study.json"} | {f"{name}.png" for name in others} | cycles
    assert all((tmp_path / name).read_bytes().startswith(b"\x89PNG") for name in names if name.endswith("png"))
    data = json.loads((tmp_path / "study.json").read_text())
    case = data["cases"][1]
    amplitude = case["orbits"]["nonlinear"]["signals"]["position"]["amplitude"]
    assert amplitude == pytest.approx(0.0352800444372215, rel=1e-5)
    assert f"{1e3 * amplitude:.3f}" in printed
    radius = case["floquet"]["ltv"]["spectral_radius"]
    assert f"{radius:.4g}    stable" in printed
    assert f"{case['models']['ltv']['G'][0][2][2]:.5g}" in printed
    assert [c["frequency"] for c in data["cases"]] == [1, 4, 10]
    assert 4.0 in data["amplitude_response"]["frequencies"]
    assert "held back: 4 Hz LTV step 1 pressure_1: asked 3.8425 bar, used 3.7729 bar" in printed


def test_study_of_a_double_acting_machine_at_duty_zero(tmp_path, capsys):
    arguments = ["study", "double_acting_5_2", "--duty", "0", "--frequency", "5", "--points", "2"]
    assert main([*arguments, "--out", str(tmp_path / "a" / "b")]) == 0
    assert "pressure 2 [bar]" in capsys.readouterr().out


def test_a_springless_machine_is_studied_by_fitted_points(tmp_path, capsys):
    """Without a spring there is no LTI model; that is said once, not at each point."""
    text = tmp_path / "rig.toml"
    text.write_text(SPRINGLESS)
    assert main(["study", str(text), "--frequency", "5", "--points", "2", "--out", str(tmp_path / "out")]) == 0
    printed = capsys.readouterr().out
    assert printed.count("has no spring") == 1
    assert "load.spring_stiffness" not in printed
    assert "5 Hz nonlinear" in printed
    assert "5 Hz LTV" in printed
    assert "5 Hz LTI" not in printed


def test_a_failing_model_leaves_the_others_standing(tmp_path, capsys):
    """Asked for by name, the paper's operating points have no place without a spring."""
    text = tmp_path / "rig.toml"
    text.write_text(SPRINGLESS)
    given = ["study", str(text), "--frequency", "5", "--points", "2", "--operating-points", "lti"]
    assert main([*given, "--out", str(tmp_path / "out")]) == 0
    printed = capsys.readouterr().out
    assert "failed: 5 Hz LTV: load.spring_stiffness: found none" in printed
    assert "5 Hz nonlinear" in printed


SPRINGLESS = """
name = "springless"
supply_pressure = "4 bar(g)"
exhaust_pressure = "1 bar"
[cylinder]
piston_area_1 = "6 cm^2"
piston_area_2 = "6 cm^2"
dead_volume_1 = "10 cm^3"
lower_stop = "0 mm"
upper_stop = "50 mm"
[load]
mass = "1 kg"
viscous_damping = "20 N s/m"
[valve]
type = "on_off"
duty = 0.9
[[flow_paths]]
source = "supply"
chamber = "chamber_1"
area = "5 mm^2"
opening = "on"
[[flow_paths]]
source = "exhaust"
chamber = "chamber_1"
area = "1 mm^2"
"""


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (["kunt_singh_1990", "--frequency", "4"], 0),
        (["kunt_singh_1990", "--frequency", "4", "10", "--duty", "0.3", "--n-steps", "6"], 0),
        (["double_acting_5_2", "--frequency", "10", "--duty", "1"], 0),
        (["unstable"], 1),
        (["kunt_singh_1990", "--frequency", "0"], 2),
        (["kunt_singh_1990", "--frequency", "4", "--duty", "1.5"], 2),
        (["kunt_singh_1990", "--frequency", "4", "--n-steps", "1"], 2),
        (["kunt_singh", "--frequency", "4"], 2),
        (["none.toml", "--frequency", "4"], 2),
    ],
)
def test_stability_exits_0_stable_1_not_stable_2_bad_input(arguments, code, monkeypatch, capsys):
    if arguments == ["unstable"]:
        # No machine with a spring and damping is unstable in this model; the exit code follows the verdict of the
        # multipliers.
        matrices = lp.PeriodicSystem.from_matrices([[[0.1]]], [[0.0]], [1.0])
        monkeypatch.setattr("ltvpneu.face.commands.cycle_floquet", lambda model: lp.floquet(matrices))
        arguments = ["kunt_singh_1990", "--frequency", "4"]
    assert main(["stability", *arguments]) == code
    captured = capsys.readouterr()
    if code == 2:
        assert captured.err.startswith("ltvpneu stability: error: ")
        assert captured.out == ""
    else:
        assert "verdict" in captured.out


def test_sweep_prints_kinds_and_errors_and_writes_both_maps(tmp_path, capsys):
    limits = ["--frequency", "4", "19", "--duty", "0.05", "0.5", "--points", "2"]
    assert main(["sweep", *limits, "--out", str(tmp_path / "out")]) == 0
    printed = capsys.readouterr().out
    # At 19 Hz and duty 0.05 stiction holds the piston; the other three points move.
    assert re.search(r"unique +3\n +band +1\n", printed)
    assert "at most 20 %: 3 of 4 points" in printed
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"orbit_map.png", "validity_map.png", "sweep.json"}
    data = json.loads((tmp_path / "out" / "sweep.json").read_text())
    orbit = lp.nonlinear_orbit(lp.load_machine("kunt_singh_1990").with_duty(0.5), 4.0)
    assert data["nonlinear"]["amplitudes"][0][1] == pytest.approx(orbit.amplitude("position"), rel=1e-6)
    assert data["ltv"]["errors"][1][0] is None


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        (["--points", "1"], "--points: found 1, expected 2 or more"),
        (["--duty", "0.6", "0.4"], "--duty: found 0.6 0.4, expected two rising numbers above zero and at most 1"),
        (["--frequency", "1", "nan"], "--frequency: found 1 nan"),
        (["--frequency", "0", "4"], "--frequency: found 0 4, expected two rising numbers above zero"),
        (["--duty", "0.2", "1.5"], "--duty: found 0.2 1.5"),
    ],
)
def test_bad_limits_of_a_sweep_exit_2(arguments, match, tmp_path, capsys):
    assert main(["sweep", *arguments, "--out", str(tmp_path / "out")]) == 2
    assert match in capsys.readouterr().err


def test_a_springless_machine_has_no_verdict_by_the_papers_points_but_an_explanation(tmp_path, capsys):
    (tmp_path / "rig.toml").write_text(SPRINGLESS)
    arguments = ["stability", str(tmp_path / "rig.toml"), "--frequency", "4", "--operating-points", "lti"]
    assert main(arguments) == 2
    assert capsys.readouterr().err.startswith("ltvpneu stability: error: rig.toml: load.spring_stiffness: found none")


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        (["study", "--frequency", "-1"], "--frequency: found -1 Hz"),
        (["study", "--points", "0"], "--points: found 0"),
        (["study", "--duty", "2"], "duty: found 2"),
        (["study", "missing.toml"], "cannot be read"),
    ],
)
def test_bad_input_to_the_study_exits_2_and_writes_nothing(arguments, match, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    assert match in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


FREE, SPRING_RETURN = (Path(__file__).parents[1] / "reference" / "machines" / name for name in (
    "free_cylinder.toml", "spring_return.toml",
))  # fmt: skip


def test_stability_goes_by_points_that_see_friction_and_stops(capsys):
    assert main(["stability", "kunt_singh_1990", "--frequency", "20", "--duty", "0.7"]) == 1
    assert re.search(r"20 +0.7 .* marginal +held by stiction", capsys.readouterr().out)
    assert main(["stability", str(SPRING_RETURN), "--frequency", "10"]) == 0
    assert re.search(r"stable +rests on the upper stop, 25 mm", capsys.readouterr().out)
    assert main(["stability", str(FREE), "--frequency", "20"]) == 0
    printed = capsys.readouterr().out
    assert "operating points 'fitted'" in printed
    assert "depends on the start: also mean -45.9" in printed


def test_a_sweep_says_where_the_start_decides_and_what_no_duty_holds(tmp_path, capsys):
    limits = ["--frequency", "15", "20", "--duty", "0.3", "0.6", "--points", "3"]
    assert main(["sweep", str(FREE), *limits, "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "depends on the start at 20 Hz, duty 0.45: " in printed
    assert re.search(r"no duty holds a mean position between -4\d\.\d+ and 4\d", printed)
    assert "Feedback holds it" in printed
    data = json.loads((tmp_path / "sweep.json").read_text())
    assert len(data["nonlinear"]["branches"][2][1]) == 2
    assert data["nonlinear"]["kinds"][2][1] == "depends on the start"


def test_attractors_are_drawn_with_their_shares():
    figure = lp.plot(lp.attractors(lp.load_machine(FREE), 20.0))
    labels = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    assert labels == ["90 %: rests on the upper stop, 50 mm", "10 %: mean -45.92 mm, amplitude 3.904 mm"]


def test_pictures_of_a_free_cylinder_keep_its_branches_apart():
    duties = design.duty_map(lp.load_machine(FREE), np.linspace(0.2, 0.8, 13), [20.0])
    figure = lp.plot(duties)
    upper = figure.axes[0]
    line = upper.lines[0].get_ydata()
    steps = np.abs(np.diff(line[np.isfinite(line)]))
    assert np.isnan(line).any()
    assert [text.get_text() for text in upper.get_legend().get_texts()][-1] == "depends on the start"
    stars = upper.lines[1].get_ydata()
    assert min(stars) < -45
    assert max(stars) > 45
    assert len(stars) == 2 * int(duties.orbits.depends_on_start.sum())
    assert steps.size > 5


def test_a_folder_that_cannot_be_made_is_found_out_before_the_work(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert main(["study", "--out", str(tmp_path / "file" / "out")]) == 2
    assert "--out: found" in capsys.readouterr().err


def test_linear_orbits_beyond_what_the_machine_can_do_are_remarked(tmp_path, capsys):
    assert main(["study", "double_acting_5_2", "--frequency", "1", "--points", "1", "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "passes the end stops" in printed
    assert "pressure 2 below vacuum" in printed
    assert "rests on an end stop" in printed
    remarks = json.loads((tmp_path / "study.json").read_text())["cases"][0]["orbits"]["lti"]["remarks"]
    assert "passes the end stops" in remarks


def test_wrong_usage_exits_2():
    for arguments in ([], ["stability", "kunt_singh_1990"], ["study", "--frequency", "four"], ["fly"]):
        with pytest.raises(SystemExit) as caught:
            main(arguments)
        assert caught.value.code == 2


def test_the_module_runs_as_a_command():
    done = subprocess.run([sys.executable, "-m", "ltvpneu", "--help"], capture_output=True, text=True, check=True)
    assert "stability" in done.stdout


# Pictures
# -----------------------------------------------------------------------------------------------------------------


def test_every_result_has_a_picture(table_1):
    model = lp.ltv_model(table_1, 4.0, n_steps=6)
    orbit = lp.steady_state(model.system)
    found = lp.amplitude_response(table_1.with_duty(0.86), [5.4, 20.0])
    results = {
        "machine": table_1,
        "model": model,
        "system": model.system,
        "floquet": lp.floquet(model.system),
        "orbit": orbit,
        "orbits": {"LTV": orbit, "nonlinear": lp.nonlinear_orbit(table_1, 4.0)},
        "floquets": {"a": lp.floquet(model.system), "b": lp.floquet(model.system)},
        "amplitudes": found,
        "response": lp.response(model.system, n_periods=1),
        "transient": lp.simulate(table_1, 4.0, n_periods=1),
        "one orbit": orbit.response(),
    }
    for name, result in results.items():
        figure = lp.plot(result)
        assert isinstance(figure, Figure), name
        assert figure.axes, name


def test_a_cycle_shows_the_orbit_it_was_given(table_1):
    orbit = lp.nonlinear_orbit(table_1, 4.0)
    line = lp.plot({"nonlinear": orbit}).axes[0].lines[0]
    values = np.asarray(line.get_ydata(), dtype=float)
    assert values.max() == pytest.approx(1e3 * orbit.maximum("position"), rel=1e-3)


def test_what_has_no_picture_is_a_type_error(table_1):
    with pytest.raises(TypeError, match="plot: found int"):
        lp.plot(3)
    with pytest.raises(TypeError, match="expected one of Orbit only"):
        lp.plot({"a": table_1})


# Amplitude response
# -------------------------------------------------------------------------------------------------------


def test_a_sweep_keeps_the_error_of_a_failed_point_and_goes_on(table_1):
    from dataclasses import replace

    machine = replace(table_1, load=replace(table_1.load, force=-30.0))
    calls = []
    found = lp.amplitude_response(machine, [1.0, 15.0], models=["nonlinear", "ltv"], progress=calls.append)
    assert [(f.model, f.frequency, type(f.error)) for f in found.failures] == [
        ("nonlinear", 1.0, lp.ChamberVolumeError)
    ]
    assert np.isnan(found.amplitude("nonlinear")[0])
    assert found.amplitude("nonlinear")[1] > 0
    assert calls == [1, 1]


def test_amplitudes_of_all_models_are_those_of_their_orbits(table_1):
    found = lp.amplitude_response(table_1, [4.0, 10.0])
    assert found.amplitude("nonlinear") == pytest.approx([0.03528, 0.01095], rel=1e-3)
    assert found.amplitude("ltv")[0] == lp.steady_state(lp.ltv_model(table_1, 4.0).system).amplitude("position")
    assert found.amplitude("lti")[1] == lp.steady_state(lp.lti_model(table_1, 10.0).system).amplitude("position")
    with pytest.raises(ValueError, match="model: found 'hybrid'"):
        found.amplitude("hybrid")


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"frequencies": [0.0]}, "frequencies: found"),
        ({"frequencies": []}, "frequencies: found"),
        ({"frequencies": [1.0], "models": ["ltx"]}, "models: found 'ltx'"),
    ],
)
def test_bad_sweeps_are_named(table_1, arguments, match):
    with pytest.raises(ValueError, match=match):
        lp.amplitude_response(table_1, **arguments)


def test_the_study_shows_the_estimated_error_the_band_and_the_multipliers_of_the_nonlinear_orbit(tmp_path, capsys):
    arguments = ["study", "--frequency", "15", "20", "--duty", "0.7", "--points", "1", "--out", str(tmp_path)]
    assert main(arguments) == 0
    printed = capsys.readouterr().out
    assert "one of a stiction band, 68.72 to 71.31 mm" in printed
    assert re.search(r"20 Hz nonlinear +1, 0.06922, 0 +1 +marginal", printed)
    locked = json.loads((tmp_path / "study.json").read_text())["cases"][1]
    band = lp.stiction_band(lp.load_machine("kunt_singh_1990").with_duty(0.7), 20.0)
    assert locked["stiction_bands"]["nonlinear"] == {"lowest": band.lowest, "highest": band.highest}
    model = lp.ltv_model(lp.load_machine("kunt_singh_1990").with_duty(0.7), 20.0)
    estimated = locked["estimated_errors"]["ltv"]["signals"]["position"]["amplitude"]
    assert estimated == pytest.approx(model.error_estimate.amplitude("position"))


def test_sensitivities_are_drawn_as_the_change_for_one_percent():
    machine = lp.load_machine("kunt_singh_1990")
    found = lp.parameter_sensitivity(lp.ltv_model(machine, 8.0, operating_points="fitted"))
    bars = [bar.get_width() for bar in lp.plot(found).axes[0].patches]
    assert len(bars) == 8
    assert bars[0] == pytest.approx(10 * 0.5 * found.amplitude("position", "duty"))


PROPORTIONAL = """
[valve]
type = "proportional"
command = [["0 deg", -0.8], ["126 deg", 1.0], ["216 deg", 0.3]]
"""


def test_a_proportional_valve_is_studied_without_duty_maps(tmp_path, capsys):
    text = (files("ltvpneu") / "machines/double_acting_5_2.toml").read_text(encoding="utf-8")
    begin = text.index("[valve]")
    end = text.index("\n[", begin + 1)
    path = tmp_path / "proportional.toml"
    path.write_text(text[:begin] + PROPORTIONAL + text[end:], encoding="utf-8")
    arguments = ["study", str(path), "--frequency", "6", "--points", "3", "--out", str(tmp_path / "out")]
    assert main(arguments) == 0
    assert "The valve is proportional" in capsys.readouterr().out
    assert (tmp_path / "out" / "study.json").exists()
    assert not (tmp_path / "out" / "duty_map.png").exists()


def test_warnings_and_a_missing_library_are_lines_not_tracebacks(tmp_path, capsys, monkeypatch):
    text = (files("ltvpneu") / "machines/kunt_singh_1990.toml").read_text(encoding="utf-8")
    path = tmp_path / "steep.toml"
    path.write_text(text.replace("polytropic_exponent_1 = 1.0", "polytropic_exponent_1 = 1.7"), encoding="utf-8")
    assert main(["stability", str(path), "--frequency", "4"]) == 0
    error = capsys.readouterr().err
    assert error.startswith("ltvpneu stability: warning: steep.toml: cylinder.polytropic_exponent_1: found 1.7")
    assert "Traceback" not in error
    assert "warnings.warn" not in error

    def missing(name: str):
        raise ImportError("real gas needs CoolProp: pip install 'ltvpneu[gas]'")

    monkeypatch.setattr("ltvpneu.face.commands.load_machine", missing)
    assert main(["stability", str(path), "--frequency", "4"]) == 2
    assert "error: real gas needs CoolProp" in capsys.readouterr().err


def test_remarks_on_pressures_do_not_fall_on_temperatures(table_1):
    machine = table_1.with_thermal("adiabatic")
    assert not any("temperature" in remark for remark in remarks(lp.nonlinear_orbit(machine, 4.0), machine))


def test_an_empty_stiction_band_says_none(table_1):
    assert "none" in repr(lp.stiction_band(table_1, 2.0))
    assert "m>" in repr(lp.stiction_band(table_1.with_duty(0.7), 20.0))


def test_ctrl_c_ends_a_command_with_a_word_and_its_exit_code(monkeypatch, capsys):
    def interrupted(_options):
        raise KeyboardInterrupt

    monkeypatch.setattr("ltvpneu.face.commands.stability", interrupted)
    assert main(["stability", "kunt_singh_1990", "--frequency", "4"]) == 130
    assert "ltvpneu stability: stopped" in capsys.readouterr().err


def test_a_system_in_discrete_time_shows_its_multipliers():
    system = lp.PeriodicSystem.from_matrices([[[-1.0]], [[-3.0]]], [[0.0]] * 2, [0.5, 0.5])
    assert lp.plot(lp.sampled(system)).axes[0].get_title() == "Floquet multipliers"
