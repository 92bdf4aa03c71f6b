"""The compiled forms against the readable ones in double precision, which gradients and other devices use."""

import math

import pytest
import torch

from gaussian_enhancer.align import projection
from gaussian_enhancer.align.alignment import LoadedView, Reprojected
from gaussian_enhancer.align.projection import (
    ProjectedPixels,
    ReferenceProjection,
    depth_consistency,
    project_pixels,
    sample_projected,
    sample_projected_pair,
)
from gaussian_enhancer.align.reproject import _median_footprint, reproject
from gaussian_enhancer.types import Camera
from support.textured_plane import REFERENCE, TARGET, plane, turned

SMALL = REFERENCE.resized(60, 70)  # of another shape than the target's 48x64
CAMERAS = {
    "beside": SMALL,
    "behind": turned(SMALL, math.pi, (0.0, 0.0, 0.0)),
    "askew": turned(SMALL, -0.5, (1.5, 0.3, 0.5)),
}


def maps(dtype: torch.dtype, camera: Camera) -> tuple[ReferenceProjection, torch.Tensor]:
    depth = plane(TARGET, 3.0)[1]
    depth[..., :9, :9] *= 0.2
    depth = depth.to(dtype)
    return ReferenceProjection.between(TARGET, camera, depth), depth


@pytest.mark.parametrize("name", CAMERAS)
def test_landing_agrees(name, monkeypatch):
    found, truth = (
        project_pixels(*maps(torch.float32, CAMERAS[name])),
        project_pixels(*maps(torch.float64, CAMERAS[name])),
    )
    assert torch.equal(found.inside.double(), truth.inside)
    assert (name == "behind") == (truth.inside.sum() == 0)
    shown = truth.inside > 0
    for axis in ("x", "y"):
        torch.testing.assert_close(
            getattr(found, axis)[shown].double(), getattr(truth, axis)[shown], rtol=1e-5, atol=1e-4
        )


@pytest.mark.parametrize("name", CAMERAS)
def test_depth_agreement_agrees(name):
    seen = plane(CAMERAS[name].resized(30, 50), 3.0)[1]
    seen[..., 10:20, 10:30] = 0  # where the reference shows nothing, nothing speaks against the target
    seen[..., 20:, :] *= 1.1
    results = [
        depth_consistency(*maps(dtype, CAMERAS[name]), seen.to(dtype), 0.05) for dtype in (torch.float32, torch.float64)
    ]
    # A position that lies between two pixels may round to either.
    assert ((results[0] - results[1]).abs() > 1e-4).double().mean() < 0.01
    if name != "behind":
        assert 0.1 < results[1].mean() < 0.95


@pytest.mark.parametrize("channels", [1, 3])
def test_reading_agrees(channels):
    image = torch.rand(channels, 31, 45, dtype=torch.float64)
    read = []
    for dtype in (torch.float32, torch.float64):
        landing = project_pixels(*maps(dtype, SMALL))
        where = landing.inside * (landing.x > 20)
        read.append(sample_projected(image.to(dtype), landing, (SMALL.height, SMALL.width), where))
    torch.testing.assert_close(read[0].double(), read[1], rtol=0, atol=1e-4)
    assert 0.1 < (read[1][0] == 0).double().mean() < 0.9


def test_eight_bits_are_read_as_numbers():
    image = (torch.rand(3, 31, 45) * 255).byte()
    landing = project_pixels(*maps(torch.float32, SMALL))
    how = landing, (SMALL.height, SMALL.width), landing.inside
    torch.testing.assert_close(sample_projected(image, *how), sample_projected(image.float(), *how), rtol=0, atol=1e-3)
    double = ProjectedPixels(landing.x.double(), landing.y.double(), landing.inside.double())
    twin = sample_projected(image, double, how[1], double.inside)
    torch.testing.assert_close(sample_projected(image, *how).double(), twin, rtol=0, atol=0.05)
    with pytest.raises(ValueError, match="bilinearly"):
        sample_projected(image, *how, "bicubic")


@pytest.mark.parametrize("sides", [(31, 45), (16, 20)])
def test_two_images_are_read_as_each_is_alone(sides):
    image, other = torch.rand(3, 31, 45), torch.rand(3, *sides)
    landing = project_pixels(*maps(torch.float32, SMALL))
    where = landing.inside * (landing.x > 20)
    for interpolation in ("bilinear", "bicubic"):
        how = landing, (SMALL.height, SMALL.width), where, interpolation
        for found, one in zip(sample_projected_pair(image, other, *how), (image, other), strict=True):
            torch.testing.assert_close(found, sample_projected(one, *how), rtol=0, atol=1e-6)
            torch.testing.assert_close(found.double(), sample_projected(one.double(), *how).double(), rtol=0, atol=1e-4)


def test_the_border_is_continued():
    image = torch.arange(6.0).reshape(1, 2, 3)
    x, y = torch.tensor([[[-4.0, 0.0, 3.0, 9.0]]]), torch.tensor([[[0.2, 2.0, 2.0, 5.0]]])
    landing = ProjectedPixels(x, y, torch.ones_like(x))
    read = sample_projected(image, landing, (2, 3), torch.ones_like(x))
    torch.testing.assert_close(read[0, 0], torch.tensor([0.0, 3.0, 5.0, 5.0]))
    torch.testing.assert_close(sample_projected(image.double(), landing, (2, 3), torch.ones_like(x)).float(), read)


def test_gradients_reach_the_photo_and_the_depth():
    photo, depth = (part.float().requires_grad_() for part in plane(TARGET, 3.0))
    reproject(TARGET, depth, SMALL, photo).colour.sum().backward()
    assert photo.grad is not None
    assert depth.grad is not None
    assert photo.grad.abs().sum() > 0
    assert depth.grad.abs().sum() > 0
    with torch.no_grad():
        assert projection.can_use_kernels(photo, depth)


def test_the_footprint_of_large_views_is_sampled():
    """Some 65,000 pixels tell as much as all: the photo is read at three of its pixels a step."""
    sides = 700, 900
    x, y = torch.arange(sides[1], dtype=torch.float32) * 3, torch.arange(sides[0], dtype=torch.float32)[:, None] * 3
    landing = ProjectedPixels(x.expand(1, *sides), y.expand(1, *sides).contiguous(), torch.ones(1, *sides))
    assert _median_footprint(landing) == pytest.approx(3)


def view(camera: Camera, distance: float) -> LoadedView:
    image, depth = (part.float() for part in plane(camera, distance))
    return LoadedView("view", image, camera, depth, torch.ones_like(depth), image)


@pytest.mark.cuda
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_alignment_on_a_device_equals_that_on_the_processor():
    target, reference = view(TARGET, 3.0), view(REFERENCE.resized(48, 64), 3.0)
    here = Reprojected()(target, [reference], 1)
    there = Reprojected()(target.to_device(torch.device("cuda")), [reference.to_device(torch.device("cuda"))], 1)
    assert there.references.device.type == "cuda"
    torch.testing.assert_close(there.references.cpu(), here.references, rtol=0, atol=0.02)
    torch.testing.assert_close(there.visibility.cpu(), here.visibility, rtol=0, atol=0.02)
