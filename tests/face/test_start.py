"""What can be answered without the models is answered without loading them."""

import pickle
import subprocess
import sys

import pytest

import ltvpneu as lp

HEAVY = ("numpy", "scipy", "numba", "control", "matplotlib", "cvxpy")


def loaded_after(code: str) -> set[str]:
    """Return which of the heavy libraries a process has loaded at its end."""
    tail = f"\nimport sys\nprint(*[name for name in {HEAVY!r} if name in sys.modules], sep=',', end='')"
    done = subprocess.run([sys.executable, "-c", code + tail], capture_output=True, text=True, check=True)
    return set(filter(None, done.stdout.rpartition("\n")[2].split(",")))


@pytest.mark.parametrize("arguments", [
    ["--help"], ["--version"], ["study", "--help"], ["stabilty"], ["study", "--frequenzy", "3"], ["study", "nosuch"],
    ["stability", "nosuch.toml", "--frequency", "4"],
])  # fmt: skip
def test_help_typos_and_missing_files_load_nothing(arguments):
    code = f"from ltvpneu.face.cli import main\ntry:\n    main({arguments!r})\nexcept SystemExit:\n    pass"
    assert loaded_after(code) == set()


def test_a_file_that_is_no_toml_is_said_to_be_none_at_once(tmp_path):
    (tmp_path / "rig.toml").write_text("bore = 32 mm")
    assert loaded_after(f"from ltvpneu.face.cli import main\nmain(['study', {str(tmp_path / 'rig.toml')!r}])") == set()


def test_the_package_loads_what_is_asked_for():
    assert loaded_after("import ltvpneu") == set()
    assert loaded_after("import ltvpneu as lp\nlp.Cylinder, lp.nonlinear_orbit, lp.ltv_model").isdisjoint(
        {"control", "matplotlib", "cvxpy"}
    )


def test_every_public_name_is_there():
    assert set(lp.__all__) <= set(dir(lp))
    for name in lp.__all__:
        assert getattr(lp, name).__name__ == name
    assert pickle.loads(pickle.dumps(lp.Gas)) is lp.Gas
    with pytest.raises(AttributeError, match="nosuch"):
        lp.nosuch  # noqa: B018
