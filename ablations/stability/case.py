"""Defines the cases of the stability matrix: a computation, its inputs, and the tolerance of each precision.

A case is compared with float64 on the same numbers: inputs and weights are rounded to the precision first, so that the
error is that of the computation and not that of rounding the inputs.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import torch
from torch import Tensor, nn


@dataclass(frozen=True)
class Precision:
    """A column of the matrix.

    Args:
        name: name on pages.
        dtype: of inputs and weights.
        autocast: dtype of convolutions and matrix products under autocast; None without autocast.
    """

    name: str
    dtype: torch.dtype
    autocast: torch.dtype | None = None


PRECISIONS = (
    Precision("float32", torch.float32),
    Precision("bfloat16", torch.bfloat16),
    Precision("float16", torch.float16),
    Precision("autocast bfloat16", torch.float32, torch.bfloat16),
    Precision("autocast float16", torch.float32, torch.float16),
)

PASSES = ("forward", "backward")

Tolerance = Mapping[str, tuple[float, float]]
"""Largest error of the result and of the gradient, by precision."""

NETWORK_TOLERANCE: Tolerance = {
    "float32": (1e-4, 1e-3),
    "bfloat16": (0.1, 0.5),
    "float16": (0.02, 0.1),
    "autocast bfloat16": (0.05, 0.5),
    "autocast float16": (0.01, 0.1),
}
"""Some tens of rounding errors of 2^-8 (bfloat16) or 2^-11 (float16), accumulated over a network's layers."""
NETWORK_WHY = "the layers' roundings add up; gradients also where an activation near zero falls to the other side"

EXACT: Tolerance = {p.name: (1e-4, 1e-3 if p.dtype == torch.float32 else 0.01) for p in PRECISIONS}
"""For code that computes in single precision whatever its inputs; gradients of half-precision inputs are rounded."""


@dataclass(frozen=True)
class Problem:
    """A computation with its inputs.

    Args:
        call: maps module and inputs to the result. The backward pass differentiates the result's sum under fixed random
            weights. Raises `UnstableError` if the result violates a property that the error does not measure.
        inputs: by name, in double precision.
        module: module with learnt weights, in double precision; None if there is none.
        fixed: inputs without gradient.
        unit: scale that forward errors are divided by; None for the largest absolute value of the reference.
        share: share of the result's values, the most accurate ones, that must be within tolerance; below 1 if single
            pixels depend on a threshold.
    """

    call: Callable[[nn.Module | None, dict[str, Tensor]], Tensor]
    inputs: Mapping[str, Tensor]
    module: nn.Module | None = None
    fixed: tuple[str, ...] = ()
    unit: float | None = 1.0
    share: float = 1.0


@dataclass(frozen=True)
class Case:
    """A row of the matrix.

    Args:
        family: the part of the catalogue that it belongs to.
        name: unique name.
        about: what is extreme about it.
        build: makes the computation; called once for each precision and pass.
        tolerance: largest errors by precision.
        why: the reason for these tolerances.
        passes: passes that are computed, of `PASSES`.
        seconds: timeout of a cell, after which it has failed.
    """

    family: str
    name: str
    about: str
    build: Callable[[], Problem]
    tolerance: Tolerance = field(default_factory=lambda: NETWORK_TOLERANCE, hash=False)
    why: str = NETWORK_WHY
    passes: tuple[str, ...] = PASSES
    seconds: float = 60.0


class UnstableError(Exception):
    """A required property of a computation does not hold."""
