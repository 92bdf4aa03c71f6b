import math

import pytest
import torch
from kornia.filters import get_gaussian_kernel2d

from gaussian_enhancer.degrade.artefacts.blur import blur, oriented_kernels
from gaussian_enhancer.degrade.artefacts.view import View
from support.generators import spawn_seeded


def kernel(along, across, angle):
    return oriented_kernels(*(torch.tensor([[v]], dtype=torch.float64) for v in (along, across, angle)))[0, 0]


@pytest.mark.parametrize(("along", "across"), [(1.5, 1.5), (2.0, 0.8)])
def test_equals_kornia_along_the_axes(along, across):
    theirs = get_gaussian_kernel2d(15, torch.tensor([[across, along]], dtype=torch.float64))[0]
    torch.testing.assert_close(kernel(along, across, 0.0), theirs)
    torch.testing.assert_close(kernel(along, across, math.pi / 2), theirs.T)


def test_the_long_axis_points_along_the_angle():
    ours = kernel(1.8, 0.9, 0.6)
    offset = torch.arange(-7.0, 8, dtype=torch.float64)
    down, right = torch.meshgrid(offset, offset, indexing="ij")
    covariance = torch.stack([(ours * a * b).sum() for a in (right, down) for b in (right, down)]).reshape(2, 2)
    variances, axes = torch.linalg.eigh(covariance)
    torch.testing.assert_close(variances, torch.tensor([0.81, 3.24], dtype=torch.float64), rtol=0.01, atol=0)
    assert abs(float(axes[:, 1] @ torch.tensor([math.cos(0.6), math.sin(0.6)], dtype=torch.float64))) > 0.999


def test_no_width_is_the_impulse():
    expected = torch.zeros(15, 15, dtype=torch.float64)
    expected[7, 7] = 1
    assert torch.equal(kernel(0.0, 0.0, 0.3), expected)


def test_is_linear_and_keeps_constants():
    generator = torch.Generator().manual_seed(0)
    x, y = torch.rand(2, 2, 3, 20, 24, generator=generator, dtype=torch.float64)
    strength = torch.ones(2, dtype=torch.float64)

    def blurred(image):
        return blur(View(image), strength, spawn_seeded(2, seed=5)).image

    torch.testing.assert_close(blurred(0.3 * x + 0.7 * y), 0.3 * blurred(x) + 0.7 * blurred(y))
    torch.testing.assert_close(blurred(torch.full_like(x, 0.4)), torch.full_like(x, 0.4))
    assert blurred(x).std() < 0.4 * x.std()


def test_how_much_varies_over_the_image():
    impulses = torch.zeros(1, 3, 96, 96)
    impulses[..., 12::24, 12::24] = 1
    after = blur(View(impulses), torch.ones(1), spawn_seeded(1)).image
    peaks = after[0, 0, 12::24, 12::24]
    assert peaks.max() > 1.3 * peaks.min()


def test_gradcheck():
    image = torch.rand(1, 3, 4, 5, dtype=torch.float64).requires_grad_()
    strength = torch.full((1,), 0.6, dtype=torch.float64)

    def blurred(x):
        return blur(View(x), strength, [torch.Generator().manual_seed(0)]).image

    assert torch.autograd.gradcheck(blurred, (image,))
