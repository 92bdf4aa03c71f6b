"""Source views of IBGS: the photos that a view refers to, and their colours and camera features at its pixels.

Axes: m source views, n pixels, h height, w width.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from gaussian_enhancer.align.alignment import LoadedView
from gaussian_enhancer.align.references import ReferencePool
from gaussian_enhancer.align.reproject import reproject
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.metrics.image_quality import fit_colour_map
from gaussian_enhancer.scene.rendered import RenderedView
from gaussian_enhancer.types import Camera

CAMERA_FEATURES = 4
MIN_PIXELS = 500
"""Least number of visible pixels from which a photo's exposure is estimated."""


@dataclass(frozen=True)
class Sources:
    """The source views of a target, nearest first, on the target's grid.

    Args:
        colours: of the photos, 0 where they are not used.
        cameras: camera features of each source: the difference of the unit viewing directions, source minus target,
            and the logarithm of the ratio of the distances to the surface; 0 where the source is not used.
        visible: where a source is used: it shows the target's surface and is among the first that do.
        rays: unit viewing directions of the target's pixels in the world.
        names: of the source views.
    """

    colours: Float[Tensor, "m 3 h w"]
    cameras: Float[Tensor, "m 4 h w"]
    visible: Bool[Tensor, "m 1 h w"]
    rays: Float[Tensor, "3 h w"]
    names: tuple[str, ...]


@dataclass(frozen=True)
class SourceChoice:
    """How source views are chosen.

    Args:
        candidates: source views of a target at most.
        visible: sources that are used at a pixel at most, the nearest first.
        angle: between the optical axes of target and source, in degrees, below which a source is a candidate.
        tolerance: largest relative difference between a point's depth in a source and the depth rendered there at
            which the point counts as visible.
    """

    candidates: int = 4
    visible: int = 3
    angle: float = 30.0
    tolerance: float = 0.01

    def __post_init__(self) -> None:
        for name in ("candidates", "visible", "angle", "tolerance"):
            if not getattr(self, name) > 0:
                raise InputError(name, f"is {getattr(self, name)}", "give a number above 0")

    def nearest(self, target: RenderedView, views: Sequence[RenderedView]) -> tuple[int, ...]:
        """Indices of the candidates among training views, nearest camera first; a view is never its own source.

        Args:
            target: a view of the same capture.
            views: training views.

        Raises:
            InputError: a view has no camera.
        """
        camera = camera_of(target.name, target.camera)
        candidates = []
        for index, view in enumerate(views):
            if view.name == target.name:
                continue
            source = camera_of(view.name, view.camera)
            cosine = float(camera.forward.double() @ source.forward.double())
            if cosine > math.cos(math.radians(self.angle)):
                candidates.append((float((camera.centre - source.centre).norm()), index))
        return tuple(index for _, index in sorted(candidates)[: self.candidates])

    def sources(self, view: RenderedView, target: LoadedView, pool: ReferencePool) -> Sources:
        """The source views of a target.

        Args:
            view: the target.
            target: its pixels.
            pool: training views.

        Raises:
            InputError: a view has no camera or depth.
        """
        camera = camera_of(view.name, target.camera)
        if target.depth is None:
            raise InputError(view.name, "has no depth to find source pixels by", "give fits with depth")
        points, rays, distances = surface_points(camera, target.depth)
        chosen = [pool.read(index) for index in self.nearest(view, pool.views)]
        height, width = target.image.shape[-2:]
        colours, cameras = target.image.new_zeros(len(chosen), 3, height, width), rays.new_zeros(0, 4, height, width)
        visible = torch.zeros(len(chosen), 1, height, width, dtype=torch.bool)
        for i, source in enumerate(chosen):
            source_camera = camera_of(source.name, source.camera)
            if source.depth is None:
                raise InputError(source.name, "has no depth, which visibility requires", "give fits with depth")
            pixels = source.image, source.depth
            warped = reproject(camera, target.depth, source_camera, *pixels, tolerance=self.tolerance)
            colours[i] = warped.colour
            visible[i] = warped.visibility >= math.exp(-0.5)  # one standard deviation is the tolerance
            cameras = torch.cat([cameras, camera_features(points, rays, distances, source_camera)[None]])
        used = visible & (visible.cumsum(0) <= self.visible)
        return Sources(colours * used, cameras * used, used, rays, tuple(source.name for source in chosen))


def surface_points(
    camera: Camera, depth: Float[Tensor, "1 h w"]
) -> tuple[Float[Tensor, "3 h w"], Float[Tensor, "3 h w"], Float[Tensor, "1 h w"]]:
    """Points of the surface in the world, the unit directions in which the camera sees them, and their distances."""
    height, width = depth.shape[-2:]
    x, y = torch.arange(width) + 0.5, torch.arange(height)[:, None] + 0.5
    pixels = torch.stack([x.expand(height, width), y.expand(height, width), torch.ones(height, width)])
    intrinsics = camera.resized(height, width).K.double()
    slopes = camera.rotation.double().T @ torch.linalg.inv(intrinsics) @ pixels.double().flatten(1)
    slopes = slopes.view(3, height, width)
    length = slopes.norm(dim=0, keepdim=True)
    points = camera.centre.double()[:, None, None] + depth.double() * slopes
    return points.float(), (slopes / length).float(), (depth.double() * length).float()


def camera_features(
    points: Float[Tensor, "3 h w"], rays: Float[Tensor, "3 h w"], distances: Float[Tensor, "1 h w"], source: Camera
) -> Float[Tensor, "4 h w"]:
    """Camera features of points: how another camera sees them, relative to the target.

    Args:
        points: in the world.
        rays: unit directions in which the target sees them.
        distances: their distances from the target.
        source: the camera of a source view.
    """
    from_source = points - source.centre[:, None, None]
    distance = from_source.norm(dim=0, keepdim=True).clamp_min(1e-9)
    return torch.cat([from_source / distance - rays, (distance / distances.clamp_min(1e-9)).log()])


def exposure_map(render: Float[Tensor, "3 h w"], sources: Sources) -> Float[Tensor, "3 4"]:
    """The affine colour map from the render to the nearest photo, by least squares over the photo's visible pixels.

    It is the identity if no photo has `MIN_PIXELS` visible pixels.

    Args:
        render: of the target.
        sources: of the target.
    """
    for colours, visible in zip(sources.colours, sources.visible[:, 0], strict=True):
        if int(visible.sum()) >= MIN_PIXELS:
            return fit_colour_map(render[:, visible].double(), colours[:, visible].double()).float()
    return torch.eye(3, 4)


def mapped_colours(image: Float[Tensor, "*b 3 h w"], mapping: Float[Tensor, "*b 3 4"]) -> Float[Tensor, "*b 3 h w"]:
    """Apply an affine colour map to an image, or to each image of a batch."""
    return torch.einsum("...ij,...jhw->...ihw", mapping[..., :3], image) + mapping[..., 3:, None]


def camera_of(name: str, camera: Camera | None) -> Camera:
    """A view's camera.

    Raises:
        InputError: there is none.
    """
    if camera is None:
        raise InputError(name, "has no camera", "give fits with cameras")
    return camera
