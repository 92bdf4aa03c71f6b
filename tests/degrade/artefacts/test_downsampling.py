import pytest
import torch
import torch.nn.functional as F

from gaussian_enhancer.degrade.artefacts.downsampling import KINDS, downsampling, resampling_matrix, taps
from gaussian_enhancer.degrade.artefacts.view import View
from support.generators import spawn_seeded

TORCH = {"nearest": "nearest-exact", "bilinear": "bilinear", "bicubic": "bicubic"}


def resample(image, factor, phase, down, up):
    one = torch.tensor([0])
    rows, columns = (
        resampling_matrix(
            n,
            torch.tensor([factor], dtype=torch.float64),
            torch.tensor([phase], dtype=torch.float64),
            one + down,
            one + up,
        )
        for n in image.shape[-2:]
    )
    return rows[:, None] @ image @ columns.mT[:, None]


@pytest.mark.parametrize("down", range(3))
@pytest.mark.parametrize("up", range(3))
@pytest.mark.parametrize("factor", [2, 4])
def test_equals_two_interpolations_of_torch(down, up, factor):
    image = torch.rand(1, 3, 24, 32, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    corners = {} if KINDS[down] == "nearest" else {"align_corners": False}
    small = F.interpolate(image, scale_factor=1 / factor, mode=TORCH[KINDS[down]], **corners)
    corners = {} if KINDS[up] == "nearest" else {"align_corners": False}
    large = F.interpolate(small, size=image.shape[-2:], mode=TORCH[KINDS[up]], **corners)
    inner = (..., slice(2 * factor, -2 * factor), slice(2 * factor, -2 * factor))
    torch.testing.assert_close(resample(image, float(factor), 0.0, down, up)[inner], large[inner])


def test_a_shift_of_the_samples_is_a_shift_of_the_image():
    image = torch.rand(1, 3, 24, 32, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    shifted = resample(image.roll((-1, -1), (2, 3)), 3.0, 0.0, 1, 2).roll((1, 1), (2, 3))
    torch.testing.assert_close(resample(image, 3.0, 1.0, 1, 2)[..., 8:-8, 8:-8], shifted[..., 8:-8, 8:-8])


@pytest.mark.parametrize(("kind", "degree"), [(0, 0), (1, 1), (2, 0)])
def test_weights_reproduce_polynomials(kind, degree):
    position = torch.linspace(3, 7, 41, dtype=torch.float64)[None]
    index, weight = taps(position, torch.tensor([kind]))
    for power in range(degree + 1):
        torch.testing.assert_close((weight * index.double() ** power).sum(-1), position**power)


def test_factor_1_is_the_identity():
    matrix = resampling_matrix(
        9, torch.ones(3, dtype=torch.float64), torch.zeros(3, dtype=torch.float64), torch.arange(3), torch.arange(3)
    )
    assert torch.equal(matrix, torch.eye(9, dtype=torch.float64).expand(3, -1, -1))


def test_constants_stay_and_the_finest_detail_goes():
    strength = torch.ones(8)
    grey = torch.full((8, 3, 19, 33), 0.3)
    generators = spawn_seeded(8)
    torch.testing.assert_close(downsampling(View(grey), strength, generators).image, grey)
    image = torch.rand(8, 3, 64, 64, generator=torch.Generator().manual_seed(0))
    after = downsampling(View(image), strength, spawn_seeded(8)).image

    def roughness(x):
        return (x[..., 1:] - x[..., :-1]).square().mean((1, 2, 3))

    assert (roughness(after) < 0.6 * roughness(image)).all()


def test_gradcheck():
    image = (0.3 + 0.4 * torch.rand(1, 3, 5, 4, generator=torch.Generator().manual_seed(0))).double().requires_grad_()
    strength = torch.full((1,), 0.5, dtype=torch.float64)

    def resampled(x):
        return downsampling(View(x), strength, [torch.Generator().manual_seed(0)]).image

    assert torch.autograd.gradcheck(resampled, (image,))
