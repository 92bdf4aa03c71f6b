"""3DGS-MCMC: the published formulas by quadrature, who moves, who explores."""

import math

import pytest
import torch

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.splat.fit.optimise import LearningRates, SplatOptimiser
from gaussian_enhancer.splat.fit.relocation import Relocation, explore, relocate, split_between_copies
from gaussian_enhancer.types import Gaussians


def some(count: int, axes: int = 3) -> Gaussians:
    draw = torch.Generator().manual_seed(count)
    return Gaussians(
        torch.randn(count, 3, generator=draw),
        torch.randn(count, axes, generator=draw) - 3,
        torch.randn(count, 4, generator=draw),
        torch.full((count,), 1.0),
        torch.randn(count, 4, 3, generator=draw),
    )


def stepped(gaussians: Gaussians) -> SplatOptimiser:
    """An optimiser with moments everywhere and rates that move nothing."""
    optimiser = SplatOptimiser(gaussians, LearningRates(*[1e-12] * 7), 1.0, 100)
    sum(value.sum() for value in vars(optimiser.gaussians()).values() if value is not None).backward()
    optimiser.step(0)
    return optimiser


@pytest.mark.parametrize("copies", [1, 2, 3, 10, 51])
@pytest.mark.parametrize("opacity", [0.006, 0.3, 0.95])
def test_copies_equal_one_gaussian_at_its_centre_and_in_what_they_hide_along_a_line(copies, opacity):
    new, factor = split_between_copies(torch.tensor([opacity], dtype=torch.float64), torch.tensor([copies]))
    assert 1 - (1 - new.item()) ** copies == pytest.approx(opacity, rel=1e-9)
    x = torch.linspace(-12, 12, 20_001, dtype=torch.float64)
    one = opacity * torch.exp(-(x**2) / 2)
    together = 1 - (1 - new * torch.exp(-((x / factor) ** 2) / 2)) ** copies
    assert together.sum().item() == pytest.approx(one.sum().item(), rel=1e-6)
    assert copies > 1 or factor.item() == pytest.approx(1.0)


@pytest.mark.parametrize("axes", [2, 3])
def test_dead_gaussians_move_to_live_ones_which_share_with_them(axes):
    gaussians = some(6, axes)
    gaussians.opacity_logits[:4] = -8.0
    optimiser = stepped(gaussians)
    relocate(optimiser, Relocation(growth=0.0), 100, torch.Generator().manual_seed(0))
    found, state = optimiser.gaussians(), optimiser.state()
    assert len(found) == 6
    copies = []
    for k in (4, 5):
        same = (found.means == gaussians.means[k]).all(1)
        copies.append(int(same.sum()))
        together = 1 - (1 - found.opacity_logits[same].sigmoid()).prod()
        torch.testing.assert_close(together, torch.tensor(1.0).sigmoid())
        drawn = copies[-1] > 1
        assert bool((state["means.exp_avg"][k] == 0).all()) == drawn
    assert sum(copies) == 6
    assert not state["sh_rest.exp_avg"][:4].any()


def test_number_grows_by_a_twentieth_up_to_the_limit():
    optimiser = stepped(some(100))
    draw = torch.Generator().manual_seed(0)
    numbers = []
    for _ in range(4):
        relocate(optimiser, Relocation(), 112, draw)
        numbers.append(len(optimiser))
    assert numbers == [105, 110, 112, 112]
    assert (optimiser.gaussians().opacity_logits.sigmoid() >= 0.005 - 1e-6).all()


def test_without_a_live_gaussian_nothing_moves():
    gaussians = some(3)
    gaussians.opacity_logits[:] = -20.0
    optimiser = stepped(gaussians)
    relocate(optimiser, Relocation(), 100, torch.Generator().manual_seed(0))
    torch.testing.assert_close(optimiser.gaussians().means, gaussians.means)


@pytest.mark.parametrize("axes", [2, 3])
def test_noise_has_the_shape_of_a_transparent_gaussian_and_spares_opaque_ones(axes):
    gaussians = some(4000, axes)
    gaussians.means[:] = 0
    gaussians.log_scales[:] = torch.tensor([0.5, 0.2, 1e-4][:axes]).log()
    gaussians.quaternions[:] = torch.tensor([math.cos(0.3), 0.0, 0.0, math.sin(0.3)])
    gaussians.opacity_logits[:2000] = -20.0
    extent, rates = 2.0, LearningRates(means=1e-4, means_final=1e-4, boost=1.0)
    optimiser = SplatOptimiser(gaussians, rates, extent, 100)
    explore(optimiser, Relocation(noise=100.0), extent, 7, torch.Generator().manual_seed(1))
    moved = optimiser.gaussians().means.detach()
    assert (moved[2000:].abs() < 1e-12).all()
    c, s = math.cos(0.6), math.sin(0.6)
    turn = torch.tensor([[c, -s], [s, c]])
    gate = 1 / (1 + math.exp(-100 * 0.005))
    sigma = turn @ torch.diag(torch.tensor([0.25, 0.04])) @ turn.T * (100.0 * 1e-4 * extent / extent**2 * gate)
    expected = sigma @ sigma.T
    found = moved[:2000, :2].T @ moved[:2000, :2] / 2000
    torch.testing.assert_close(found, expected, rtol=0.1, atol=0.1 * float(expected.max()))
    assert moved[:, 2].abs().max() < 1e-8


def test_refusals():
    with pytest.raises(InputError, match="order them"):
        Relocation(start=0.7, stop=0.5)
    with pytest.raises(InputError, match="between 0 and 1"):
        Relocation(opacity=0.0)
    with pytest.raises(InputError, match="below 0"):
        Relocation(noise=-1.0)


@pytest.mark.parametrize("name", ["growth", "noise"])
def test_an_infinite_value_is_refused_by_the_name_of_its_option(name):
    with pytest.raises(InputError, match=rf"densification\.{name}: .*finite"):
        Relocation(**{name: math.inf})
