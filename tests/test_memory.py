import os
import subprocess
import sys

import pytest

from gaussian_enhancer import memory

mallinfo2 = pytest.mark.skipif(
    not hasattr(memory._glibc(), "mallinfo2"), reason="the C library is not glibc 2.33 or later"
)

IMAGE = 12_000_000  # values, 48 MB

FREED = """
import ctypes
import psutil
import torch
from gaussian_enhancer import memory

FIELDS = "arena ordblks smblks hblks hblkhd usmblks fsmblks uordblks fordblks keepcost"

class Statistics(ctypes.Structure):
    _fields_ = [(name, ctypes.c_size_t) for name in FIELDS.split()]

library = ctypes.CDLL(None)
library.mallinfo2.restype = Statistics
process = psutil.Process()

if {keep}:
    assert memory.retain_freed_memory()
before = library.mallinfo2().fordblks
image = torch.ones({size})
del image
kept = library.mallinfo2().fordblks - before
resident = process.memory_info().rss
memory.release_freed_memory()
print(kept, resident - process.memory_info().rss)
"""
"""Frees an image; prints the free bytes that the C library has more, and the resident ones that it then gives back."""


def kept_and_returned(keep: bool) -> tuple[int, int]:
    """What a process prints that frees an image with or without keeping its memory."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("MALLOC_", "GLIBC_"))}
    program = FREED.format(keep=keep, size=IMAGE)
    ended = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True)
    kept, returned = map(int, ended.stdout.split())
    return kept, returned


@mallinfo2
def test_freed_memory_is_kept_until_it_is_given_back():
    kept, returned = kept_and_returned(keep=True)
    assert min(kept, returned) > 3 * IMAGE


@mallinfo2
def test_by_default_freed_memory_is_not_kept():
    kept, _ = kept_and_returned(keep=False)
    assert kept < IMAGE


def test_other_libraries_are_left_alone(monkeypatch):
    monkeypatch.setattr(memory, "_glibc", lambda: None)
    assert not memory.retain_freed_memory()
    memory.release_freed_memory()
