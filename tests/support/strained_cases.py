"""Cases that end in every way that a cell can end in, importable by another process."""

import math
import os
import time
from functools import partial

import torch
from torch import Tensor, nn

from ablations.stability.case import EXACT, Case, Problem
from gaussian_enhancer.errors import InputError

HEAVY = 3.0


def case(kind: str, seconds: float = 900.0, **options) -> Case:
    build = partial(problem, kind)
    return Case("strained", kind, kind, build, EXACT, passes=options.get("passes", ("forward",)), seconds=seconds)


def problem(kind: str) -> Problem:
    torch.manual_seed(0)
    x = torch.linspace(1, 2, 5, dtype=torch.float64)
    return Problem(partial(_compute, kind), {"x": x}, nn.Linear(5, 2).double())


def _compute(kind: str, module: nn.Module | None, inputs: dict[str, Tensor]) -> Tensor:
    x = inputs["x"]
    reference = x.dtype == torch.float64
    if kind == "hangs" and not reference:
        time.sleep(3600)
    if kind == "dies" and not reference:
        os._exit(7)
    if kind == "refuses":
        raise InputError("x", "is strained", "rest")
    if kind == "breaks":
        raise RuntimeError("no such kernel")
    if kind == "nan" and not reference:
        return x * math.nan
    if kind == "wrong" and not reference:
        return x * 1.01
    if kind == "wrong gradient" and not reference:
        return x.detach() + 2 * (x - x.detach())
    if kind == "endless gradient":
        return torch.where(x > 0, x, (x - x).sqrt())
    if kind == "single":
        return x if reference else x.float()
    return module(x) if kind == "linear" and module is not None else x
