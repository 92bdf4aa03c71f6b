"""How the CPU kernels are compiled, the thresholds they share, and the exponential that LLVM can vectorise.

Kernels are Numba functions on C-contiguous NumPy arrays. ``cache=True`` writes the machine code beside the source,
or into the user's cache folder where the package is installed read-only (``NUMBA_CACHE_DIR`` names another place).
``fastmath`` leaves out ``nnan`` and ``ninf``, so that a comparison with NaN keeps its meaning.

Threads: Numba's own count (``NUMBA_NUM_THREADS``, `numba.set_num_threads`). Its OpenMP layer does not survive a fork:
a process that has run a kernel must start others that will by spawn.
"""

import inspect
import threading
from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit

ALPHA_MIN = 1.0 / 255.0
"""A Gaussian's share below this is skipped."""
ALPHA_MAX = 0.99
"""Every share is capped here, so that transmittance never reaches zero."""
TRANSMITTANCE_MIN = 1e-4 * (1 - 1e-4)
"""A pixel stops before the Gaussian that would bring its transmittance below this: 1e-4, with room for rounding, as two
capped shares leave (1 - 0.99)^2, which is 1e-4 exactly and must not stop a pixel in float32 alone."""
COVERED = 1e-3
"""Below this accumulated alpha a pixel has no depth."""
TILE = 16
"""Edge of a tile in pixels: one AVX-512 register of float32."""

_OPTIONS: dict[str, Any] = {
    "fastmath": {"contract", "reassoc", "nsz", "arcp", "afn"},
    "error_model": "numpy",  # the check for division by zero would be an exit from the loop
    "cache": True,
    "nogil": True,
}

kernel_lock = threading.RLock()
"""Held around every parallel kernel: Numba's fallback threading layer (workqueue) must not be entered twice at once."""


# Under the shape checks of the tests a function arrives wrapped, which Numba cannot cache: hence `inspect.unwrap`.
def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function that loops in parallel with ``prange``."""
    return njit(parallel=True, **_OPTIONS)(inspect.unwrap(function))


def inner(function: Callable[..., Any]) -> Any:
    """Compile a function that kernels call."""
    return njit(**_OPTIONS)(inspect.unwrap(function))


def exact_kernel(function: Callable[..., Any]) -> Any:
    """Compile a parallel function without ``fastmath``.

    Code that was just compiled and code from the cache order and contract sums differently under ``fastmath``. Where
    the result decides between alternatives, a difference in the last bit can decide otherwise.
    """
    return njit(parallel=True, **(_OPTIONS | {"fastmath": False}))(inspect.unwrap(function))


def exact_inner(function: Callable[..., Any]) -> Any:
    """Compile a function that exact kernels call, without ``fastmath``."""
    return njit(**(_OPTIONS | {"fastmath": False}))(inspect.unwrap(function))


_F = np.float32
_LOWEST = _F(-126.0)
_HALF = _F(0.5)
_BIAS, _MANTISSA = np.int32(127), np.int32(23)
_C0, _C1, _C2 = _F(1.00000007), _F(0.69314697), _F(0.2402212)
_C3, _C4, _C5 = _F(0.05550713), _F(0.00967554), _F(0.00132765)


@inner
def exp2_nonpositive(t: np.float32) -> np.float32:
    """2^t for t <= 0 without a branch or a call: 2^round(t) by its bits, the rest by a polynomial.

    The polynomial is the least-maximum relative error fit of degree 5 on [-1/2, 1/2]; relative error below 2e-7.
    Below 2^-126, and for NaN, the result is 2^-126.
    """
    t = max(t, _LOWEST)
    whole = np.int32(t - _HALF)
    f = t - _F(whole)
    power = np.int32((whole + _BIAS) << _MANTISSA).view(np.float32)
    return power * (_C0 + f * (_C1 + f * (_C2 + f * (_C3 + f * (_C4 + f * _C5)))))
