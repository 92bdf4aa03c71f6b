"""A scene's unit of length changes no enhanced image."""

import dataclasses

import pytest
import torch
from torch import nn

from gaussian_enhancer.align.alignment import Reprojected
from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.network.ssif_lr import SSIFLR
from gaussian_enhancer.scene.procedural import procedural_scene
from gaussian_enhancer.scene.rendered import RenderedSet, RenderedView
from gaussian_enhancer.types import Camera, quantise_8_bit

VIEWS = 5


@pytest.fixture(scope="module")
def scene() -> RenderedSet:
    """Views of a procedural room, blurred as renders are, with exact depth."""
    photos = procedural_scene("indoor", seed=3, views=VIEWS, width=64, height=48).photos
    return RenderedSet("room", tuple(map(_view, photos[:1])), tuple(map(_view, photos[1:])))


def _view(photo) -> RenderedView:
    image = photo.read()
    render = nn.functional.avg_pool2d(image[None], 3, 1, 1, count_include_pad=False)[0]
    depth = photo.read_depth()
    return RenderedView(
        photo.name, lambda: render, photo.camera, lambda: depth, lambda: torch.ones_like(depth), lambda: image
    )


def scaled(rendered: RenderedSet, unit: float) -> RenderedSet:
    def view(one: RenderedView) -> RenderedView:
        pose = one.camera.world_to_camera.clone()
        pose[:3, 3] *= unit
        camera = Camera(one.camera.K, pose, one.camera.height, one.camera.width)
        return dataclasses.replace(one, camera=camera, read_depth=lambda: one.read_depth() * unit)

    sides = (tuple(map(view, side)) for side in (rendered.targets, rendered.references))
    return RenderedSet(rendered.name, *sides)


def enhanced(rendered: RenderedSet, depth: str) -> list[torch.Tensor]:
    torch.manual_seed(0)
    network = SSIFLR((8, 8, 8), (1, 1, 1))
    for module in network.modules():  # so that depth and references tell
        if isinstance(module, nn.Conv2d) and not module.weight.any():
            nn.init.normal_(module.weight, std=0.05)
    enhancer = SetEnhancer(network, ReferenceConfig(Reprojected(depth=depth)), precision="float32")
    return [quantise_8_bit(one.image) for one in enhancer(rendered)]


@pytest.mark.parametrize("unit", [1e-8, 1e-4, 1e6])
@pytest.mark.parametrize("depth", ["surface", "expected"])
def test_the_unit_changes_no_enhanced_image(scene, unit, depth):
    for usual, other in zip(enhanced(scene, depth), enhanced(scaled(scene, unit), depth), strict=True):
        assert float((usual - scene.targets[0].read()).abs().mean()) > 0.01
        change = (other - usual).abs()
        assert float(change.max()) <= 2 / 255 + 1e-6
        assert float((change > 1e-6).float().mean()) < 0.02
