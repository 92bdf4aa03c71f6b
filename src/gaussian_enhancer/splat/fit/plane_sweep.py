"""Depth of training photos by plane sweep, and from it coloured points to start a splat on.

Axes: d inverse depths, h height, w width (of the reduced photos), p points. Every view is compared with its best
neighbours at inverse depths in equal steps; what neighbouring views confirm becomes points.
Source: Collins, A Space-Sweep Approach to True Multi-Image Matching, CVPR 1996; smoothed as in
Hirschmueller, TPAMI 2008.
"""

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.scene import Points
from gaussian_enhancer.splat.fit.geometry import focus_distance, matching_cost
from gaussian_enhancer.typed import check_fields
from gaussian_enhancer.types import Camera


@dataclass(frozen=True)
class SweepSettings:
    """How finely and how strictly depth is searched.

    Args:
        planes: inverse depths that are tried.
        neighbours: views that each view is compared with.
        reduction: photos are made smaller by this whole factor first; 0 chooses about 40,000 pixels.
        radius: half the side of the comparison window, in reduced pixels.
        smoothness: price of a depth step of one plane, in units of colour difference; 0 smooths nothing.
        agreement: largest relative difference of inverse depth that confirms a neighbour's, besides one plane.
        confirmations: number of neighbours that must confirm a depth.
        views: largest number of photos that are swept; more are thinned out evenly.
    """

    planes: int = 96
    neighbours: int = 3
    reduction: int = 0
    radius: int = 2
    smoothness: float = 0.03
    agreement: float = 0.02
    confirmations: int = 1
    views: int = 60

    def __post_init__(self) -> None:
        check_fields(self, "sweep.")


@dataclass(frozen=True)
class SweptPoints:
    """Points found by the sweep.

    Args:
        points: positions and colours.
        confirmations: number of neighbouring views that hold the same depth.
    """

    points: Points
    confirmations: Float[Tensor, " p"]


@dataclass(frozen=True)
class _View:
    """A reduced photo, channels last, with its camera and its neighbours' indices."""

    image: np.ndarray
    camera: Camera
    neighbours: list[int]


