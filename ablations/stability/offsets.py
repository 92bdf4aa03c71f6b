"""Deformable sampling far outside the image."""

from functools import partial

import torch
from torch import Tensor, nn

from ablations.stability.case import Case, Problem
from gaussian_enhancer.network.deform import deformable_sample

OFFSETS = {"none": 0.0, "plus_1e4": 1e4, "minus_1e4": -1e4}
"""Pixels by name; what is not finite cannot arise, since networks bound offsets (`enhance.deform.Deformation`)."""


def cases() -> list[Case]:
    """The family."""
    about = "offsets of {:g} pixels"
    return [Case("offsets", name, about.format(value), partial(moved, value)) for name, value in OFFSETS.items()]


def moved(value: float) -> Problem:
    """Features read where half of the offsets are a value and half within a pixel."""
    draw = torch.Generator().manual_seed(8)
    offset = torch.rand(1, 2 * 9, 10, 12, generator=draw, dtype=torch.float64)
    offset[:, ::2] = offset[:, ::2] if value == 0 else value
    inputs = {
        "features": torch.randn(1, 4, 10, 12, generator=draw, dtype=torch.float64),
        "offset": offset,
        "mask": torch.rand(1, 9, 10, 12, generator=draw, dtype=torch.float64),
        "kernel": torch.randn(5, 4, 3, 3, generator=draw, dtype=torch.float64),
    }
    # The derivative by an offset jumps wherever a position crosses a pixel's centre.
    return Problem(_moved, inputs, fixed=("offset",), unit=None)


def _moved(module: nn.Module | None, inputs: dict[str, Tensor]) -> Tensor:
    return deformable_sample(inputs["features"], inputs["offset"], inputs["mask"], inputs["kernel"])
