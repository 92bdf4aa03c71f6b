"""A textured plane seen by several cameras: the scene that the cases of depth and references modify.

Axes: h height, w width.
"""

from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from gaussian_enhancer.align.alignment import LoadedView
from gaussian_enhancer.types import Camera, identity_camera

HEIGHT, WIDTH, DISTANCE = 32, 48, 3.0


def plane(shift: float = 0.0, unit: float = 1.0, name: str = "target.png") -> LoadedView:
    """A view of the plane in double precision, with depth and a render, which is the smoothed photo.

    Args:
        shift: displacement of the camera to the right, in multiples of ``unit``.
        unit: unit of length, in scene units.
        name: of the view.
    """
    camera = shifted(shift * unit)
    grid_x = torch.linspace(-1, 1, WIDTH, dtype=torch.float64) + shift * 2 / DISTANCE
    grid_y = torch.linspace(-1, 1, HEIGHT, dtype=torch.float64)
    generator = torch.Generator().manual_seed(7)
    texture = torch.rand(1, 3, 24, 96, generator=generator, dtype=torch.float64)
    grid = torch.stack(torch.meshgrid(grid_y, grid_x / 3, indexing="ij")[::-1], -1)[None]
    photo = functional.grid_sample(texture, grid, padding_mode="border", align_corners=False)[0]
    depth = torch.full((1, HEIGHT, WIDTH), DISTANCE * unit, dtype=torch.float64)
    render = functional.avg_pool2d(photo[None], 3, 1, 1, count_include_pad=False)[0]
    return LoadedView(name, photo, camera, depth, torch.ones_like(depth), render)


def shifted(right: float, behind: bool = False) -> Camera:
    """A camera moved to the right by ``right`` scene units; with ``behind``, it looks at the plane from behind."""
    camera = identity_camera(HEIGHT, WIDTH, float(WIDTH), torch.float64)
    pose = torch.eye(4, dtype=torch.float64)
    pose[0, 3] = -right
    if behind:
        pose[0, 0], pose[2, 2], pose[2, 3] = -1.0, -1.0, 2 * DISTANCE
    return replace(camera, world_to_camera=pose)


def as_target(view: LoadedView) -> LoadedView:
    """The view as a target of enhancement: its render in place of its photo."""
    if view.render is None:
        raise ValueError(f"{view.name} has no render")
    return replace(view, image=view.render, render=None)


def textured_depth() -> Float[Tensor, "1 h w"]:
    """Depth that increases from left to right, in double precision."""
    return torch.linspace(2, 4, WIDTH, dtype=torch.float64).expand(1, HEIGHT, WIDTH).clone()
