"""Limits to super-resolution: nothing but upsampling where no reference is visible."""

from dataclasses import replace

import pytest
import torch
from test_cascade import SMALL, moved
from test_sif import views

from gaussian_enhancer.align.alignment import Reprojected
from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.infer.super_resolution import upsample_where_unseen
from gaussian_enhancer.network.cascade import Cascade
from gaussian_enhancer.network.pyramid import upsample_bicubic
from gaussian_enhancer.network.ssif_lr import SSIFLR
from gaussian_enhancer.network.ssif_sr import SSIFSR


def test_unseen_pixels_are_upsampled_and_seen_ones_stay() -> None:
    image, finer = torch.rand(1, 3, 12, 16), torch.rand(1, 3, 48, 64)
    visibility = torch.zeros(1, 2, 1, 12, 16)
    visibility[:, 0, :, :, :6] = 0.3
    visibility[:, 1, :, 2:5, 4:8] = 1.0
    before = finer.clone()
    result = upsample_where_unseen(finer, image, visibility)
    upsampled = upsample_bicubic(image, 4)
    torch.testing.assert_close(result[..., :18], before[..., :18])  # columns 0 to 4: all their neighbours are visible
    torch.testing.assert_close(result[..., 40:], upsampled[..., 40:])  # from column 10 on none is
    between = result[..., 18:40]
    low, high = torch.minimum(before, upsampled)[..., 18:40], torch.maximum(before, upsampled)[..., 18:40]
    assert bool(((between >= low - 1e-6) & (between <= high + 1e-6)).all())


@pytest.mark.parametrize("references", [0, 2])
def test_an_image_is_changed_everywhere_or_nowhere_if_all_or_none_is_seen(references: int) -> None:
    image, finer = torch.rand(1, 3, 8, 8), torch.rand(1, 3, 32, 32)
    seen = upsample_where_unseen(finer.clone(), image, torch.ones(1, references, 1, 8, 8))
    unseen = upsample_where_unseen(finer.clone(), image, torch.zeros(1, references, 1, 8, 8))
    torch.testing.assert_close(seen, finer if references else upsample_bicubic(image, 4))
    torch.testing.assert_close(unseen, upsample_bicubic(image, 4))


def test_the_enhancer_leaves_the_finer_scales_out_where_no_reference_is_visible() -> None:
    seen = replace(views(32, 48, references=3), fine_references=torch.rand(1, 3, 3, 128, 192))
    seen.visibility[..., 24:] = 0
    cascade = Cascade(moved(SSIFLR(**SMALL)), moved(SSIFSR(**SMALL)))
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
