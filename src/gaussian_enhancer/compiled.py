"""Compilation settings of the CPU kernels, and the inner loops that several of them share.

Kernels are Numba functions on C-contiguous NumPy arrays. ``cache=True`` writes the machine code beside the source,
or into the user's cache folder where the package is installed read-only (``NUMBA_CACHE_DIR`` names another place). A
process that finds a kernel in no cache says once that it compiles, since this takes seconds a kernel.
``fastmath`` leaves out ``nnan`` and ``ninf``, so that a comparison with NaN keeps its meaning.

Numba sets the number of threads (``NUMBA_NUM_THREADS``, `numba.set_num_threads`). Its OpenMP threading layer does not
survive a fork: a process that has run a kernel must use the spawn method to start processes that run kernels.
"""

import inspect
import sys
import threading
from collections.abc import Callable
from typing import Any, no_type_check

import numpy as np
from numba import njit
from numba.core.event import Event, Listener, register

from gaussian_enhancer.errors import InputError

_OPTIONS: dict[str, Any] = {
    "fastmath": {"contract", "reassoc", "nsz", "arcp", "afn"},
    "error_model": "numpy",  # the check for division by zero would add an exit to the loop
    "cache": True,
    "nogil": True,
}


class _CompilationNotice(Listener):
    """Prints one line when a process compiles its first kernel; kernels from the cache cause no event."""

    printed = False

    def on_start(self, event: Event) -> None:
        if not self.printed:
            self.printed = True
            print("compiling kernels for this processor, which takes minutes once after installation", file=sys.stderr)

    def on_end(self, event: Event) -> None:
        pass


register("numba:compile", _CompilationNotice())

kernel_lock = threading.RLock()
"""Held during every parallel kernel: Numba's fallback threading layer (workqueue) must not be entered concurrently."""


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function that loops in parallel with ``prange``."""
    return _compile(function, parallel=True, **_OPTIONS)


def inner(function: Callable[..., Any]) -> Any:
    """Compile a function that kernels call."""
    return _compile(function, **_OPTIONS)


def exact_kernel(function: Callable[..., Any]) -> Any:
    """Compile a parallel function without ``fastmath``.

    Under ``fastmath``, freshly compiled code and code from the cache order and contract sums differently. Where a
    comparison depends on the result, a difference in the last bit can change its outcome.
    """
    return _compile(function, parallel=True, **(_OPTIONS | {"fastmath": False}))


def exact_inner(function: Callable[..., Any]) -> Any:
    """Compile a function that exact kernels call, without ``fastmath``."""
    return _compile(function, **(_OPTIONS | {"fastmath": False}))


def _compile(function: Callable[..., Any], **options: Any) -> Any:
    """Compile a function.

    Raises:
        InputError: neither the package's folder nor the user's cache folder can be written.
    """
    try:
        # The shape checks of the tests wrap functions, and Numba cannot cache a wrapped function.
        return njit(**options)(inspect.unwrap(function))
    except RuntimeError as error:
        if "no locator available" not in str(error):
            raise
        remedy = "set NUMBA_CACHE_DIR to a writable folder"
        raise InputError("compiled kernels", "have no folder to be kept in", remedy) from error


_F = np.float32
_LOWEST = _F(-126.0)
_HALF = _F(0.5)
_BIAS, _MANTISSA = np.int32(127), np.int32(23)
_C0, _C1, _C2 = _F(1.00000007), _F(0.69314697), _F(0.2402212)
_C3, _C4, _C5 = _F(0.05550713), _F(0.00967554), _F(0.00132765)


@inner
def exp2_nonpositive(t: np.float32) -> np.float32:
    """2^t for t <= 0 without a branch or a call: 2^round(t) from its bits, times a polynomial of the remainder.

    The polynomial of degree 5 minimises the largest relative error on [-1/2, 1/2], which is below 2e-7.
    Below 2^-126, and for NaN, the result is 2^-126.
    """
    t = max(t, _LOWEST)
    exponent = np.int32(t - _HALF)
    fraction = t - _F(exponent)
    power = np.int32((exponent + _BIAS) << _MANTISSA).view(np.float32)
    return power * (_C0 + fraction * (_C1 + fraction * (_C2 + fraction * (_C3 + fraction * (_C4 + fraction * _C5)))))


@inner
@no_type_check
def add_scaled(total, values, factor):
    """Add scaled values to a total."""
    for x in range(len(total)):
        total[x] += factor * values[x]
