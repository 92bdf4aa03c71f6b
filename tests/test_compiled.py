"""What a process says about the compilation of kernels."""

import os
import subprocess
import sys

import pytest
from numba.core import caching

from gaussian_enhancer.compiled import exact_inner, exact_kernel, inner, kernel
from gaussian_enhancer.errors import InputError

PROGRAM = """
import numpy as np
from gaussian_enhancer.scene.image_kernels import quantise

quantise(np.zeros((3, 4, 4), np.float32), np.zeros((4, 4, 3), np.uint8))
"""


def test_compilation_is_announced_once_and_kernels_from_the_cache_are_silent(tmp_path) -> None:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}

    def printed() -> list[str]:
        process = subprocess.run([sys.executable, "-c", PROGRAM], env=environment, capture_output=True, text=True)
        assert process.returncode == 0, process.stderr
        return process.stderr.splitlines()

    assert printed() == ["compiling kernels for this processor, which takes minutes once after installation"]
    assert printed() == []


@pytest.mark.parametrize("decorate", [kernel, inner, exact_kernel, exact_inner])
def test_a_machine_where_no_folder_can_be_written_is_told_what_to_do(monkeypatch, decorate) -> None:
    """As for a user without a home, of a package that another user installed."""
    monkeypatch.setattr(caching.CacheImpl, "_locator_classes", [])
    with pytest.raises(InputError, match="compiled kernels: have no folder to be kept in; set NUMBA_CACHE_DIR"):
        decorate(lambda values: None)
