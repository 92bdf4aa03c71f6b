"""Depth of training photos by plane sweep, and coloured points from it on which a fit can start.

Axes: d inverse depths, h height, w width (of the reduced photos), p points. Every view is compared with its best
neighbours at equally spaced inverse depths. Depths that neighbouring views confirm become points.
Source: Collins, A Space-Sweep Approach to True Multi-Image Matching, CVPR 1996; smoothed as in
Hirschmueller, TPAMI 2008.
"""

import dataclasses
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor
from torch.nn import functional

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.scene import Points
from gaussian_enhancer.splat.fit.geometry import focus_distance, matching_cost, seen_from
from gaussian_enhancer.typed import check_fields
from gaussian_enhancer.types import Camera


@dataclass(frozen=True)
class SweepSettings:
    """Resolution and strictness of the depth search.

    Args:
        planes: number of inverse depths that are tried.
        neighbours: number of views that each view is compared with.
        reduction: photos are first downsampled by this integer factor; 0 chooses it for about 40,000 pixels.
        radius: half the side of the comparison window, in reduced pixels.
        smoothness: penalty of a depth step of one plane, in units of colour difference; 0 turns smoothing off.
        agreement: largest relative difference of inverse depth at which a neighbour confirms a depth; a difference of
            less than one plane confirms it in any case.
        confirmations: number of neighbours that must confirm a depth.
        views: largest number of photos that are swept; of more photos an evenly spaced subset is used.

    Raises:
        InputError: a number is out of range.
    """

    planes: Annotated[int, Field(ge=2)] = 96
    neighbours: Annotated[int, Field(ge=1)] = 3
    reduction: Annotated[int, Field(ge=0)] = 0
    radius: Annotated[int, Field(ge=0)] = 2
    smoothness: Annotated[float, Field(ge=0)] = 0.03
    agreement: Annotated[float, Field(ge=0)] = 0.02
    confirmations: Annotated[int, Field(ge=0)] = 1
    views: Annotated[int, Field(ge=2)] = 60

    def __post_init__(self) -> None:
        check_fields(self, "sweep.")


