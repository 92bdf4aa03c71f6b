import pytest
import torch

from gaussian_enhancer.degrade.artefacts.sensor import CameraProcessing, random_processing, sensor, sensor_noise
from gaussian_enhancer.degrade.artefacts.view import View
from support.generators import spawn_seeded


def colours(dtype):
    """All colours on a grid of 9^3, black and white among them."""
    level = torch.linspace(0, 1, 9, dtype=dtype)
    return torch.cartesian_prod(level, level, level).T.reshape(1, 3, 27, 27)


@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float32, 1e-5), (torch.float64, 1e-6)])
def test_processing_undoes_unprocessing(dtype, tolerance):
    image = colours(dtype).expand(8, -1, -1, -1)
    camera = random_processing(spawn_seeded(8), image)
    torch.testing.assert_close(camera.process(camera.unprocess(image)), image, rtol=0, atol=tolerance)


def test_the_sensor_sees_a_darker_signal_within_its_range():
    image = colours(torch.float64).expand(8, -1, -1, -1)
    raw = random_processing(spawn_seeded(8), image).unprocess(image)
    assert raw.min() >= 0
    assert raw.max() <= 1
    assert (raw[:, 0].amax((1, 2)) < 0.6).all()


def test_known_values_of_a_camera_without_colours_of_its_own():
    one = CameraProcessing(torch.ones(1, 3), torch.eye(3)[None])
    grey = torch.full((1, 3, 1, 1), 0.5)
    # 3 x^2 - 2 x^3 = 0.5 at x = 0.5, and 0.5^2.2 is the linear value.
    torch.testing.assert_close(one.unprocess(grey), torch.full_like(grey, 0.5**2.2))


def test_greys_stay_grey_in_any_colour_matrix():
    matrix = random_processing(spawn_seeded(8), torch.zeros(1, 3, 1, 1)).matrix
    torch.testing.assert_close(matrix.sum(2), torch.ones(8, 3))
    assert (matrix.diagonal(dim1=1, dim2=2) > 1.29).all()
    assert (matrix[:, ~torch.eye(3, dtype=torch.bool)] < -0.05).all()
    assert torch.linalg.inv(matrix).min() > -1e-6


def test_noise_has_the_variance_of_shot_and_read():
    count, level = 6, (0.05, 0.4)
    spread = []
    for value in level:
        raw = torch.full((count, 3, 128, 128), value)
        spread.append(sensor_noise(raw, torch.ones(count), spawn_seeded(count))[:, 1, ::2, 1::2].flatten(1).var(dim=1))
    # Green lies at these places: the noise there is not interpolated. The line through both is shot x + read.
    shot = (spread[1] - spread[0]) / (level[1] - level[0])
    assert (shot > 0.15e-3).all()
    assert (shot < 2.4e-3).all()
    read = spread[0] - shot * level[0]
    assert (read < 1e-4).all()
    half = sensor_noise(raw, torch.full((count,), 0.5), spawn_seeded(count))
    torch.testing.assert_close(2 * half, sensor_noise(raw, torch.ones(count), spawn_seeded(count)))


def test_noise_between_the_sites_is_smoother():
    drawn = sensor_noise(torch.full((1, 3, 64, 64), 0.3), torch.ones(1), spawn_seeded(1))
    assert drawn[0, 0, 1::2, 1::2].std() < 0.7 * drawn[0, 0, ::2, ::2].std()


def test_the_gradient_is_that_of_added_noise():
    image = torch.full((1, 3, 9, 11), 0.5, dtype=torch.float64).requires_grad_()
    sensor(View(image), torch.full((1,), 0.3, dtype=torch.float64), spawn_seeded(1)).image.sum().backward()
    assert torch.equal(image.grad, torch.ones_like(image))
