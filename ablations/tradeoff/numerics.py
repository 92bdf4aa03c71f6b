"""Measures error and run time of each kernel: every dtype and implementation against float64, timed in turn."""

import math
import time
from collections.abc import Iterator, Sequence

import torch
from rich.console import Console
from torch import Tensor

from ablations.study.cost import device_description, quartiles
from ablations.study.missing import missing_record, reason_of
from ablations.tradeoff.kernels import Case, Cases, deformable, latent, networks, reprojection, resampling
from ablations.tradeoff.rasterisers import rasterisers
from gaussian_enhancer.errors import InputError, refuse_unknown
from gaussian_enhancer.metrics.cost import time_interleaved
from gaussian_enhancer.metrics.records import Record

KIND = "numerics"


def all_cases(device: torch.device) -> Cases:
    """Every case; inputs are made lazily."""
    kernels = (rasterisers, deformable, reprojection, resampling, latent, networks)
    return (case for kernel in kernels for case in kernel(device))


def numeric_records(
    repeats: int, names: Sequence[str] | None, device: torch.device, console: Console, seconds: float = math.inf
) -> Iterator[Record]:
    """One record per variant: relative error, largest error, time with quartiles; the reason if a variant fails.

    Args:
        repeats: largest number of repeats of each time.
        names: of the cases; None for all.
        device: where to compute.
        console: prints progress.
        seconds: time limit of the repeats of a case; the last round may exceed it.

    Raises:
        InputError: a name is unknown.
    """
    case_names = []
    for case in all_cases(device):
        name, _, _ = case
        case_names.append(name)
        if names is None or name in names:
            console.print(name, highlight=False)
            yield from case_records(case, repeats, device, seconds)
    refuse_unknown("numerics.cases", names, case_names)


def case_records(case: Case, repeats: int, device: torch.device, seconds: float = math.inf) -> Iterator[Record]:
    """The records of one case; arguments as in `numeric_records`."""
    name, compute_reference, variants = case
    reference, seconds_per_round = compute_reference().double(), 0.0
    errors: dict[str, tuple[float, float]] = {}
    for variant, call in variants.items():
        try:
            started = time.perf_counter()
            result = call().double()
            seconds_per_round += time.perf_counter() - started
            errors[variant] = errors_of(result, reference)
        except (RuntimeError, NotImplementedError, InputError) as error:
            reason = reason_of(error).splitlines()[0]
            yield missing_record(variant, reason, scene=name)
    calls = {variant: variants[variant] for variant in errors}
    repeats = repeats if seconds_per_round * repeats <= seconds else max(1, int(seconds / seconds_per_round))
    times = time_interleaved(calls, repeats, 0, device)  # no warm-up: each was called once above
    protocol = f"{device_description(device)}: median and quartiles of {repeats} interleaved repeats; relative error: "
    protocol += "root mean square of the difference from float64 over that of float64's result"
    for variant, (relative, largest) in errors.items():
        low, high = quartiles(times[variant])
        metrics: dict[str, float | None] = {"relative_error": relative, "largest_error": largest}
        metrics |= {"milliseconds": times[variant].milliseconds, "lower_quartile": low, "upper_quartile": high}
        yield Record(KIND, "", name, "", "", variant, metrics, protocol=protocol)


def errors_of(result: Tensor, reference: Tensor) -> tuple[float, float]:
    """Relative root mean square error and largest absolute error; infinite if a value is not finite.

    Args:
        result: the result.
        reference: the reference, of the same shape, not all zero.
    """
    difference = (result - reference).nan_to_num(nan=torch.inf, posinf=torch.inf, neginf=torch.inf).abs()
    relative = (difference.square().mean() / reference.square().mean()).sqrt()
    return float(relative), float(difference.max())
