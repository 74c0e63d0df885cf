"""What a search for a pattern prints: nothing."""

import subprocess
import sys


def test_the_solver_prints_nothing_and_output_goes_on_after_it():
    code = (
        "import ltvpneu as lp\n"
        "from ltvpneu import design\n"
        "print('before')\n"
        "found = design.optimize_pattern(\n"
        "    lp.load_machine('kunt_singh_1990'), 15.0, 13, mean={'position': (0.03, 0.06)}, refit=False)\n"
        "print(found.settled, found.n_rounds)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=300)
    assert done.stdout == "before\nFalse 1\n"
