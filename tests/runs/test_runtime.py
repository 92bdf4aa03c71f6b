"""Settings of a job's process."""

import os
import subprocess
import sys

import pytest
from omegaconf import OmegaConf

from gaussian_enhancer.runs import runtime

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


CACHED = """
import numba, numpy as np
from omegaconf import OmegaConf
from gaussian_enhancer.runs.runtime import start

start(OmegaConf.create({"threads": 1, "device": "cpu", "keep_memory": False}))
numba.get_num_threads()  # launches them, as a kernel from the cache does, which needs no compilation

@numba.njit(parallel=True)
def double(values):
    for i in numba.prange(len(values)):
        values[i] *= 2

values = np.ones(8)
double(values)
print(values.sum(), numba.get_num_threads())
"""


def test_kernels_can_be_compiled_after_a_kernel_from_the_cache_has_run() -> None:
    environment = {name: value for name, value in os.environ.items() if name != "NUMBA_NUM_THREADS"}
    process = subprocess.run([sys.executable, "-c", CACHED], env=environment, capture_output=True, text=True)
    assert process.stdout.split() == ["16.0", "1"], process.stderr


def test_a_job_starts_where_the_system_restricts_no_process_to_some_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    """As on macOS and Windows."""
    threads: list[int] = []
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    monkeypatch.setattr(os, "cpu_count", lambda: 6)
    monkeypatch.setattr(runtime.torch, "set_num_threads", threads.append)
    monkeypatch.setattr(runtime, "set_kernel_threads", threads.append)
    runtime.start(OmegaConf.create({"threads": None, "device": "cpu", "keep_memory": False}))
    assert threads == [6, 6]
