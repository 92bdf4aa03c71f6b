"""Compiled kernel of `splat.fit.adam`."""

import math

import numpy as np
from jaxtyping import Float32
from numba import get_num_threads, prange

from gaussian_enhancer.compiled import inner, kernel, kernel_lock
from gaussian_enhancer.splat.fit.adam import BETAS, EPSILON

_F = np.float32
_KEEP, _ADD = _F(BETAS[0]), _F(1 - BETAS[0])
_KEEP_SQUARE, _ADD_SQUARE = _F(BETAS[1]), _F(1 - BETAS[1])
_EPSILON = _F(EPSILON)


def update(arrays: tuple[Float32[np.ndarray, " n"], ...], rates: Float32[np.ndarray, " c"], root: float) -> None:
    """Apply one step of Adam to values and moments in place.

    Args:
        arrays: the parameter, its gradient, the running means of the gradient and of its square.
        rates: learning rates of c consecutive values, divided by the mean's bias correction 1 - beta_1^t; they are
            repeated for every further c values.
        root: reciprocal of the square root of the squares' bias correction 1 - beta_2^t.
    """
    with kernel_lock:
        _update(*arrays, rates, _F(root), get_num_threads())


@kernel
def _update(values, gradient, mean, square, rates, root, threads):  # type: ignore[no-untyped-def]
    n, size = len(values), len(rates)
    runs = -(-n // size)
    for thread in prange(threads):
        for run in range(thread * runs // threads, (thread + 1) * runs // threads):
            begin, end = run * size, min((run + 1) * size, n)
            _update_run(values[begin:end], gradient[begin:end], mean[begin:end], square[begin:end], rates, root)


@inner
def _update_run(values, gradient, mean, square, rates, root):  # type: ignore[no-untyped-def]
    for i in range(len(values)):
        new_mean = _KEEP * mean[i] + _ADD * gradient[i]
        new_square = _KEEP_SQUARE * square[i] + _ADD_SQUARE * gradient[i] * gradient[i]
        mean[i] = new_mean
        square[i] = new_square
        values[i] -= rates[i] * new_mean / (math.sqrt(new_square) * root + _EPSILON)
