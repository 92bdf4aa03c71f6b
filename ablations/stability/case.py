"""What a case of the stability matrix is: a computation, its inputs, and how far each precision may be off.

A case is judged against float64 on the very numbers that it was given: inputs and weights are rounded to the precision
first, so that what is measured is the computation and not what the precision cannot hold.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import torch
from torch import Tensor, nn


@dataclass(frozen=True)
class Precision:
    """A column of the matrix.

    Args:
        name: as pages show it.
        dtype: of inputs and weights.
        autocast: what convolutions and products compute in under autocast; None without.
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

NETWORK: Tolerance = {
    "float32": (1e-4, 1e-3),
    "bfloat16": (0.1, 0.5),
    "float16": (0.02, 0.1),
    "autocast bfloat16": (0.05, 0.5),
    "autocast float16": (0.01, 0.1),
}
"""Some tens of roundings of 2^-8 (bfloat16) or 2^-11 (float16), which a network's layers add up."""
NETWORK_WHY = "the layers' roundings add up; gradients also where an activation near zero falls to the other side"

EXACT: Tolerance = {p.name: (1e-4, 1e-3 if p.dtype == torch.float32 else 0.01) for p in PRECISIONS}
"""What is computed in single precision whatever it is given; a gradient by half precision is rounded to it."""


@dataclass(frozen=True)
class Problem:
    """A computation with its inputs.

    Args:
        call: maps module and inputs to the result, whose sum under fixed random weights the backward pass derives;
            raises `UnstableError` where the result breaks a promise that a number's size does not show.
        inputs: by name, in double precision.
        module: learnt weights, in double precision; None where there are none.
        fixed: inputs whose gradient is not asked for.
        unit: the size of a result that counts as 1; None means the largest of the reference.
        share: of the result's numbers that have to be within tolerance, the best ones; below 1 where a threshold
            decides over single pixels.
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
        name: unique.
        about: what is extreme about it.
        build: makes the computation; called once for each precision and pass.
        tolerance: largest errors by precision.
        why: the reason for these tolerances.
        passes: of these two, the ones that there are.
        seconds: after so long a cell has failed.
    """

    family: str
    name: str
    about: str
    build: Callable[[], Problem]
    tolerance: Tolerance = field(default_factory=lambda: NETWORK, hash=False)
    why: str = NETWORK_WHY
    passes: tuple[str, ...] = PASSES
    seconds: float = 60.0


class UnstableError(Exception):
    """A promise about a computation does not hold."""
