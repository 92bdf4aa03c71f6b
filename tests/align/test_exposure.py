import pytest
import torch

from gaussian_enhancer.align.exposure import apply_colour, fit_colour


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])  # compiled, and the readable twin
def test_colour_transform_is_recovered_despite_outliers(dtype):
    generator = torch.Generator().manual_seed(0)
    target = torch.nn.functional.avg_pool2d(torch.rand(3, 260, 260, generator=generator), 5)
    target = ((target - target.mean()) * 3 + 0.5).clamp(0.04, 0.96)
    source = (target - 0.03) / 1.25
    source[:, :8] = 0.9
    source, target, ones = source.to(dtype), target.to(dtype), torch.ones(1, 52, 52, dtype=dtype)
    transform = fit_colour(source, target, ones, prior=0.0)
    torch.testing.assert_close(transform[:, 0], torch.full((3,), 1.25, dtype=torch.float64), rtol=0.02, atol=0)
    assert (apply_colour(source, transform) - target)[:, 12:].abs().max() < 0.02
    unseen = fit_colour(source, target, torch.zeros_like(ones))
    torch.testing.assert_close(unseen, torch.tensor([[1.0, 0.0]], dtype=torch.float64).expand(3, 2))


@pytest.mark.parametrize("size", [(1, 1), (3, 5), (97, 126)])
def test_compiled_fit_equals_its_readable_twin(size):
    generator = torch.Generator().manual_seed(0)
    source = torch.rand(3, *size, generator=generator)
    target = (0.8 * source + 0.05 + 0.02 * torch.randn(3, *size, generator=generator)).clamp(0, 1)
    weight = torch.rand(1, *size, generator=generator)
    weight = torch.where(weight < 0.3, 0.0, weight)
    found = fit_colour(source, target, weight)
    twin = fit_colour(source.double(), target.double(), weight.double())
    torch.testing.assert_close(found, twin, rtol=0, atol=1e-6)


def test_colours_of_what_is_hardly_visible_stay():
    source, target = torch.full((3, 8, 8), 0.2), torch.full((3, 8, 8), 0.6)
    identity = torch.tensor([[1.0, 0.0]], dtype=torch.float64).expand(3, 2)
    torch.testing.assert_close(fit_colour(source, target, torch.full((1, 8, 8), 1e-4)), identity)
    assert fit_colour(source, target, torch.full((1, 8, 8), 1e-3))[0].ne(identity[0]).all()
