"""One step of Adam, compiled on the CPU; the first columns may have another learning rate.

The colour's coefficients are one tensor, as the renderer takes them, but the constant one learns faster than the
others; torch's Adam has one rate a tensor. Source: Kingma and Ba, Adam, ICLR 2015, algorithm 1.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

BETAS = (0.9, 0.999)
EPSILON = 1e-15
RUN = 1024
"""Numbers that are updated one after another where all have one rate."""


@dataclass
class Moments:
    """What Adam keeps of a parameter: running means of its gradient and of the gradient's square."""

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
    """Change values and moments in place.

    Args:
        values: the parameter.
        gradient: of the loss.
        moments: of the parameter.
        number: how many steps there were, this one included.
        rate: learning rate.
        first_rate: learning rate of the first entries of the second axis, ``values[:, 0]``; ``rate`` where None.
    """
    size = 1.0 / (1 - BETAS[0] ** number)
    root = math.sqrt(1 - BETAS[1] ** number)
    first_rate = rate if first_rate is None else first_rate
    tensors = (values, gradient.contiguous(), moments.exp_avg, moments.exp_avg_sq)
    if values.device.type == "cpu" and values.dtype == torch.float32:
        from gaussian_enhancer.splat.fit.adam_kernels import update

        rates = np.full(values[0].numel() if first_rate != rate and len(values) else RUN, rate * size, np.float32)
        if first_rate != rate and len(values):
            rates[: values[0, 0].numel()] = first_rate * size
        update(tuple(tensor.detach().reshape(-1).numpy() for tensor in tensors), rates, 1.0 / root)
        return
    with torch.no_grad():
        moments.exp_avg.lerp_(gradient, 1 - BETAS[0])
        moments.exp_avg_sq.lerp_(gradient.square(), 1 - BETAS[1])
        change = moments.exp_avg / (moments.exp_avg_sq.sqrt() / root + EPSILON)
        values.sub_(change, alpha=rate * size)
        if first_rate != rate:
            values[:, 0].sub_(change[:, 0], alpha=(first_rate - rate) * size)
