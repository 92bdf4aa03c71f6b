"""Errors of kernels against float64: by definition, what single precision is known for, what is missing."""

import math
import time

import pytest
import torch
from rich.console import Console

from ablations.report.tradeoff_kernels import kernel_parts
from ablations.tradeoff import kernels
from ablations.tradeoff.kernels import deformable, latent, resampling
from ablations.tradeoff.numerics import case_records, errors_of, numeric_records
from ablations.tradeoff.rasterisers import rasterisers
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.metrics.records import write_records

CPU = torch.device("cpu")


def test_errors_by_definition() -> None:
    true = torch.tensor([3.0, 4.0], dtype=torch.float64)
    assert errors_of(true, true) == (0.0, 0.0)
    assert errors_of(true + torch.tensor([0.0, 0.5]).double(), true) == (pytest.approx(0.1), 0.5)
    assert errors_of(torch.tensor([math.nan, 4.0]).double(), true) == (math.inf, math.inf)


def test_a_case_is_recorded_way_by_way_and_failures_say_why(tmp_path) -> None:
    def failing() -> torch.Tensor:
        raise RuntimeError("not in this dtype\nstack")

    true = torch.full((4,), 2.0, dtype=torch.float64)
    calls = {
        "ours/float32": lambda: true.float() + 1.0,
        "theirs/float16": failing,
        "wild/float16": lambda: true * math.nan,
    }
    records = {r.variant: r for r in case_records(("a kernel", lambda: true, calls), 3, CPU)}
    assert records["ours/float32"].metrics["relative_error"] == 0.5
    assert 0 <= records["ours/float32"].metrics["lower_quartile"] <= records["ours/float32"].metrics["milliseconds"]
    assert records["theirs/float16"].reasons["row"] == "RuntimeError: not in this dtype"
    assert records["wild/float16"].metrics["relative_error"] == math.inf
    write_records(tmp_path / "r.jsonl", records.values())
    text = "\n".join(part for part, _, _ in kernel_parts(tuple(records.values())))
    assert "| a kernel | ours/float32 | 5.0e-01 |" in text
    assert "| a kernel | wild/float16 | not finite |" in text
    assert "- a kernel, `theirs/float16`: RuntimeError: not in this dtype" in text


@pytest.mark.parametrize(("seconds", "calls"), [(math.inf, 6), (0.001, 2), (0.12, 3)])
def test_repeats_fall_where_they_would_take_too_long(seconds, calls) -> None:
    called: list[int] = []

    def slow() -> torch.Tensor:
        called.append(1)
        time.sleep(0.05)
        return torch.ones(1)

    (record,) = case_records(("slow", lambda: torch.ones(1).double(), {"ours/float32": slow}), 5, CPU, seconds)
    assert 2 <= len(called) <= calls
    assert f"{len(called) - 1} interleaved repeats" in record.protocol
    assert record.metrics["relative_error"] == 0


def test_an_unknown_case_is_refused(monkeypatch) -> None:
    monkeypatch.setattr("ablations.tradeoff.numerics.all_cases", lambda device: iter(()))
    with pytest.raises(InputError, match="names 'colours'"):
        list(numeric_records(1, ["colours"], CPU, Console(quiet=True)))


def error_of(cases, name: str, call: str) -> float:
    for found, reference, calls in cases:
        if found == name:
            return errors_of(calls[call]().double(), reference().double())[0]
    raise AssertionError(name)


def test_single_precision_and_implementations_are_as_exact_as_they_should_be() -> None:
    assert 0 < error_of(rasterisers(CPU), "3dgs, forward", "kernels/float32") < 1e-5
    for call, least, most in (
        ("grid_sample/float32", 1e-9, 1e-5),
        ("torchvision/float32", 1e-9, 1e-5),
        ("grid_sample/bfloat16", 1e-4, 0.2),
    ):
        assert least < error_of(deformable(CPU), "deformable sampling", call) < most
    assert error_of(resampling(CPU), "blur", "Fourier/float32") < 1e-5  # another way to the same
    assert error_of(resampling(CPU), "blur", "convolution/float32") < 1e-6
    single, double = (f"positions in {name}/float32" for name in ("float32", "float64"))
    assert error_of(resampling(CPU), "resize, down and up", double) < 1e-6
    assert error_of(resampling(CPU), "resize, down and up", single) < 1e-2


def test_more_steps_of_the_latent_sampler_come_closer(monkeypatch) -> None:
    monkeypatch.setattr(kernels, "FINEST", 128)
    ((_, reference, calls),) = latent(CPU)
    true = reference()
    errors = [errors_of(calls[f"cosine/{steps} steps"]().double(), true)[0] for steps in (1, 4, 16, 32)]
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < 0.5 * errors[1]
    linear = errors_of(calls["linear/32 steps"]().double(), true)[0]
    assert linear < errors[0]
