import dataclasses
import itertools
import math

import pytest
import torch

from ablations.studies.consistency import FrameGeometry, WarpedError, sequence_errors, warped_error
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.types import Camera
from support.synthetic_runs import plane_camera, plane_view


def moved(camera: Camera, shift: float) -> Camera:
    pose = camera.world_to_camera.clone()
    pose[0, 3] -= shift
    return dataclasses.replace(camera, world_to_camera=pose)


def film(frames: int = 6, texture: torch.Tensor | None = None) -> tuple[list[torch.Tensor], list[FrameGeometry]]:
    """A smooth plane seen by a camera that moves sideways."""
    if texture is None:
        coarse = torch.rand(1, 3, 5, 5, generator=torch.Generator().manual_seed(0))
        texture = torch.nn.functional.interpolate(coarse, size=(192, 192), mode="bicubic")[0].clamp(0.1, 0.9)
    images, places = [], []
    for t in range(frames):
        camera = moved(plane_camera(0, 32, 48), 0.04 * t)
        image, depth = plane_view(camera, texture)
        images.append(image)
        places.append(FrameGeometry(camera, depth, torch.ones_like(depth)))
    return images, places


def test_what_geometry_explains_is_no_flicker():
    images, places = film()
    errors = sequence_errors(images, places)
    assert len(errors) == 5
    still = [float((a - b).abs().mean()) for a, b in itertools.pairwise(images)]
    assert all(error.visible > 0.9 for error in errors)
    assert max(error.mean for error in errors) < 0.004  # 8 bits and bilinear reading
    assert min(still) > 5 * max(error.mean for error in errors)


def test_constant_offset_is_measured_exactly():
    texture = torch.full((3, 192, 192), 0.4)
    images, places = film(2, texture)
    offset = 20 / 255
    error = warped_error(images[0], places[0], images[1] + offset, places[1])
    assert error.mean == pytest.approx(offset, abs=1e-6)
    assert error.rms == pytest.approx(offset, abs=1e-6)
    assert error.decibel == pytest.approx(-20 * math.log10(offset), abs=1e-3)


def test_flickering_frame_is_found():
    images, places = film()
    temporal_smoothing = sequence_errors(images, places)
    images[3] = images[3] + 0.1 * torch.rand(images[3].shape, generator=torch.Generator().manual_seed(1))
    errors = [error.mean for error in sequence_errors(images, places)]
    for t, before in enumerate(temporal_smoothing):
        if t in (2, 3):
            assert errors[t] > before.mean + 0.03
        else:
            assert errors[t] == before.mean


def test_hidden_surface_is_not_compared():
    images, places = film(2)
    left = torch.arange(48)[None, None] < 24
    nearer = dataclasses.replace(places[1], depth=torch.where(left, 0.5 * places[1].depth, places[1].depth))
    spoilt = torch.where(left, torch.ones_like(images[1]), images[1])
    error = warped_error(images[0], places[0], spoilt, nearer)
    assert 0.3 < error.visible < 0.6
    assert error.mean < 0.004
    assert warped_error(images[0], places[0], spoilt, places[1]).mean > 0.1


def test_what_is_not_there_is_not_compared():
    images, places = film(2)
    empty = dataclasses.replace(places[0], alpha=torch.zeros_like(places[0].depth))
    error = warped_error(images[0], empty, images[1], places[1])
    assert math.isnan(error.mean)
    assert error.visible == 0


def test_equal_frames_agree_without_bound():
    images, places = film(1)
    error = warped_error(images[0], places[0], images[0], places[0])
    assert error.mean < 1e-6
    assert WarpedError(0.0, 0.0, 1.0).decibel == math.inf


def test_wrong_sequences_are_refused():
    images, places = film(3)
    with pytest.raises(InputError, match="one place for each frame"):
        sequence_errors(images[:2], places)
    with pytest.raises(InputError, match="at least two"):
        sequence_errors(images[:1], places[:1])
    with pytest.raises(InputError, match="one size"):
        warped_error(images[0][:, :16], places[0], images[1][:, :16], places[1])
