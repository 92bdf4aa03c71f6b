"""Dark surfaces that the splat leaves transparent are seen by references; holes are not."""

import pytest
import torch

from gaussian_enhancer.align.alignment import LoadedView, Reprojected
from gaussian_enhancer.align.transparent import PLAIN_SHARE, dark_transparent_pixels
from gaussian_enhancer.types import identity_camera

HEIGHT, WIDTH = 40, 60
HOLE = slice(10, 20), slice(20, 32)
"""Rows and columns in which the target's splat is transparent and its render black."""


def textured() -> torch.Tensor:
    return 0.3 + 0.4 * torch.rand(3, HEIGHT, WIDTH, generator=torch.Generator().manual_seed(0))


def with_hole(image: torch.Tensor, colour: float = 0.02) -> torch.Tensor:
    image = image.clone()
    image[:, *HOLE] = colour
    return image


def target() -> LoadedView:
    alpha = torch.ones(1, HEIGHT, WIDTH)
    alpha[:, *HOLE] = 0.1
    camera = identity_camera(HEIGHT, WIDTH, 50.0)
    return LoadedView("t", with_hole(textured()), camera, torch.full((1, HEIGHT, WIDTH), 2.0), alpha)


def reference(photo: torch.Tensor, render: torch.Tensor | None) -> LoadedView:
    """A reference from the same place, whose depth contradicts the target's in the hole."""
    depth = torch.full((1, HEIGHT, WIDTH), 2.0)
    depth[:, *HOLE] = 9.0
    return LoadedView("r", photo, identity_camera(HEIGHT, WIDTH, 50.0), depth, render=render)


def test_a_reference_that_is_dark_too_shows_the_surface() -> None:
    dark = with_hole(textured(), 0.05)
    aligned = Reprojected("exact", match_colour=False)(target(), [reference(dark, dark)], 1)
    assert bool((aligned.visibility > 0.9).all())
    torch.testing.assert_close(aligned.references[0], dark, rtol=0, atol=1e-4)
    torch.testing.assert_close(aligned.renders[0], dark, rtol=0, atol=1e-4)


@pytest.mark.parametrize(("photo", "render"), [(0.5, 0.05), (0.05, 0.5), (0.5, 0.5), (0.05, None)])
def test_a_reference_that_shows_something_else_or_has_no_render_does_not(photo: float, render: float | None) -> None:
    rendered = None if render is None else with_hole(textured(), render)
    aligned = Reprojected("exact", match_colour=False)(target(), [reference(with_hole(textured(), photo), rendered)], 1)
    assert not bool(aligned.visibility[0][:, *HOLE].any())
    assert not bool(aligned.references[0][:, *HOLE].any())
    assert bool((aligned.visibility[0, :, :10] > 0.9).all())


def test_opaque_bright_and_plain_pixels_are_no_dark_surfaces() -> None:
    view = target()
    mask = dark_transparent_pixels(view.image, view.alpha)
    assert mask is not None
    assert torch.equal(mask, view.alpha < 0.5)
    assert dark_transparent_pixels(view.image, None) is None
    assert dark_transparent_pixels(view.image, torch.ones_like(view.alpha)) is None
    over_white = dark_transparent_pixels(with_hole(textured(), 0.9), view.alpha)
    assert over_white is not None
    assert not bool(over_white.any())
    plain = view.alpha.clone()
    plain[:, : round(1.1 * PLAIN_SHARE * HEIGHT)] = 0
    assert dark_transparent_pixels(torch.zeros_like(view.image), plain) is None
