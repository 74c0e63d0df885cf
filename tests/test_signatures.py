"""Each kernel is compiled once for each type of machine that reaches it, whatever else it is called with."""

import json
import os
import subprocess
import sys

RUN = """
import json
from numba.core import types
from ltvpneu._compiled import kernels
from ltvpneu.face.warm import WORK, work

def plainly(kind):
    # Records of machines, runs and plans come in two kinds, or four: the paper's and any, adaptive and fixed.
    if isinstance(kind, types.Record) or isinstance(kind, types.Array) and isinstance(kind.dtype, types.Record):
        return "record"
    return [plainly(part) for part in kind] if isinstance(kind, types.BaseTuple) else str(kind)

for number in range(2):
    for name in WORK:
        work(name, number)
found = {}
for kernel in kernels:
    name = f"{kernel.py_func.__module__}.{kernel.py_func.__name__}"
    found[name] = sorted({json.dumps([plainly(kind) for kind in signature]) for signature in kernel.signatures})
print(json.dumps({"several": {k: v for k, v in found.items() if len(v) > 1},
                  "most": max(len(kernel.signatures) for kernel in kernels), "used": sum(map(bool, found.values()))}))
"""


def test_no_kernel_is_compiled_again_for_a_literal_a_read_only_or_a_strided_array():
    done = subprocess.run([sys.executable, "-c", RUN], capture_output=True, text=True, env=dict(os.environ))
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert found["several"] == {}
    assert found["most"] <= 4
    assert found["used"] > 100
