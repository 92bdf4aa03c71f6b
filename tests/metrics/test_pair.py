import math

import pytest
import torch

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.metrics.image_quality import psnr, ssim
from gaussian_enhancer.metrics.lpips import PerceptualDistance
from gaussian_enhancer.metrics.pair import measure_pair
from gaussian_enhancer.types import quantise_8_bit


def test_both_images_are_brought_to_eight_bits_first() -> None:
    draw = torch.Generator().manual_seed(0)
    image, photo = (torch.rand(3, 20, 20, generator=draw) * 1.2 - 0.1 for _ in range(2))
    found = measure_pair(image, photo).metrics
    assert found["psnr"] == psnr(quantise_8_bit(image), quantise_8_bit(photo))
    assert found["ssim"] == ssim(quantise_8_bit(image), quantise_8_bit(photo))
    assert measure_pair(photo, photo + 0.4 / 255).metrics["psnr"] != math.inf
    assert measure_pair(quantise_8_bit(photo), quantise_8_bit(photo) + 0.4 / 255).metrics["psnr"] == math.inf


def test_what_cannot_be_measured_has_a_reason() -> None:
    image = torch.rand(3, 20, 20)
    missing = PerceptualDistance("lpips_alex", None, "not measured: no backbone")
    found = measure_pair(image, image, [missing], torch.zeros(1, 20, 20))
    assert found.metrics["lpips_alex"] is None
    assert found.metrics["psnr_masked"] is None
    assert found.reasons == {
        "lpips_alex": "not measured: no backbone",
        "psnr_masked": "not measured: the mask is empty",
    }


def test_sizes_that_differ_are_refused() -> None:
    with pytest.raises(InputError, match="photo: is 20x21 where the image is 20x20"):
        measure_pair(torch.rand(3, 20, 20), torch.rand(3, 21, 20))
    with pytest.raises(InputError, match="mask: is 19x20"):
        measure_pair(torch.rand(3, 20, 20), torch.rand(3, 20, 20), mask=torch.ones(1, 20, 19))
