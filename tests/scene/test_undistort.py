import signal
import subprocess
import sys

import numpy as np
import pytest
import torch

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.undistort import Lens, distort, ideal_pinhole, undistort
from support.captures_on_disk import CX, CY, FX, FY, HEIGHT, WIDTH, dot_centre, dot_image, fisheye, opencv, pinhole

HEAD = (FX, FY, CX, CY)
LENSES = {
    "OPENCV": ((*HEAD, -0.12, 0.03, 0.004, -0.003), opencv(-0.12, 0.03, 0.004, -0.003)),
    "FULL_OPENCV": ((*HEAD, 0.1, -0.02, 0.002, 0.001, 0.0, 0.0, 0.0, 0.0), opencv(0.1, -0.02, 0.002, 0.001)),
    "OPENCV_FISHEYE": ((*HEAD, 0.02, -0.01, 0.0, 0.0), fisheye(0.02, -0.01)),
}


def lens_of(model):
    return Lens(model, WIDTH, HEIGHT, LENSES[model][0])


@pytest.mark.parametrize("model", LENSES)
def test_forward_model_is_the_published_one(model):
    lens, seen = lens_of(model), LENSES[model][1]
    rays = np.random.default_rng(0).uniform(-0.4, 0.4, (20, 2))
    local = np.concatenate([rays, np.ones((20, 1))], 1)
    K, _, _ = ideal_pinhole(lens)
    ideal = torch.from_numpy(local) @ K.T
    expected = np.stack([seen(ray) for ray in local])
    np.testing.assert_allclose(distort(ideal[:, :2], K, lens).numpy(), expected, atol=1e-6)


@pytest.mark.parametrize("params", [("SIMPLE_RADIAL", (FX, CX, CY, -0.1)), ("RADIAL", (FX, CX, CY, -0.1, 0.02))])
def test_radial_models_bend_by_their_polynomial(params):
    model, values = params
    lens = Lens(model, WIDTH, HEIGHT, values)
    K = torch.tensor([[FX, 0, CX], [0, FX, CY], [0, 0, 1]], dtype=torch.float64)
    x = 0.3
    k2 = values[4] if len(values) > 4 else 0
    expected = FX * x * (1 - 0.1 * x**2 + k2 * x**4) + CX
    seen = distort(torch.tensor([[FX * x + CX, CY]], dtype=torch.float64), K, lens)
    torch.testing.assert_close(seen, torch.tensor([[expected, CY]], dtype=torch.float64))


@pytest.mark.parametrize("model", LENSES)
def test_undistorted_dots_lie_where_a_pinhole_sees_them(model):
    lens, seen = lens_of(model), LENSES[model][1]
    K, height, width = ideal_pinhole(lens)
    for x, y in [(-0.25, -0.2), (0.3, 0.1), (0.05, 0.22)]:
        ray = np.array([x, y, 1.0])
        photo = torch.from_numpy(dot_image(*seen(ray))).float().expand(3, -1, -1).contiguous()
        ideal = undistort(photo, lens)
        assert ideal.shape == (3, height, width)
        np.testing.assert_allclose(dot_centre(ideal.numpy()), (K.numpy() @ ray)[:2], atol=0.12)


@pytest.mark.parametrize("model", LENSES)
def test_no_ideal_pixel_is_blank(model):
    lens = lens_of(model)
    K, height, width = ideal_pinhole(lens)
    y, x = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
    seen = distort(torch.stack([x, y], -1).flatten(0, 1).double(), K, lens)
    assert bool(((seen > -1) & (seen < torch.tensor([WIDTH + 1, HEIGHT + 1]))).all())


@pytest.mark.parametrize("model", ["PINHOLE", "SIMPLE_PINHOLE", "OPENCV"])
def test_ideal_lens_leaves_the_photo_as_it_is(model):
    params = {"PINHOLE": HEAD, "SIMPLE_PINHOLE": (FX, CX, CY), "OPENCV": (*HEAD, 0.0, 0.0, 0.0, 0.0)}[model]
    lens = Lens(model, WIDTH, HEIGHT, params)
    photo = torch.rand(3, HEIGHT, WIDTH)
    assert undistort(photo, lens) is photo
    K, height, width = ideal_pinhole(lens)
    assert (height, width) == (HEIGHT, WIDTH)
    assert tuple(K[:2, 2].tolist()) == (CX, CY)
    np.testing.assert_allclose(K[0, 0], FX)


def test_resized_lens_sees_the_same_rays():
    lens = lens_of("OPENCV")
    small = lens.resized(HEIGHT // 2, WIDTH // 2)
    K = torch.tensor([[FX, 0, CX], [0, FY, CY], [0, 0, 1]], dtype=torch.float64)
    half = torch.diag(torch.tensor([0.5, 0.5, 1.0], dtype=torch.float64)) @ K
    points = torch.tensor([[5.0, 7.0], [50.0, 40.0]], dtype=torch.float64)
    torch.testing.assert_close(distort(points / 2, half, small) * 2, distort(points, K, lens))


@pytest.mark.parametrize(
    ("model", "params", "message"),
    [
        ("PINHOLE", (0.0, FY, CX, CY), "focal length 0"),
        ("PINHOLE", (-5.0, FY, CX, CY), "focal length -5"),
        ("PINHOLE", (float("nan"), FY, CX, CY), "finite"),
        ("PINHOLE", (FX, FY, CX), "3 parameters for PINHOLE"),
        ("PANORAMA", HEAD, "PANORAMA"),
        ("EQUIRECTANGULAR", (64.0, 48.0), "no focal length"),
    ],
)
def test_impossible_lenses_are_refused(model, params, message):
    with pytest.raises(InputError, match=message):
        Lens(model, WIDTH, HEIGHT, params, "camera 7")


def test_lens_that_folds_over_is_refused():
    lens = Lens("SIMPLE_RADIAL", WIDTH, HEIGHT, (20.0, 32.0, 24.0, -0.9), "camera 7")
    with pytest.raises(InputError, match=r"camera 7.*fold"):
        ideal_pinhole(lens)


def test_a_process_with_lens_models_ends_when_it_is_told_to():
    """glog's handler would print a stack trace, and can wait for ever where memory is being allocated."""
    said = "import os, signal; from gaussian_enhancer.scene.undistort import load_pycolmap; load_pycolmap(); "
    ended = subprocess.run([sys.executable, "-c", said + "os.kill(os.getpid(), signal.SIGTERM)"], capture_output=True)
    assert ended.returncode == -signal.SIGTERM
    assert ended.stderr == b""


def test_pinhole_formula_of_the_fixtures_agrees():
    ray = np.array([0.1, -0.2, 1.0])
    np.testing.assert_allclose(pinhole(ray), opencv(0, 0, 0, 0)(ray))
