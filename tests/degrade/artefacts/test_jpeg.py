import io

import numpy as np
import pytest
import torch
from PIL import Image

from gaussian_enhancer.degrade.artefacts.jpeg import jpeg
from gaussian_enhancer.degrade.artefacts.view import View


def photo(height=64, width=80):
    y = torch.linspace(0, 1, height)[:, None]
    x = torch.linspace(0, 1, width)[None, :]
    waves = [0.5 + 0.3 * torch.sin((8 + 5 * i) * (x + i * y)) * torch.cos(30 * x * y) for i in range(3)]
    image = torch.stack(waves)[None]
    image[..., 20:40, 30:60] += 0.2
    return (image.clamp(0, 1) * 255).round() / 255


def by_pillow(image, quality):
    file = io.BytesIO()
    pixels = (image[0].permute(1, 2, 0) * 255).round().byte().numpy()
    Image.fromarray(pixels).save(file, "JPEG", quality=quality, subsampling=2)
    return torch.from_numpy(np.array(Image.open(file))).permute(2, 0, 1)[None] / 255


@pytest.mark.parametrize("strength", [0.2, 0.6, 1.0])
def test_errs_as_a_real_file_does(strength):
    image = photo()
    ours = jpeg(View(image), torch.tensor([strength]), []).image
    theirs = by_pillow(image, int(95 - 75 * strength))
    error = (theirs - image).square().mean().sqrt()
    assert (ours - theirs).square().mean().sqrt() < 0.6 * error
    torch.testing.assert_close((ours - image).square().mean().sqrt(), error, rtol=0.25, atol=0)


def test_samples_have_qualities_of_their_own():
    image = photo().expand(2, -1, -1, -1)
    change = (jpeg(View(image), torch.tensor([0.1, 1.0]), []).image - image).abs().mean((1, 2, 3))
    assert change[1] > 1.5 * change[0]


def test_blocks_start_at_the_corner_whatever_the_size():
    image = photo(64, 80)
    whole = jpeg(View(image), torch.ones(1), []).image
    part = jpeg(View(image[..., :37, :51]), torch.ones(1), []).image
    torch.testing.assert_close(part[..., :30, :46], whole[..., :30, :46])
    assert (part[..., 36, 50] - whole[..., 36, 50]).abs().max() > 1e-4


def test_gradcheck():
    # Away from halves of the quantisation, where rounding jumps.
    image = (0.3 + 0.4 * torch.rand(1, 3, 3, 5, generator=torch.Generator().manual_seed(2))).double().requires_grad_()
    strength = torch.tensor([0.05], dtype=torch.float64)
    assert torch.autograd.gradcheck(lambda x: jpeg(View(x), strength, []).image, (image,), eps=1e-7, atol=1e-3)
