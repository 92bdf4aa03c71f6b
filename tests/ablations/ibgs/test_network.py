"""The residual network of IBGS."""

import dataclasses

import pytest
import torch

from ablations.ibgs.network import IBGSResidual, ResidualInput
from ablations.ibgs.sources import Sources
from gaussian_enhancer.infer.weights import count_parameters
from support.networks import trained


def seen(height: int = 20, width: int = 28, sources: int = 3, batch: int = 1) -> ResidualInput:
    generator = torch.Generator().manual_seed(0)

    def rand(*shape: int) -> torch.Tensor:
        return torch.rand(batch, *shape, height, width, generator=generator)

    visible = rand(sources, 1) > 0.4
    colours, cameras = rand(sources, 3) * visible, rand(sources, 4) * visible
    return ResidualInput(rand(3), colours, cameras, visible, rand(3))


def test_it_has_about_the_published_number_of_parameters():
    assert 60_000 <= count_parameters(IBGSResidual()) <= 72_000


@pytest.mark.parametrize("size", [(1, 1), (5, 3), (20, 28)])
@pytest.mark.parametrize("sources", [0, 1, 4])
def test_untrained_the_residual_is_zero(size, sources):
    given = seen(*size, sources=sources)
    residual = IBGSResidual()(given)
    assert residual.shape == given.render.shape
    assert not residual.any()


def test_order_of_sources_changes_nothing_and_invisible_ones_are_as_if_they_were_not_there():
    network, given = trained(IBGSResidual), seen()
    expected = network(given)
    assert not torch.allclose(expected, torch.zeros_like(expected), atol=1e-3)
    order = torch.tensor([2, 0, 1])
    parts = {name: getattr(given, name)[:, order] for name in ("colours", "cameras", "visible")}
    torch.testing.assert_close(network(dataclasses.replace(given, **parts)), expected)
    none = dataclasses.replace(given, visible=torch.zeros_like(given.visible), cameras=0 * given.cameras)
    empty = {name: getattr(given, name)[:, :0] for name in ("colours", "cameras", "visible")}
    torch.testing.assert_close(network(none), network(dataclasses.replace(given, **empty)))


@pytest.mark.parametrize("count", [0, 2, 4])
def test_what_counts_nowhere_is_left_out_of_the_input(count):
    generator = torch.Generator().manual_seed(0)
    visible = torch.rand(count, 1, 20, 28, generator=generator) > 0.3
    visible &= visible.cumsum(0) <= 3
    colours = torch.rand(count, 3, 20, 28, generator=generator) * visible
    cameras = torch.rand(count, 4, 20, 28, generator=generator) * visible
    render, rays = torch.rand(2, 3, 20, 28, generator=generator)
    sources = Sources(colours, cameras, visible, rays, ("",) * count)
    network, found = trained(IBGSResidual), ResidualInput.of(render, sources, 3)
    assert found.colours.shape[1] == 3
    all_of_them = ResidualInput(render[None], colours[None], cameras[None], visible[None], rays[None])
    torch.testing.assert_close(network(found), network(all_of_them))


def test_it_is_told_differences_of_colour():
    """A pixel whose photos have the render's colours has the same features whatever these are."""
    network, given = trained(IBGSResidual), seen()
    features = []
    for shade in (0.2, 0.7):
        render = torch.full_like(given.render, shade)
        alike = dataclasses.replace(given, render=render, colours=render[:, None] * given.visible)
        features.append(network.pooled(alike))
    torch.testing.assert_close(*features)
    assert not torch.allclose(network.pooled(given), features[0], atol=1e-3)


def test_features_are_pooled_by_mean_variance_and_maximum():
    network, given = trained(IBGSResidual), seen(4, 4)
    each = torch.cat([(given.colours - given.render[:, None]) * given.visible, given.cameras], dim=2)
    features = network.encode(each[0])
    for row, column in ((0, 0), (1, 2), (3, 3)):
        mine = features[given.visible[0, :, 0, row, column], :, row, column]
        expected = torch.cat([mine.mean(0), mine.var(0, correction=0), mine.amax(0)]) if len(mine) else torch.zeros(96)
        torch.testing.assert_close(network.pooled(given)[0, :, row, column], expected)


def test_gradients_reach_every_part():
    network = trained(IBGSResidual)
    network(seen()).square().mean().backward()
    for name, parameter in network.named_parameters():
        assert parameter.grad is not None, name
        assert parameter.grad.abs().sum() > 0, name
