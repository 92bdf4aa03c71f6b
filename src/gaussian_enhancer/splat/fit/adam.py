"""One step of Adam, compiled on the CPU; the first column may have a learning rate of its own.

The colour's coefficients are one tensor, as the renderer takes them, but the constant coefficient has a higher learning
rate than the others. PyTorch's Adam has one learning rate per tensor.
Source: Kingma and Ba, Adam, ICLR 2015, algorithm 1.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

BETAS = (0.9, 0.999)
EPSILON = 1e-15
BLOCK_SIZE = 1024
"""Number of values in a block of the update where all values have the same rate."""


@dataclass
class Moments:
    """Adam's state of a parameter: running means of its gradient and of the gradient's square."""

    exp_avg: Float[Tensor, "n ..."]
    exp_avg_sq: Float[Tensor, "n ..."]


def adam_step(
    values: Float[Tensor, "n ..."],
    gradient: Float[Tensor, "n ..."],
    moments: Moments,
    number: int,
    rate: float,
    first_rate: float | None = None,
) -> None:
    """Apply one step of Adam to values and moments in place.

    Args:
        values: the parameter.
        gradient: gradient of the loss with respect to the parameter.
        moments: Adam's state of the parameter.
        number: number of steps so far, including this one.
        rate: learning rate.
        first_rate: learning rate of the first entries of the second axis, ``values[:, 0]``; ``rate`` where None.
    """
    mean_correction = 1.0 / (1 - BETAS[0] ** number)
    root_correction = math.sqrt(1 - BETAS[1] ** number)
    first_rate = rate if first_rate is None else first_rate
    tensors = (values, gradient.contiguous(), moments.exp_avg, moments.exp_avg_sq)
    if values.device.type == "cpu" and values.dtype == torch.float32:
        from gaussian_enhancer.splat.fit.adam_kernels import update

        if first_rate != rate and len(values):
            rates = np.full(values[0].numel(), rate * mean_correction, np.float32)
            rates[: values[0, 0].numel()] = first_rate * mean_correction
        else:
            rates = np.full(BLOCK_SIZE, rate * mean_correction, np.float32)
        update(tuple(tensor.detach().reshape(-1).numpy() for tensor in tensors), rates, 1.0 / root_correction)
        return
    with torch.no_grad():
        moments.exp_avg.lerp_(gradient, 1 - BETAS[0])
        moments.exp_avg_sq.lerp_(gradient.square(), 1 - BETAS[1])
        change = moments.exp_avg / (moments.exp_avg_sq.sqrt() / root_correction + EPSILON)
        values.sub_(change, alpha=rate * mean_correction)
        if first_rate != rate:
            values[:, 0].sub_(change[:, 0], alpha=(first_rate - rate) * mean_correction)
