"""Initial Gaussians of a fit, from the source that the user chooses.

Axes: p points, s scale axes.
"""

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.scene import Points, Scene
from gaussian_enhancer.splat.fit.initialise import gaussians_from_points, random_points
from gaussian_enhancer.splat.fit.plane_sweep import SweepSettings, SweptPoints, sweep_points
from gaussian_enhancer.splat.fit.targets import TrainingPhotos
from gaussian_enhancer.splat.methods import Method, TwoDGS
from gaussian_enhancer.types import Camera, Gaussians

OPACITY_ON_SURFACES = 0.3
"""Initial opacity of Gaussians on known or swept points; random ones start with 3DGS's 0.1."""

STARTS = ("auto", "plane_sweep", "points", "random")
"""Sources of the initial Gaussians: the values of ``init``."""

SINGLE_CONFIRMATION_SHARE = 0.15
"""Share of the swept points that is reserved for those which a single neighbour confirms."""


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
    """Initial Gaussians of a fit.

    Args:
        scene: the scene, for its points.
        photos: the training photos.
        method: 2DGS starts with disks that face the nearest camera.
        init: "plane_sweep" matches the training photos, "points" takes the scene's points, "auto" takes both (half of
            the Gaussians each) if the scene has points, "random" draws points in the cameras' fields of view.
        count: largest number of Gaussians.
        sh_degree: degree of the colour's spherical harmonics.
        generator: source of randomness.
        sweep: settings of the plane sweep.
        progress: called with the number of finished views and the number of all views of the sweep.

    Raises:
        InputError: the source is unknown, or it has no points.
    """
    scene_points = scene.points if scene.points is not None and len(scene.points.positions) else None
    if init == "random":
        points = random_points(photos.cameras, count, generator)
    elif init == "points":
        if scene_points is None:
            raise InputError("init=points", f"but scene {scene.name} has none", "choose plane_sweep or random")
        points = _random_subset(scene_points, count, generator)
    elif init in ("auto", "plane_sweep"):
        swept = sweep_points(photos.pixels, photos.cameras, sweep, known_points=scene_points, progress=progress)
        if init == "auto" and scene_points is not None:
            subset = _random_subset(scene_points, count // 2, generator)
            points = _join(subset, _most_confirmed(swept, count - len(subset.positions), generator))
        elif len(swept.points.positions):
            points = _most_confirmed(swept, count, generator)
        else:
            raise InputError(f"init={init}", "found no point that two photos agree on", "choose random or points")
    else:
        raise InputError("init", f"is {init!r}", "choose auto, plane_sweep, points or random")
    disks = isinstance(method, TwoDGS)
    facing = _towards_cameras(points.positions, photos.cameras) if disks else None
    opacity = 0.1 if init == "random" else OPACITY_ON_SURFACES
    axes = 2 if disks else 3
    return gaussians_from_points(points, axes=axes, sh_degree=sh_degree, opacity=opacity, facing=facing)


def _most_confirmed(swept: SweptPoints, count: int, generator: torch.Generator) -> Points:
    """Random choice of points that two or more neighbours confirm, and of points that only one confirms.

    A share of `SINGLE_CONFIRMATION_SHARE` is reserved for the latter, which are needed at borders; they also replace
    missing ones of the former.
    """
    confirmed_twice = (swept.confirmations >= 2).nonzero()[:, 0]
    confirmed_once = (swept.confirmations < 2).nonzero()[:, 0]
    confirmed_twice = confirmed_twice[torch.randperm(len(confirmed_twice), generator=generator)]
    confirmed_once = confirmed_once[torch.randperm(len(confirmed_once), generator=generator)]
    reserved_count = min(len(confirmed_once), round(SINGLE_CONFIRMATION_SHARE * count))
    selected = confirmed_twice[: count - reserved_count]
    selected = torch.cat([selected, confirmed_once[: count - len(selected)]])
    return Points(swept.points.positions[selected], swept.points.colours[selected])


def _random_subset(points: Points, count: int, generator: torch.Generator) -> Points:
    selected = torch.randperm(len(points.positions), generator=generator)[:count]
    return Points(points.positions[selected], points.colours[selected])


def _join(first: Points, second: Points) -> Points:
    positions = torch.cat([first.positions, second.positions])
    return Points(positions, torch.cat([first.colours, second.colours]))


def _towards_cameras(positions: Float[Tensor, "p 3"], cameras: list[Camera]) -> Float[Tensor, "p 3"]:
    """Unit directions from points to their nearest cameras."""
    centres = torch.stack([camera.centre for camera in cameras])
    # The default mode's matrix product is wrong far from the origin.
    distances = torch.cdist(positions, centres, compute_mode="donot_use_mm_for_euclid_dist")
    nearest = centres[distances.argmin(1)]
    return torch.nn.functional.normalize(nearest - positions, dim=1)