@dataclass(frozen=True)
class SweptPoints:
    """Points found by the sweep.

    Args:
        points: positions and colours.
        confirmations: number of neighbouring views that have the same depth.
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
    read: Callable[[int], Float[Tensor, "3 _ _"]],
    cameras: Sequence[Camera],
    settings: SweepSettings = SweepSettings(),
    *,
    known_points: Points | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> SweptPoints:
    """Points on surfaces that several photos confirm; of several views of a point, only the first one adds it.

    Args:
        read: returns the training photo of a camera's index, in [0, 1]. Photos are read one by one, and only those that
            are swept.
        cameras: their cameras.
        settings: settings of the sweep.
        known_points: points from which the depth range is estimated; where fewer than 100 are visible, a coarse sweep
            estimates it.
        progress: called with the number of finished views and the number of all views.

    Raises:
        InputError: fewer than two photos, or all cameras are at one place.
    """
    swept = range(0, len(cameras), -(-len(cameras) // settings.views))
    cameras = [cameras[i] for i in swept]
    known_depths = _known_depths(known_points, cameras)
    distance = focus_distance(cameras) if known_depths is None else float(known_depths.median())
    views = _views(map(read, swept), cameras, distance, settings)
    coarse_depths = _coarse_depths(views, distance, settings) if known_depths is None else known_depths
    planes = _inverse_depths(coarse_depths, distance, settings.planes)
    return _merge_confirmed(views, _sweep(views, planes, settings, progress), planes, settings)


def sweep_depths(
    images: Sequence[Float[Tensor, "3 _ _"]],
    cameras: Sequence[Camera],
    sources: int,
    known_points: Points,
    settings: SweepSettings = SweepSettings(),
    *,
    progress: Callable[[int, int], None] | None = None,
) -> list[Float[Tensor, "1 h w"]]:
    """Depth of every pixel of each image, by comparison with the last ``sources`` images: renders with photos.

    Args:
        images: images in [0, 1]; those to compare with stand last.
        cameras: cameras of the images, with the images' sizes.
        sources: number of images, at the end of the list, that every image is compared with.
        known_points: points from which the depth range is estimated.
        settings: settings of the sweep; ``agreement``, ``confirmations`` and ``views`` have no effect.
        progress: called with the number of finished images and the number of all images.

    Returns:
        z of each image at the image's size; for images that are downsampled for the sweep, at the reduced size.

    Raises:
        InputError: fewer than two images, or all cameras are at one place.
    """
    known_depths = _known_depths(known_points, cameras)
    distance = focus_distance(cameras) if known_depths is None else float(known_depths.median())
    views = _views(images, cameras, distance, settings, len(images) - sources)
    planes = _inverse_depths(known_depths, distance, settings.planes)
    return [1 / inverse_depth_map[None] for inverse_depth_map in _sweep(views, planes, settings, progress)]


def inverse_depth(
    image: np.ndarray,
    camera: Camera,
    neighbours: np.ndarray,
    neighbour_cameras: Sequence[Camera],
    inverse_depths: Float[Tensor, " d"],
    settings: SweepSettings = SweepSettings(),
) -> Float[Tensor, "h w"]:
    """Inverse depth of every pixel of a view.

    The plane z = 1/q of the view maps onto a neighbour by H = K' (R + q t e_z^T) K^-1, (R, t) the relative pose.

    Args:
        image: the view, (h, w, 3) float32.
        camera: its camera.
        neighbours: images to compare with, (j, H, W, 3) float32.
        neighbour_cameras: their cameras.
        inverse_depths: ascending inverse depths to try, in equal steps.
        settings: window and smoothness.
    """
    from gaussian_enhancer.splat.fit import plane_sweep_kernels as kernels

    homographies = _homographies(camera, neighbour_cameras, inverse_depths)
    volume = np.empty((*image.shape[:2], len(inverse_depths)), np.float32)
    kernels.cost_volume(image, neighbours, homographies, settings.radius, volume)
    if settings.smoothness > 0:
        smoothed = np.zeros_like(volume)
        penalty = np.float32(settings.smoothness)
        kernels.aggregate_costs(volume, image, penalty, np.float32(8 * penalty), smoothed)
        volume = smoothed
    index = np.empty(image.shape[:2], np.float32)
    kernels.best_plane(volume, index)
    step = inverse_depths[1] - inverse_depths[0]
    return (inverse_depths[0] + torch.from_numpy(index) * step).float()


def _views(
    photos: Iterable[Tensor], cameras: Sequence[Camera], distance: float, settings: SweepSettings, first_source: int = 0
) -> list[_View]:
    """Reduced photos with their neighbours, which are chosen among the photos from index ``first_source`` on."""
    if len(cameras) < 2:
        raise InputError("plane sweep", f"has {len(cameras)} photo", "give at least two training photos")
    cost = matching_cost(cameras, distance)
    views = []
    for i, (photo, camera) in enumerate(zip(photos, cameras, strict=True)):
        factor = settings.reduction or max(1, round((camera.height * camera.width / 40_000) ** 0.5))
        height, width = (max(8, side // factor) for side in (camera.height, camera.width))
        image = functional.interpolate(photo[None], (height, width), mode="area")[0]
        ranked = [int(j) for j in cost[i].argsort() if j >= first_source and cost[i, j].isfinite()]
        channels_last = np.ascontiguousarray(image.permute(1, 2, 0).numpy())
        views.append(_View(channels_last, camera.resized(height, width), ranked[: settings.neighbours]))
    if not any(view.neighbours for view in views):
        raise InputError("plane sweep", "found all cameras at one place", "start with init=random")
    return views


def _neighbour_images(views: list[_View], view: _View) -> tuple[np.ndarray, list[Camera]]:
    """The neighbours' images on a common canvas (photos of a scene may differ in size) and their cameras."""
    neighbours = [views[j] for j in view.neighbours]
    height = max((v.image.shape[0] for v in neighbours), default=1)
    width = max((v.image.shape[1] for v in neighbours), default=1)
    canvas = np.zeros((len(neighbours), height, width, 3), np.float32)
    for k, v in enumerate(neighbours):
        canvas[k, : v.image.shape[0], : v.image.shape[1]] = v.image
    return canvas, [v.camera for v in neighbours]


def _sweep(
    views: list[_View],
    inverse_depths: Float[Tensor, " d"],
    settings: SweepSettings,
    progress: Callable[[int, int], None] | None = None,
) -> list[Tensor]:
    """Inverse depth map of each view."""
    maps = []
    for view in views:
        maps.append(inverse_depth(view.image, view.camera, *_neighbour_images(views, view), inverse_depths, settings))
        if progress is not None:
            progress(len(maps), len(views))
    return maps


def _homographies(camera: Camera, neighbours: Sequence[Camera], inverse_depths: Tensor) -> np.ndarray:
    """Homographies (d, j, 3, 3) from a view to its neighbours, by the planes of the inverse depths."""
    inverse_intrinsics = torch.linalg.inv(camera.K.double())
    homographies = []
    for neighbour in neighbours:
        relative_pose = neighbour.world_to_camera.double() @ torch.linalg.inv(camera.world_to_camera.double())
        planes = relative_pose[:3, :3].repeat(len(inverse_depths), 1, 1)
        planes[:, :, 2] += inverse_depths[:, None].double() * relative_pose[:3, 3]
        homographies.append(neighbour.K.double() @ planes @ inverse_intrinsics)
    return torch.stack(homographies, 1).float().numpy()


