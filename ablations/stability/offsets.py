"""Cases of deformable sampling with offsets far outside the image."""

from collections.abc import Iterator
from functools import partial

import torch
from torch import Tensor, nn

from ablations.stability.case import Case, Problem
from gaussian_enhancer.network.deform import deformable_sample

OFFSETS = {"none": 0.0, "plus_1e4": 1e4, "minus_1e4": -1e4}
"""Offsets in pixels by name. Networks bound them (`network.deform.Deformation`), so non-finite ones cannot occur."""


def cases() -> Iterator[Case]:
    """The cases of this family."""
    for name, value in OFFSETS.items():
        yield Case("offsets", name, f"offsets of {value:g} pixels", partial(offset_problem, value))


def offset_problem(value: float) -> Problem:
    """Deformable sampling where half of the offsets have a given value and half lie within a pixel."""
    generator = torch.Generator().manual_seed(8)
    offset = torch.rand(1, 2 * 9, 10, 12, generator=generator, dtype=torch.float64)
    offset[:, ::2] = offset[:, ::2] if value == 0 else value
    inputs = {
        "features": torch.randn(1, 4, 10, 12, generator=generator, dtype=torch.float64),
        "offset": offset,
        "mask": torch.rand(1, 9, 10, 12, generator=generator, dtype=torch.float64),
        "kernel": torch.randn(5, 4, 3, 3, generator=generator, dtype=torch.float64),
    }
    # The derivative by an offset is discontinuous where a position crosses a pixel's centre.
    return Problem(_moved, inputs, fixed=("offset",), unit=None)


def _moved(module: nn.Module | None, inputs: dict[str, Tensor]) -> Tensor:
    return deformable_sample(inputs["features"], inputs["offset"], inputs["mask"], inputs["kernel"])
