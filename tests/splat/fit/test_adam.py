"""Adam against torch's, with one rate and with another for the first column."""

import pytest
import torch

from gaussian_enhancer.splat.fit.adam import BETAS, EPSILON, Moments, adam_step


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize(
    ("shape", "first_rate"), [((700, 16, 3), 0.02), ((700, 4), None), ((900,), None), ((3, 1, 3), 1.0)]
)
def test_equals_torchs_adam(dtype: torch.dtype, shape: tuple[int, ...], first_rate: float | None) -> None:
    draw = torch.Generator().manual_seed(0)
    values = torch.randn(shape, generator=draw, dtype=dtype)
    rate = 0.005
    parts = [values.clone()] if first_rate is None else [values[:, :1].clone(), values[:, 1:].clone()]
    rates = [rate] if first_rate is None else [first_rate, rate]
    leaves = [part.requires_grad_() for part in parts]
    groups = [{"params": [leaf], "lr": each} for leaf, each in zip(leaves, rates, strict=True)]
    adam = torch.optim.Adam(groups, betas=BETAS, eps=EPSILON)
    moments = Moments(torch.zeros_like(values), torch.zeros_like(values))
    for number in range(1, 6):
        gradient = torch.randn(shape, generator=draw, dtype=dtype) * (torch.arange(shape[0]) % 3).reshape(
            -1, *[1] * (len(shape) - 1)
        )
        given = [gradient] if first_rate is None else [gradient[:, :1], gradient[:, 1:]]
        for leaf, part in zip(leaves, given, strict=True):
            leaf.grad = part.clone()
        adam.step()
        adam_step(values, gradient, moments, number, rate, first_rate)
    joined = leaves[0] if first_rate is None else torch.cat(leaves, 1)
    torch.testing.assert_close(values, joined.detach(), rtol=1e-5, atol=1e-5)


def test_nothing_to_update() -> None:
    empty = torch.zeros(0, 4, 3)
    adam_step(empty, empty, Moments(empty, empty), 1, 0.1, 0.2)
    assert len(empty) == 0