def _known_depths(points: Points | None, cameras: Sequence[Camera]) -> Tensor | None:
    """Depths of points in all cameras that see them; None if there are fewer than 100."""
    if points is None or len(points.positions) < 100:
        return None
    depths = torch.cat([_visible_depths(points.positions, camera) for camera in cameras])
    return depths if len(depths) >= 100 else None


def _visible_depths(positions: Tensor, camera: Camera) -> Tensor:
    depths, visible = seen_from(camera, positions)
    return depths[visible]


def _coarse_depths(views: list[_View], distance: float, settings: SweepSettings) -> Tensor:
    """Depths that two neighbours confirm in a sweep of small images over a wide range; empty if they are too few."""
    planes = torch.linspace(0.02 / distance, 4.0 / distance, settings.planes, dtype=torch.float64)
    coarse_views = [_reduce_photo(view) for view in views]
    strict_settings = dataclasses.replace(settings, confirmations=2)
    inverse_depth_maps = _sweep(coarse_views, planes, settings)
    positions = _merge_confirmed(coarse_views, inverse_depth_maps, planes, strict_settings).points.positions
    visible_depths = torch.cat([_visible_depths(positions, view.camera) for view in coarse_views])
    return visible_depths if len(positions) >= 100 else visible_depths[:0]


def _inverse_depths(depths: Tensor | None, distance: float, count: int) -> Float[Tensor, " d"]:
    """Inverse depths to search, in equal steps over the range of known depths with a margin, or over a wide range."""
    if depths is None or len(depths) == 0:
        near, far = distance / 4, distance * 50
    else:
        inverse = 1 / depths[:: -(-len(depths) // 1_000_000)].double()
        near, far = 1 / (1.3 * float(inverse.quantile(0.99))), 1 / (0.6 * float(inverse.quantile(0.01)))
    return torch.linspace(1 / far, 1 / near, count, dtype=torch.float64)


def _reduce_photo(view: _View) -> _View:
    """The view at half the size, without antialiasing."""
    image = np.ascontiguousarray(view.image[::2, ::2])
    return _View(image, view.camera.resized(*image.shape[:2]), view.neighbours)


def _merge_confirmed(
    views: list[_View], inverse_depth_maps: list[Tensor], planes: Float[Tensor, " d"], settings: SweepSettings
) -> SweptPoints:
    """Keep points that enough neighbours confirm and that no earlier view contains."""
    step = float(planes[1] - planes[0])
    positions, colours, confirmations = [], [], []
    for i, view in enumerate(views):
        world_points = _unproject(view.camera, inverse_depth_maps[i])
        confirmed = torch.zeros(len(world_points))
        already_merged = torch.zeros(len(world_points), dtype=torch.bool)
        for j in view.neighbours:
            agrees = _agreement_mask(world_points, views[j].camera, inverse_depth_maps[j], step, settings)
            confirmed += agrees
            if j < i:
                already_merged |= agrees
        keep = (confirmed >= min(settings.confirmations, len(view.neighbours))) & ~already_merged
        positions.append(world_points[keep])
        colours.append(torch.from_numpy(view.image).reshape(-1, 3)[keep])
        confirmations.append(confirmed[keep])
    return SweptPoints(Points(torch.cat(positions), torch.cat(colours)), torch.cat(confirmations))


def _agreement_mask(
    points: Tensor, camera: Camera, inverse_depth_map: Tensor, step: float, settings: SweepSettings
) -> Tensor:
    """Whether a view's inverse depth map agrees with the inverse depth of each point."""
    height, width = inverse_depth_map.shape
    camera_points = points @ camera.rotation.T + camera.world_to_camera[:3, 3]
    pixels = camera_points @ camera.K.T
    depth = pixels[:, 2].clamp(min=1e-9)
    x, y = (pixels[:, 0] / depth).long(), (pixels[:, 1] / depth).long()
    inside = (pixels[:, 2] > 0) & (x >= 0) & (y >= 0) & (x < width) & (y < height)
    sampled = inverse_depth_map[y.clamp(0, height - 1), x.clamp(0, width - 1)]
    return inside & ((1 / depth - sampled).abs() < torch.clamp(settings.agreement * sampled, min=step))


def _unproject(camera: Camera, inverse_depth_map: Tensor) -> Tensor:
    """World position of every pixel's surface, row by row."""
    height, width = inverse_depth_map.shape
    y, x = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
    rays = torch.stack([x, y, torch.ones_like(x)], -1).reshape(-1, 3) @ torch.linalg.inv(camera.K).T
    return (rays / inverse_depth_map.reshape(-1, 1) - camera.world_to_camera[:3, 3]) @ camera.rotation
