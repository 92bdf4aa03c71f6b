import os
import subprocess
import sys

import psutil
import pytest
import torch

from gaussian_enhancer import memory

glibc = pytest.mark.skipif(memory._glibc() is None, reason="the C library is not glibc")

COUNT = """
import resource
import torch
from gaussian_enhancer import memory
if {keep}:
    assert memory.keep_freed()
for _ in range(15):
    torch.ones(12_000_000)
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(20):
    torch.ones(12_000_000)
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


def faults(keep: bool) -> int:
    """Pages that a process takes from the system while it makes twenty images of 48 MB one after the other."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("MALLOC_", "GLIBC_"))}
    ended = subprocess.run(
        [sys.executable, "-c", COUNT.format(keep=keep)], env=environment, capture_output=True, text=True, check=True
    )
    return int(ended.stdout)


@glibc
def test_kept_memory_is_not_taken_from_the_system_again():
    assert faults(keep=True) < 1000 < faults(keep=False)


@glibc
def test_what_is_given_back_is_not_resident():
    memory.keep_freed()
    images = [torch.ones(4_000_000) for _ in range(8)]
    held = psutil.Process().memory_info().rss
    del images
    memory.give_back()
    assert held - psutil.Process().memory_info().rss > 8 * 14e6


def test_other_libraries_are_left_alone(monkeypatch):
    monkeypatch.setattr(memory, "_glibc", lambda: None)
    assert not memory.keep_freed()
    memory.give_back()
