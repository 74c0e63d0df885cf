"""Warming compiles what is not on disk yet, and says what it came to."""

import pytest

from ltvpneu.face.cli import main
from ltvpneu.face.warm import warm


def test_what_was_warmed_is_found_the_next_time():
    warm(1, ["periodic systems"])
    again = warm(1, ["periodic systems"])
    assert again.compiled == 0
    assert again.loaded >= len(again.files) > 0
    assert again.folder


@pytest.mark.parametrize("jobs", ["0", "-1"])
def test_less_than_one_process_is_bad_input(jobs, capsys):
    assert main(["warm", "--jobs", jobs]) == 2
    assert f"--jobs: found {jobs}, expected 1 or more" in capsys.readouterr().err
