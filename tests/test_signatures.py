"""Each kernel is compiled once for each type of machine that reaches it, whatever else it is called with."""

import json
import os
import subprocess
import sys

RUN = """
import json, sys
from numba.core import types
from ltvpneu._compiled import kernels
from ltvpneu.face.warm import WORK, work

def plainly(kind):
    # Records of machines, runs and plans come in two kinds, or four: the paper's and any, adaptive and fixed.
    if isinstance(kind, types.Record) or isinstance(kind, types.Array) and isinstance(kind.dtype, types.Record):
        return "record"
    return [plainly(part) for part in kind] if isinstance(kind, types.BaseTuple) else str(kind)

for number in range(2):
    for name in sys.argv[1:] or WORK:
        if number == 0 or not sys.argv[1:]:
            work(name, number)
found = {}
for kernel in kernels:
    name = f"{kernel.py_func.__module__}.{kernel.py_func.__name__}"
    found[name] = sorted({json.dumps([plainly(kind) for kind in signature]) for signature in kernel.signatures})
print(json.dumps({"several": {k: v for k, v in found.items() if len(v) > 1},
                  "most": max(len(kernel.signatures) for kernel in kernels), "used": sum(map(bool, found.values()))}))
"""


def signatures(*names: str, **environment: str) -> dict:
    """Return what a process of its own compiles or loads for some kinds of work, by default all."""
    done = subprocess.run(
        [sys.executable, "-c", RUN, *names], capture_output=True, text=True, env={**os.environ, **environment}
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def test_no_kernel_is_compiled_again_for_a_literal_a_read_only_or_a_strided_array(tmp_path):
    # From an empty store, so that what kernels call is seen too.
    found = signatures("orbits", "linear models", NUMBA_CACHE_DIR=str(tmp_path))
    assert found["several"] == {}
    assert found["most"] == 1
    assert found["used"] > 80


def test_all_that_the_public_names_call_has_one_signature_for_each_type_of_record():
    found = signatures()
    assert found["several"] == {}
    # Two types of machine, two of methods.
    assert found["most"] <= 4
