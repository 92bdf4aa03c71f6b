"""Settings of a job's process."""

import os
import subprocess
import sys

PROGRAM = """
import numba, numpy as np
from omegaconf import OmegaConf
from gaussian_enhancer.runs.runtime import start

def sums(values):
    total = 0.0
    for i in numba.prange(len(values)):
        total += values[i]
    return total

before = numba.njit(parallel=True)(sums)(np.ones(8))
start(OmegaConf.create({"threads": 1, "device": "cpu", "keep_memory": False}))
after = numba.njit(parallel=True)(sums)(np.ones(8, np.float32))
print(before, after, numba.get_num_threads())
"""


def test_threads_can_be_set_after_compiled_kernels_have_run() -> None:
    """As in a notebook that renders before it starts a job: Numba refuses another NUMBA_NUM_THREADS by then."""
    environment = {name: value for name, value in os.environ.items() if name != "NUMBA_NUM_THREADS"}
    process = subprocess.run([sys.executable, "-c", PROGRAM], env=environment, capture_output=True, text=True)
    assert process.stdout.split() == ["8.0", "8.0", "1"], process.stderr
