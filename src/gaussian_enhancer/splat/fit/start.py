"""The first Gaussians of a fit, by the source that the user names.

Axes: p points, s scale axes.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.scene import Points, Scene
from gaussian_enhancer.splat.fit.initialise import at_random, from_points, neighbour_distances
from gaussian_enhancer.splat.fit.plane_sweep import SweepSettings, sweep_points
from gaussian_enhancer.splat.fit.targets import TrainingPhotos
from gaussian_enhancer.splat.methods import Method, TwoDGS
from gaussian_enhancer.types import Camera, Gaussians

STARTS = ("plane_sweep", "points", "random")
"""What a fit can start from."""


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
) -> Gaussians:
    """Gaussians to start a fit from.

    Args:
        scene: the scene, for its points.
        photos: the training photos.
        method: 2DGS starts with disks that face the nearest camera.
        init: "plane_sweep" matches the training photos, "points" takes the scene's, "random" draws in the frusta.
        count: largest number of Gaussians.
        sh_degree: degree of the colour's spherical harmonics.
        generator: source of randomness.
        sweep: settings of the plane sweep.

    Raises:
        InputError: the source is unknown, or the scene has no points.
    """
    if init == "plane_sweep":
        swept = sweep_points(photos.pixels(), photos.cameras, sweep, distance=_typical_depth(scene, photos.cameras))
        points = swept.points
    elif init == "points":
        if scene.points is None or len(scene.points.positions) == 0:
            raise InputError("init=points", f"but scene {scene.name} has none", "choose plane_sweep or random")
        points = scene.points
    elif init == "random":
        points = at_random(photos.cameras, count, generator)
    else:
        raise InputError("init", f"is {init!r}", f"choose {', '.join(STARTS)}")
    if len(points.positions) == 0:
        raise InputError("init=plane_sweep", "found no point that two photos agree on", "choose random or points")
    chosen = torch.randperm(len(points.positions), generator=generator)[:count]
    points = Points(points.positions[chosen], points.colours[chosen])
    facing = _towards_cameras(points.positions, photos.cameras) if isinstance(method, TwoDGS) else None
    axes = 2 if isinstance(method, TwoDGS) else 3
    widths = neighbour_distances(points.positions)
    return from_points(points, axes=axes, sh_degree=sh_degree, deviations=widths, facing=facing)


def _typical_depth(scene: Scene, cameras: list[Camera]) -> float | None:
    """Median depth of the scene's own points over the cameras; None without points."""
    if scene.points is None or len(scene.points.positions) == 0:
        return None
    positions = scene.points.positions
    depths = torch.cat([positions @ c.rotation[2] + c.world_to_camera[2, 3] for c in cameras])
    return float(depths[depths > 0].median()) if (depths > 0).any() else None


def _towards_cameras(positions: Float[Tensor, "p 3"], cameras: list[Camera]) -> Float[Tensor, "p 3"]:
    """Unit directions from points to their nearest cameras."""
    centres = torch.stack([camera.centre for camera in cameras])
    nearest = centres[torch.cdist(positions, centres).argmin(1)]
    return torch.nn.functional.normalize(nearest - positions, dim=1)
