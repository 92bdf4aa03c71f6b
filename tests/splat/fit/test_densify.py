"""Density control: Adam's moments stay with their Gaussians, numbers stay within bounds, the right ones come and go."""

import pytest
import torch

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.splat.fit.densify import Densification, ScreenGradientMean, densify
from gaussian_enhancer.splat.fit.optimise import LearningRates, SplatOptimiser
from gaussian_enhancer.splat.screen import ScreenStatistics
from gaussian_enhancer.types import Gaussians

NAMES = ("means", "log_scales", "quaternions", "opacity_logits", "sh_base", "sh_rest")


def some_gaussians(count: int, axes: int = 3, scale: float = 0.001) -> Gaussians:
    generator = torch.Generator().manual_seed(count)
    return Gaussians(
        torch.randn(count, 3, generator=generator),
        torch.full((count, axes), scale).log(),
        torch.randn(count, 4, generator=generator),
        torch.zeros(count),
        torch.randn(count, 4, 3, generator=generator),
    )


def stepped(gaussians: Gaussians) -> SplatOptimiser:
    """An optimiser after one step, with moments that tell Gaussians apart."""
    optimiser = SplatOptimiser(gaussians, LearningRates(), 1.0, 100)
    now = optimiser.gaussians()
    index = torch.arange(1.0, len(gaussians) + 1)
    loss = sum((v * index.reshape(-1, *[1] * (v.dim() - 1))).sum() for v in vars(now).values() if v is not None)
    loss.backward()
    optimiser.step(0)
    return optimiser


def pulled(values: list[float]) -> ScreenGradientMean:
    pull = ScreenGradientMean(len(values))
    seen = torch.ones(len(values), dtype=torch.bool)
    pull.add(ScreenStatistics(seen, torch.tensor(values)), 2)
    return pull


def test_moments_follow_their_gaussians():
    optimiser = stepped(some_gaussians(6))
    before = {k: v.clone() for k, v in optimiser.state().items()}
    optimiser.keep(torch.tensor([4, 1]))
    optimiser.append(some_gaussians(3))
    after = optimiser.state()
    for name in NAMES:
        assert len(after[name]) == 5
        for moment in ("exp_avg", "exp_avg_sq"):
            key = f"{name}.{moment}"
            assert torch.equal(after[key][:2], before[key][[4, 1]])
            assert before[key].abs().sum() > 0
            assert not after[key][2:].any()
            assert after[key].shape == after[name].shape


def test_rewritten_leaves_still_learn():
    optimiser = stepped(some_gaussians(4))
    optimiser.keep(torch.tensor([0, 2]))
    before = optimiser.gaussians().means.detach().clone()
    optimiser.gaussians().means.sum().backward()
    optimiser.step(1)
    assert (optimiser.gaussians().means != before).all()


def test_state_restores_exactly():
    first = stepped(some_gaussians(5))
    second = SplatOptimiser(some_gaussians(5), LearningRates(), 1.0, 100)
    second.restore(first.state())
    for optimiser in (first, second):
        optimiser.gaussians().sh.square().sum().backward()
        optimiser.step(1)
    assert torch.equal(first.gaussians().sh, second.gaussians().sh)


def test_small_are_cloned_large_are_split_and_transparent_go():
    gaussians = some_gaussians(4)
    gaussians.log_scales[1] = torch.tensor(0.5).log()
    gaussians.opacity_logits[3] = -20.0
    optimiser = SplatOptimiser(gaussians, LearningRates(), 1.0, 100)
    settings = Densification(pull=1.0, growth=1.0)
    densify(optimiser, pulled([2.0, 2.0, 0.0, 2.0]), settings, 1.0, 100, torch.Generator().manual_seed(0))
    found = optimiser.gaussians()
    assert len(found) == 5  # 4 - transparent + clone + (two halves - parent)
    assert torch.equal(found.means[2], gaussians.means[0])
    together = 1 - (1 - found.opacity_logits.sigmoid()) ** 2  # what covers as one Gaussian did before
    torch.testing.assert_close(together[[0, 2, 3, 4]], torch.full((4,), 0.5))
    halves = found.log_scales[3:].exp()
    torch.testing.assert_close(halves, torch.full_like(halves, 0.5 / 1.6))
    assert not torch.equal(found.means[3], found.means[4])


def test_halves_lie_within_a_disk():
    gaussians = some_gaussians(1, axes=2, scale=0.5)
    gaussians.quaternions[0] = torch.tensor([1.0, 0.0, 0.0, 0.0])
    optimiser = SplatOptimiser(gaussians, LearningRates(), 1.0, 100)
    settings = Densification(pull=1.0, growth=1.0)
    densify(optimiser, pulled([2.0]), settings, 1.0, 100, torch.Generator().manual_seed(0))
    torch.testing.assert_close(optimiser.gaussians().means[:, 2], gaussians.means[:, 2].expand(2))


@pytest.mark.parametrize(("limit", "growth", "expected"), [(12, 1.0, 12), (100, 0.3, 14), (5, 1.0, 10)])
def test_number_is_bounded_and_strongest_come_first(limit, growth, expected):
    gaussians = some_gaussians(10)
    optimiser = SplatOptimiser(gaussians, LearningRates(), 1.0, 100)
    settings = Densification(pull=0.5, growth=growth)
    values = [float(i) for i in range(1, 11)]
    densify(optimiser, pulled(values), settings, 1.0, limit, torch.Generator().manual_seed(0))
    found = optimiser.gaussians().means
    assert len(found) == expected
    if expected > 10:
        strongest = gaussians.means[10 - (expected - 10) :]
        assert torch.equal(found[10:].sort(0).values, strongest.sort(0).values)


def test_wrong_window_is_refused():
    with pytest.raises(InputError, match=r"densification\.start, stop.*order them"):
        Densification(start=0.7, stop=0.5)
    with pytest.raises(InputError, match=r"densification\.every"):
        Densification(every=-1)
    with pytest.raises(InputError, match=r"densification\.pull"):
        Densification(pull=float("inf"))


@pytest.mark.parametrize(
    "settings",
    [{"pull": -1e-4}, {"small": -0.1}, {"opacity": -0.1}, {"opacity": 2.0}, {"world_size": 0.0}, {"growth": -1.0}],
)
def test_settings_out_of_range_are_refused(settings):
    with pytest.raises(InputError, match=rf"densification\.{next(iter(settings))}: is "):
        Densification(**settings)
