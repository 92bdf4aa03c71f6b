"""Computes one cell of the matrix: a case in one precision and pass, compared with float64."""

import copy
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import torch
from torch import Tensor, nn

from ablations.stability.case import Case, Precision, Problem, UnstableError
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.metrics.records import Record

WITHIN, REFUSED, FAILED = "within tolerance", "refused", "FAILED"
"""Outcomes of a cell."""

ROUNDING = 1e-12
"""A gradient below this share of the largest one counts as zero up to float64's rounding errors."""

KIND = "stability"
"""Kind of the matrix's records."""

PROTOCOL = (
    "float64 on the same rounded numbers; forward: largest difference over the unit; backward: norm of the difference "
    "over the norm, worst input"
)


@dataclass(frozen=True)
class CaseOutcome:
    """The outcome of a case in one precision and pass.

    Args:
        outcome: one of `WITHIN`, `REFUSED`, `FAILED`.
        reason: why it was refused or has failed.
        error: against float64; None if there is no result.
        tolerance: largest allowed error.
        computed: dtype of the result if it differs from the precision's; empty otherwise and under autocast.
        seconds: run time.
    """

    outcome: str
    reason: str = ""
    error: float | None = None
    tolerance: float = math.nan
    computed: str = ""
    seconds: float = 0.0


def judge_case(case: Case, precision: Precision, direction: str) -> CaseOutcome:
    """Compute a case and compare it with float64.

    Args:
        case: the case.
        precision: what to compute in.
        direction: "forward" or "backward".
    """
    allowed = case.tolerance[precision.name][direction == "backward"]
    problem = case.build()
    started = time.perf_counter()
    try:
        results, dtype = _compute(problem, precision, direction)
    except InputError as error:
        return CaseOutcome(REFUSED, str(error), tolerance=allowed, seconds=time.perf_counter() - started)
    except UnstableError as error:
        return CaseOutcome(FAILED, str(error), tolerance=allowed, seconds=time.perf_counter() - started)
    except Exception as error:  # an exception fails this cell and must not end the matrix
        message = f"{type(error).__name__}: {error}".splitlines()[0][:200]
        return CaseOutcome(FAILED, message, tolerance=allowed, seconds=time.perf_counter() - started)
    seconds = time.perf_counter() - started
    expected = _reference_result(case, precision.dtype, direction)
    computed = "" if precision.autocast or dtype == precision.dtype else str(dtype).removeprefix("torch.")
    error_size = difference(results, expected, problem, direction)
    outcome, reason = WITHIN, ""
    if not all(bool(torch.isfinite(value).all()) for value in expected.values()):
        outcome, reason = FAILED, "float64 itself is not finite"
    elif not all(bool(torch.isfinite(value).all()) for value in results.values()):
        non_finite = next(name for name, value in results.items() if not bool(torch.isfinite(value).all()))
        outcome, reason = FAILED, f"{non_finite} is not finite"
    elif not error_size <= allowed:
        outcome, reason = FAILED, f"is off by {error_size:.2g}, more than {allowed:g}"
    return CaseOutcome(outcome, reason, error_size, allowed, computed, seconds)


def difference(
    results: Mapping[str, Tensor], expected: Mapping[str, Tensor], problem: Problem, direction: str
) -> float:
    """The error of results against the reference, as in `PROTOCOL`.

    Args:
        results: results by name.
        expected: reference by name.
        problem: the computation.
        direction: "forward" or "backward".
    """
    worst = 0.0
    largest = max((float(value.norm()) for value in expected.values()), default=0.0)
    for name, value in results.items():
        residual, reference = (value.double() - expected[name]), expected[name]
        if direction == "backward":
            error, scale = float(residual.norm()), float(reference.norm())
            if scale < ROUNDING * largest:  # only float64's own rounding errors: compare with the largest gradient
                scale = largest
        else:
            last_index = max(0, math.ceil(problem.share * residual.numel()) - 1)
            error = float(residual.abs().flatten().sort().values[last_index]) if residual.numel() else 0.0
            scale = problem.unit if problem.unit is not None else float(reference.abs().max())
        # Where zero is expected, zero is exact, and any other value has an infinite error.
        ratio = 0.0 if error == 0 else error / scale if scale > 0 else math.inf
        worst = max(worst, ratio) if math.isfinite(ratio) else math.inf
    return worst


def record_of(case: Case, precision: Precision, direction: str, cell: CaseOutcome) -> Record:
    """A cell as a record: family as run, case as scene, precision as splat, pass as view, outcome as variant."""
    metrics: dict[str, float | None] = {"error": cell.error, "tolerance": cell.tolerance, "seconds": cell.seconds}
    reasons = {"outcome": cell.reason} if cell.reason else {}
    if cell.error is None:
        reasons["error"] = cell.reason
    if cell.computed:
        reasons["computed"] = cell.computed
    return Record(
        KIND, case.family, case.name, precision.name, direction, cell.outcome, metrics, reasons, protocol=PROTOCOL
    )


@lru_cache(maxsize=4)
def _reference_result(case: Case, dtype: torch.dtype, direction: str) -> dict[str, Tensor]:
    """The float64 reference of a case whose inputs were rounded to a dtype; the same with and without autocast."""
    return _compute(case.build(), Precision("float64", dtype), direction, reference=True)[0]


def _compute(
    problem: Problem, precision: Precision, direction: str, reference: bool = False
) -> tuple[dict[str, Tensor], torch.dtype]:
    """The result or the gradients, by name, and the dtype of the result."""
    inputs = {name: value.to(precision.dtype).clone() for name, value in problem.inputs.items()}
    module = None if problem.module is None else copy.deepcopy(problem.module).to(precision.dtype)
    if reference:
        inputs = {name: value.double() for name, value in inputs.items()}
        module = None if module is None else module.double()
    differentiable = {name: value for name, value in inputs.items() if name not in problem.fixed}
    for value in differentiable.values():
        value.requires_grad_(direction == "backward")
    autocast_dtype = precision.autocast if not reference else None
    with (
        torch.set_grad_enabled(direction == "backward"),
        torch.autocast("cpu", autocast_dtype, enabled=autocast_dtype is not None),
    ):
        result = problem.call(module, inputs)
    if direction == "forward":
        return {"result": result.double()}, result.dtype
    return _gradients(result, differentiable, module), result.dtype


def _gradients(result: Tensor, learnt: Mapping[str, Tensor], module: nn.Module | None) -> dict[str, Tensor]:
    """Gradients of the result's sum under fixed random weights: of each input, and of all parameters as one vector.

    A sum is a scaled mean, like the scaled loss of training in float16, where the gradients of a mean would underflow.
    """
    weights = torch.rand(result.shape, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    loss = (result.double() * weights).sum()
    parameters = [] if module is None else [value for value in module.parameters() if value.requires_grad]
    if loss.requires_grad:
        loss.backward()
    gradients = {name: _gradient(value) for name, value in learnt.items()}
    if parameters:
        gradients["weights"] = torch.cat([_gradient(value).flatten() for value in parameters])
    return {f"gradient of {name}": value for name, value in gradients.items()}


def _gradient(value: Tensor) -> Tensor:
    return torch.zeros_like(value, dtype=torch.float64) if value.grad is None else value.grad.double()
