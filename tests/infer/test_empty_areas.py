"""Large empty areas beside a splat stay as rendered; small holes, and what references show, keep their change."""

import pytest
import torch

from gaussian_enhancer.infer.empty_areas import restore_empty_areas
from gaussian_enhancer.types import NetworkInput

HEIGHT, WIDTH = 160, 200


def inputs(alpha: torch.Tensor, visibility: torch.Tensor | None = None) -> NetworkInput:
    render = torch.rand(1, 3, HEIGHT, WIDTH, generator=torch.Generator().manual_seed(0))
    visibility = torch.zeros(1, 2, 1, HEIGHT, WIDTH) if visibility is None else visibility
    return NetworkInput(render, torch.zeros(1, 2, 3, HEIGHT, WIDTH), visibility, alpha=alpha)


def opaque() -> torch.Tensor:
    return torch.ones(1, 1, HEIGHT, WIDTH)


def test_a_large_empty_area_is_as_rendered_and_a_surface_keeps_its_change() -> None:
    alpha = opaque()
    alpha[..., :80] = 0
    views = inputs(alpha)
    restored = restore_empty_areas(1 - views.render, views)
    torch.testing.assert_close(restored[..., :70], views.render[..., :70], rtol=0, atol=1e-6)
    assert torch.equal(restored[..., 80:], 1 - views.render[..., 80:])


def test_the_edge_of_the_area_is_blended_by_opacity() -> None:
    alpha = opaque()
    alpha[..., :80], alpha[..., 80:90] = 0, 0.6
    views = inputs(alpha)
    enhanced = 1 - views.render
    share = (restore_empty_areas(enhanced, views) - enhanced) / (views.render - enhanced)
    assert 0.2 < float(share[..., 80:90].median()) <= 0.5


@pytest.mark.parametrize("side", [8, 20])
def test_a_small_hole_is_filled(side) -> None:
    alpha = opaque()
    alpha[..., 40 : 40 + side, 40 : 40 + side] = 0
    views = inputs(alpha)
    assert torch.equal(restore_empty_areas(1 - views.render, views), 1 - views.render)


def test_what_a_reference_shows_keeps_its_change() -> None:
    alpha = opaque()
    alpha[..., :80] = 0
    visibility = torch.zeros(1, 2, 1, HEIGHT, WIDTH)
    visibility[:, 1, :, :40] = 0.4
    views = inputs(alpha, visibility)
    restored = restore_empty_areas(1 - views.render, views)
    assert torch.equal(restored[..., :40, :], 1 - views.render[..., :40, :])
    torch.testing.assert_close(restored[..., 60:, :60], views.render[..., 60:, :60], rtol=0, atol=1e-6)


def test_without_opacity_nothing_is_restored() -> None:
    views = inputs(opaque())
    unknown = NetworkInput(views.render, views.references, views.visibility)
    assert torch.equal(restore_empty_areas(1 - views.render, unknown), 1 - views.render)