def sweep_points(
    photos: Sequence[Float[Tensor, "3 _ _"]],
    cameras: Sequence[Camera],
    settings: SweepSettings = SweepSettings(),
    *,
    known: Points | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> SweptPoints:
    """Points on the surfaces that several photos agree on, each kept from the first view that saw it.

    Args:
        photos: training photos in [0, 1].
        cameras: their cameras.
        settings: how finely and how strictly.
        known: points that tell how deep the scene is; without them a coarse sweep finds out.
        progress: called with the number of finished views and of all.

    Raises:
        InputError: fewer than two photos.
    """
    every = -(-len(photos) // settings.views)
    photos, cameras = photos[::every], cameras[::every]
    depths_known = _known_depths(known, cameras)
    distance = focus_distance(cameras) if depths_known is None else float(depths_known.median())
    views = _views(photos, cameras, distance, settings)
    coarse_depths = _coarse_depths(views, distance, settings) if depths_known is None else depths_known
    near, far = _depth_range(coarse_depths, distance)
    inverse = torch.linspace(1 / far, 1 / near, settings.planes, dtype=torch.float64)
    depths = []
    for number, view in enumerate(views):
        depths.append(inverse_depth(view.image, view.camera, *_neighbour_images(views, view), inverse, settings))
        if progress is not None:
            progress(number + 1, len(views))
    step = float(inverse[1] - inverse[0])
    return _merge_confirmed(views, depths, step, settings)


def sweep_depths(
    images: Sequence[Float[Tensor, "3 _ _"]],
    cameras: Sequence[Camera],
    sources: int,
    known: Points,
    settings: SweepSettings = SweepSettings(),
    *,
    progress: Callable[[int, int], None] | None = None,
) -> list[Float[Tensor, "1 h w"]]:
    """Depth of every pixel of images that are compared with the last ones of them: renders with photos.

    Args:
        images: in [0, 1].
        cameras: theirs, of the images' sizes.
        sources: how many of the images, the last ones, others are compared with.
        known: points that tell how deep the scene is.
        settings: how finely; what confirms a depth has no effect.
        progress: called with the number of finished images and of all.

    Returns:
        z of each image on its own pixels, or on the reduced pixels that were compared where it is larger.

    Raises:
        InputError: fewer than two images, or all cameras lie at one place.
    """
    depths_known = _known_depths(known, cameras)
    distance = focus_distance(cameras) if depths_known is None else float(depths_known.median())
    views = _views(images, cameras, distance, settings, len(images) - sources)
    near, far = _depth_range(torch.empty(0) if depths_known is None else depths_known, distance)
    inverse = torch.linspace(1 / far, 1 / near, settings.planes, dtype=torch.float64)
    depths = []
    for number, view in enumerate(views):
        depths.append(
            1 / inverse_depth(view.image, view.camera, *_neighbour_images(views, view), inverse, settings)[None]
        )
        if progress is not None:
            progress(number + 1, len(views))
    return depths


def inverse_depth(
    image: np.ndarray,
    camera: Camera,
    others: np.ndarray,
    other_cameras: Sequence[Camera],
    inverse: Float[Tensor, " d"],
    settings: SweepSettings = SweepSettings(),
) -> Float[Tensor, "h w"]:
    """Inverse depth of every pixel of a view.

    The plane z = 1/q of the view maps onto a neighbour by H = K' (R + q t e_z^T) K^-1, (R, t) the relative pose.

    Args:
        image: the view, (h, w, 3) float32.
        camera: its camera.
        others: neighbours, (j, H, W, 3) float32.
        other_cameras: their cameras.
        inverse: ascending inverse depths to try, in equal steps.
        settings: window and smoothness.
    """
    from gaussian_enhancer.splat.fit import plane_sweep_kernels as kernels

    homographies = _homographies(camera, other_cameras, inverse)
    volume = np.empty((*image.shape[:2], len(inverse)), np.float32)
    kernels.cost_volume(image, others, homographies, settings.radius, volume)
    if settings.smoothness > 0:
        total = np.zeros_like(volume)
        small = np.float32(settings.smoothness)
        kernels.smooth(volume, image, small, np.float32(8 * small), total)
        volume = total
    index = np.empty(image.shape[:2], np.float32)
    kernels.best_plane(volume, index)
    return (inverse[0] + torch.from_numpy(index) * (inverse[1] - inverse[0])).float()


def _views(
    photos: Sequence[Tensor], cameras: Sequence[Camera], distance: float, settings: SweepSettings, first: int = 0
) -> list[_View]:
    """Reduced photos with their neighbours, of those from the first on."""
    if len(photos) < 2:
        raise InputError("plane sweep", f"has {len(photos)} photo", "give at least two training photos")
    centres = torch.stack([camera.centre for camera in cameras])
    cost = matching_cost(centres, torch.stack([c.forward for c in cameras]), distance)
    views = []
    for i, (photo, camera) in enumerate(zip(photos, cameras, strict=True)):
        factor = settings.reduction or max(1, round((camera.height * camera.width / 40_000) ** 0.5))
        height, width = (max(8, side // factor) for side in (camera.height, camera.width))
        image = functional.interpolate(photo[None], (height, width), mode="area")[0]
        # A view at the same place tells nothing about depth: its cost is infinite.
        ranked = [int(j) for j in cost[i].argsort() if j >= first and cost[i, j].isfinite()]
        channels_last = np.ascontiguousarray(image.permute(1, 2, 0).numpy())
        views.append(_View(channels_last, camera.resized(height, width), ranked[: settings.neighbours]))
    if not any(view.neighbours for view in views):
        raise InputError("plane sweep", "found all cameras at one place", "start with init=random")
    return views


def _neighbour_images(views: list[_View], view: _View) -> tuple[np.ndarray, list[Camera]]:
    """The neighbours' images on a common canvas (photos of a scene may differ in size) and their cameras."""
    chosen = [views[j] for j in view.neighbours]
    height = max((v.image.shape[0] for v in chosen), default=1)
    width = max((v.image.shape[1] for v in chosen), default=1)
    canvas = np.zeros((len(chosen), height, width, 3), np.float32)
    for k, v in enumerate(chosen):
        canvas[k, : v.image.shape[0], : v.image.shape[1]] = v.image
    return canvas, [v.camera for v in chosen]


def _homographies(camera: Camera, others: Sequence[Camera], inverse: Tensor) -> np.ndarray:
    back = torch.linalg.inv(camera.K.double())
    maps = []
    for other in others:
        relative = other.world_to_camera.double() @ torch.linalg.inv(camera.world_to_camera.double())
        planes = relative[:3, :3].repeat(len(inverse), 1, 1)
        planes[:, :, 2] += inverse[:, None].double() * relative[:3, 3]
        maps.append(other.K.double() @ planes @ back)
    return torch.stack(maps, 1).float().numpy()


def _known_depths(known: Points | None, cameras: Sequence[Camera]) -> Tensor | None:
    """Depths of known points in all cameras that see them; None where they are too few to tell."""
    if known is None or len(known.positions) < 100:
        return None
    depths = torch.cat([_seen_depths(known.positions, camera) for camera in cameras])
    return depths if len(depths) >= 100 else None


def _seen_depths(positions: Tensor, camera: Camera) -> Tensor:
    local = positions @ camera.rotation.T + camera.world_to_camera[:3, 3]
    pixels = local @ camera.K.T
    x, y = pixels[:, 0] / pixels[:, 2], pixels[:, 1] / pixels[:, 2]
    in_image = (pixels[:, 2] > 0) & (x >= 0) & (x < camera.width) & (y >= 0) & (y < camera.height)
    return local[in_image, 2]


def _coarse_depths(views: list[_View], distance: float, settings: SweepSettings) -> Tensor:
    """Depths that a sweep of small images over a wide range confirms twice; empty where it confirms too few."""
    wide = torch.linspace(0.02 / distance, 4.0 / distance, settings.planes, dtype=torch.float64)
    coarse = [_reduce_photo(view) for view in views]
    depths = [inverse_depth(v.image, v.camera, *_neighbour_images(coarse, v), wide, settings) for v in coarse]
    strict = dataclasses.replace(settings, confirmations=2)
    positions = _merge_confirmed(coarse, depths, float(wide[1] - wide[0]), strict).points.positions
    found = torch.cat([_seen_depths(positions, view.camera) for view in coarse])
    return found if len(positions) >= 100 else found[:0]


def _depth_range(depths: Tensor, distance: float) -> tuple[float, float]:
    """Nearest and farthest depth to search: the range of known depths with a margin, or a wide guess."""
    if len(depths) == 0:
        return distance / 4, distance * 50
    inverse = 1 / depths[:: -(-len(depths) // 1_000_000)].double()
    near, far = float(inverse.quantile(0.99)), float(inverse.quantile(0.01))
    return 1 / (1.3 * near), 1 / (0.6 * far)


def _reduce_photo(view: _View) -> _View:
    image = np.ascontiguousarray(view.image[::2, ::2])
    return _View(image, view.camera.resized(*image.shape[:2]), view.neighbours)


def _merge_confirmed(views: list[_View], depths: list[Tensor], step: float, settings: SweepSettings) -> SweptPoints:
    """Keep points that enough neighbours confirm and that no earlier view has given."""
    positions, colours, confirmations = [], [], []
    for i, view in enumerate(views):
        world = _unproject(view.camera, depths[i])
        confirmed = torch.zeros(len(world))
        merged = torch.zeros(len(world), dtype=torch.bool)
        for j in view.neighbours:
            agrees = _agrees_at(world, views[j].camera, depths[j], step, settings)
            confirmed += agrees
            if j < i:
                merged |= agrees
        keep = (confirmed >= min(settings.confirmations, len(view.neighbours))) & ~merged
        positions.append(world[keep])
        colours.append(torch.from_numpy(view.image).reshape(-1, 3)[keep])
        confirmations.append(confirmed[keep])
    return SweptPoints(Points(torch.cat(positions), torch.cat(colours)), torch.cat(confirmations))


def _agrees_at(world: Tensor, camera: Camera, inverse: Tensor, step: float, settings: SweepSettings) -> Tensor:
    """Whether a view's inverse depth map holds each point at its inverse depth."""
    local = world @ camera.rotation.T + camera.world_to_camera[:3, 3]
    pixels = local @ camera.K.T
    depth = pixels[:, 2].clamp(min=1e-9)
    x, y = (pixels[:, 0] / depth).long(), (pixels[:, 1] / depth).long()
    inside = (pixels[:, 2] > 0) & (x >= 0) & (y >= 0) & (x < inverse.shape[1]) & (y < inverse.shape[0])
    sampled = inverse[y.clamp(0, inverse.shape[0] - 1), x.clamp(0, inverse.shape[1] - 1)]
    return inside & ((1 / depth - sampled).abs() < torch.clamp(settings.agreement * sampled, min=step))


def _unproject(camera: Camera, inverse: Tensor) -> Tensor:
    """World position of every pixel's surface, row by row."""
    height, width = inverse.shape
    y, x = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
    rays = torch.stack([x, y, torch.ones_like(x)], -1).reshape(-1, 3) @ torch.linalg.inv(camera.K).T
    return (rays / inverse.reshape(-1, 1) - camera.world_to_camera[:3, 3]) @ camera.rotation
