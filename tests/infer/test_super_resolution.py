"""Limits to super-resolution: colours of the references where they are visible, upsampling elsewhere."""

from dataclasses import replace

import pytest
import torch
from test_cascade import SMALL

from gaussian_enhancer.align.alignment import Reprojected
from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.infer.super_resolution import STRIP, limit_finer_scales
from gaussian_enhancer.network.cascade import Cascade
from gaussian_enhancer.network.pyramid import upsample_bicubic
from gaussian_enhancer.network.ssif_lr import SSIFLR
from gaussian_enhancer.network.ssif_sr import SSIFSR
from gaussian_enhancer.types import NetworkInput
from support.networks import trained, views


def seen_by(visibility: torch.Tensor, photos: torch.Tensor | None = None) -> NetworkInput:
    batch, count, _, height, width = visibility.shape
    coarse = torch.rand(batch, count, 3, height, width)
    return NetworkInput(torch.rand(batch, 3, height, width), coarse, visibility, fine_references=photos)


def test_unseen_pixels_are_upsampled_and_seen_ones_stay() -> None:
    image, finer = torch.rand(1, 3, 12, 16), torch.rand(1, 3, 48, 64)
    visibility = torch.zeros(1, 2, 1, 12, 16)
    visibility[:, 0, :, :, :6] = 0.3
    visibility[:, 1, :, 2:5, 4:8] = 1.0
    before = finer.clone()
    result = limit_finer_scales(finer, image, seen_by(visibility))
    upsampled = upsample_bicubic(image, 4)
    torch.testing.assert_close(result[..., :18], before[..., :18])  # columns 0 to 4: all their neighbours are visible
    torch.testing.assert_close(result[..., 40:], upsampled[..., 40:])  # from column 10 on none is
    between = result[..., 18:40]
    low, high = torch.minimum(before, upsampled)[..., 18:40], torch.maximum(before, upsampled)[..., 18:40]
    assert bool(((between >= low - 1e-6) & (between <= high + 1e-6)).all())


@pytest.mark.parametrize("references", [0, 2])
def test_an_image_is_changed_everywhere_or_nowhere_if_all_or_none_is_seen(references: int) -> None:
    image, finer = torch.rand(1, 3, 8, 8), torch.rand(1, 3, 32, 32)
    seen = limit_finer_scales(finer.clone(), image, seen_by(torch.ones(1, references, 1, 8, 8)))
    unseen = limit_finer_scales(finer.clone(), image, seen_by(torch.zeros(1, references, 1, 8, 8)))
    torch.testing.assert_close(seen, finer if references else upsample_bicubic(image, 4))
    torch.testing.assert_close(unseen, upsample_bicubic(image, 4))


@pytest.mark.parametrize("height", [12, STRIP + 5])
def test_seen_pixels_keep_to_the_colours_of_image_and_fine_photos(height: int) -> None:
    image, finer = torch.rand(1, 3, height, 16), torch.rand(1, 3, 4 * height, 64)
    visibility = torch.ones(1, 2, 1, height, 16)
    visibility[:, 1, :, :, 8:] = 0  # the second photo is visible in the left half alone
    photos = torch.rand(1, 2, 3, 4 * height, 64)
    photos[:, 0] = photos[:, 1] * 0.2
    upsampled = upsample_bicubic(image, 4)
    result = limit_finer_scales(finer.clone(), image, seen_by(visibility, photos.half()))
    low, high = (choose(photos[:, 0], upsampled) for choose in (torch.minimum, torch.maximum))
    high[..., :32] = torch.maximum(high, photos[:, 1])[..., :32]
    expected = torch.minimum(torch.maximum(finer, low), high)
    torch.testing.assert_close(result, expected, rtol=0, atol=1e-3)
    assert float((result - finer).abs().mean()) > 0.05
    unlimited = limit_finer_scales(finer.clone(), image, seen_by(visibility, photos), clamps=False)
    torch.testing.assert_close(unlimited, finer)


def test_the_enhancer_leaves_the_finer_scales_out_where_no_reference_is_visible() -> None:
    seen = replace(views(32, 48, references=3), fine_references=torch.rand(1, 3, 3, 128, 192))
    seen.visibility[..., 24:] = 0
    cascade = Cascade(trained(SSIFLR, **SMALL), trained(SSIFSR, **SMALL))
    options = {"precision": "float32", "colour_clamping": 0, "colour_completion": False}
    result = SetEnhancer(cascade, ReferenceConfig(Reprojected()), **options).enhance(seen)
    with torch.inference_mode():
        first = cascade.first(replace(seen, fine_references=None))
        finer, upsampled = (
            image.clamp(0, 1) for image in (cascade.second(replace(seen, render=first)), upsample_bicubic(first, 4))
        )
    assert float((finer - upsampled)[..., 104:].abs().max()) > 0.01
    torch.testing.assert_close(result[..., :88], finer[..., :88], rtol=0, atol=1e-5)
    torch.testing.assert_close(result[..., 104:], upsampled[..., 104:], rtol=0, atol=1e-5)


@pytest.mark.parametrize("window", [0, 3])
def test_the_enhancer_clamps_finer_scales_if_it_clamps(window: int) -> None:
    grey = replace(
        views(32, 48, references=3),
        render=torch.full((1, 3, 32, 48), 0.5),
        references=torch.full((1, 3, 3, 32, 48), 0.5),
        visibility=torch.ones(1, 3, 1, 32, 48),
        fine_references=torch.full((1, 3, 3, 128, 192), 0.5),
    )
    cascade = Cascade(trained(SSIFLR, **SMALL), trained(SSIFSR, **SMALL))
    options = {"precision": "float32", "colour_clamping": window, "colour_completion": False}
    change = SetEnhancer(cascade, ReferenceConfig(Reprojected()), **options).enhance(grey) - 0.5
    assert bool(change.abs().max() < 1e-6) == bool(window)
