"""The first Gaussians of a fit, by the source that the user names.

Axes: p points, s scale axes.
"""

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.scene import Points, Scene
from gaussian_enhancer.splat.fit.initialise import at_random, from_points, neighbour_distances
from gaussian_enhancer.splat.fit.plane_sweep import SweepSettings, SweptPoints, sweep_points
from gaussian_enhancer.splat.fit.targets import TrainingPhotos
from gaussian_enhancer.splat.methods import Method, TwoDGS
from gaussian_enhancer.types import Camera, Gaussians

OPACITY_ON_SURFACES = 0.3
"""Opacity to start with on surfaces that were found; 3DGS's 0.1 is kept for guesses."""

STARTS = ("auto", "plane_sweep", "points", "random")
"""What a fit can start from."""

ONCE_SHARE = 0.15
"""Share of the Gaussians that may start on points which a single neighbour confirms."""


def starting_gaussians(
    scene: Scene,
    photos: TrainingPhotos,
    method: Method,
    init: str,
    *,
    count: int,
    sh_degree: int,
    generator: torch.Generator,
    sweep: SweepSettings,
    progress: Callable[[int, int], None] | None = None,
) -> Gaussians:
    """Gaussians to start a fit from.

    Args:
        scene: the scene, for its points.
        photos: the training photos.
        method: 2DGS starts with disks that face the nearest camera.
        init: "plane_sweep" matches the training photos, "points" takes the scene's, "auto" takes both (half of the
            Gaussians each) where the scene has points, "random" draws in the frusta.
        count: largest number of Gaussians.
        sh_degree: degree of the colour's spherical harmonics.
        generator: source of randomness.
        sweep: settings of the plane sweep.
        progress: called with the number of views swept and of all.

    Raises:
        InputError: the source is unknown, or the scene has no points.
    """
    known = scene.points if scene.points is not None and len(scene.points.positions) else None
    if init == "random":
        points = at_random(photos.cameras, count, generator)
    elif init == "points":
        if known is None:
            raise InputError("init=points", f"but scene {scene.name} has none", "choose plane_sweep or random")
        points = _random_subset(known, count, generator)
    elif init in ("auto", "plane_sweep"):
        first = None if known is None or init == "plane_sweep" else _random_subset(known, count // 2, generator)
        room = count if first is None else count - len(first.positions)
        swept = sweep_points(photos.pixels(), photos.cameras, sweep, known=known, progress=progress)
        if len(swept.points.positions) == 0 and first is None:
            raise InputError(f"init={init}", "found no point that two photos agree on", "choose random or points")
        points = _most_confirmed(swept, room, generator)
        if first is not None:
            points = _joined(first, points)
    else:
        raise InputError("init", f"is {init!r}", "choose auto, plane_sweep, points or random")
    disks = isinstance(method, TwoDGS)
    facing = _towards_cameras(points.positions, photos.cameras) if disks else None
    widths = neighbour_distances(points.positions)
    opacity = 0.1 if init == "random" else OPACITY_ON_SURFACES
    axes = 2 if disks else 3
    return from_points(points, axes=axes, sh_degree=sh_degree, opacity=opacity, deviations=widths, facing=facing)


def _most_confirmed(swept: SweptPoints, count: int, generator: torch.Generator) -> Points:
    """Points that two views confirm, and up to ONCE_SHARE of those that only one does: borders need them."""
    twice = (swept.confirmations >= 2).nonzero()[:, 0]
    once = (swept.confirmations < 2).nonzero()[:, 0]
    twice = twice[torch.randperm(len(twice), generator=generator)]
    once = once[torch.randperm(len(once), generator=generator)]
    reserved = min(len(once), round(ONCE_SHARE * count))
    chosen = twice[: count - reserved]
    chosen = torch.cat([chosen, once[: count - len(chosen)]])
    return Points(swept.points.positions[chosen], swept.points.colours[chosen])


def _random_subset(points: Points, count: int, generator: torch.Generator) -> Points:
    chosen = torch.randperm(len(points.positions), generator=generator)[:count]
    return Points(points.positions[chosen], points.colours[chosen])


def _joined(first: Points, second: Points) -> Points:
    positions = torch.cat([first.positions, second.positions])
    return Points(positions, torch.cat([first.colours, second.colours]))


def _towards_cameras(positions: Float[Tensor, "p 3"], cameras: list[Camera]) -> Float[Tensor, "p 3"]:
    """Unit directions from points to their nearest cameras."""
    centres = torch.stack([camera.centre for camera in cameras])
    nearest = centres[torch.cdist(positions, centres).argmin(1)]
    return torch.nn.functional.normalize(nearest - positions, dim=1)
