"""A corner of three textured walls, which cameras see exactly; structure from motion finds its way in it."""

from pathlib import Path

import torch
import torch.nn.functional as F

from gaussian_enhancer.scene.image_files import write_image
from gaussian_enhancer.types import Camera, identity_camera

HEIGHT, WIDTH, FOCAL = 180, 240, 200.0
WALLS = ((0, -2.0), (1, 1.5), (2, 4.0))
"""Axis and place of each wall: left, floor, back."""


def corner_camera(index: int, height: int = HEIGHT, width: int = WIDTH) -> Camera:
    """A camera on an arc about the corner, the nine of them about a third of a unit apart."""
    angle = 0.12 * (index - 4)
    centre = torch.tensor([2.2 * angle, -0.25 + 0.2 * (index % 3), -0.3 * abs(angle)])
    forward = F.normalize(torch.tensor([-0.4, 0.35, 3.5]) - centre, dim=0)
    right = F.normalize(torch.linalg.cross(torch.tensor([0.0, 1.0, 0.0]), forward), dim=0)
    pose = torch.eye(4)
    pose[:3, :3] = torch.stack([right, torch.linalg.cross(forward, right), forward])
    pose[:3, 3] = -pose[:3, :3] @ centre
    return Camera(identity_camera(height, width, FOCAL * width / WIDTH).K, pose, height, width)


def texture(seed: int) -> torch.Tensor:
    """Spots of many sizes, (3, 512, 512)."""
    generator = torch.Generator().manual_seed(seed)
    octaves = [torch.rand(1, 3, n, n, generator=generator) for n in (16, 48, 128, 256)]
    total = sum(F.interpolate(one - 0.5, size=(512, 512), mode="bicubic")[0] for one in octaves)
    return (0.5 + 0.45 * total).clamp(0, 1)


def corner_view(camera: Camera, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    """Photo and depth of the corner; another seed is another place of the same shape."""
    y, x = torch.meshgrid(torch.arange(camera.height) + 0.5, torch.arange(camera.width) + 0.5, indexing="ij")
    local = torch.linalg.inv(camera.K) @ torch.stack([x, y, torch.ones_like(x)]).flatten(1)
    rays, centre = camera.rotation.T @ local, camera.centre
    reach = torch.full((rays.shape[1],), torch.inf)
    photo = torch.zeros(3, rays.shape[1])
    for number, (axis, place) in enumerate(WALLS):
        along = (place - centre[axis]) / rays[axis]
        points = centre[:, None] + along * rays
        u, v = (points[other] / 4 for other in range(3) if other != axis)
        grid = torch.stack([u, v], -1)[None, None]
        seen = F.grid_sample(texture(3 * seed + number)[None], grid, align_corners=False, padding_mode="reflection")
        nearer = (along > 0) & (along < reach)
        photo = torch.where(nearer, seen[0, :, 0], photo)
        reach = torch.where(nearer, along, reach)
    shape = camera.height, camera.width
    return photo.view(3, *shape).clamp(0, 1), reach.view(1, *shape)


def corner_render(photo: torch.Tensor) -> torch.Tensor:
    """What a poor splat makes of a view: blurred."""
    return F.avg_pool2d(photo[None], 3, 1, 1, count_include_pad=False)[0]


def write_corner(root: Path, renders: tuple[int, ...] = (2, 6), strange: tuple[int, ...] = ()) -> None:
    """Folders ``renders`` and ``photos`` of the corner: photos twice as fine, of every view without a render.

    Args:
        root: where the folders are made.
        renders: views that are rendered; their photos are left out.
        strange: of these, those that show another place.
    """
    for index in range(9):
        if index in renders:
            photo, _ = corner_view(corner_camera(index), seed=7 if index in strange else 0)
            write_image(root / f"renders/view_{index}.png", corner_render(photo))
        else:
            photo, _ = corner_view(corner_camera(index, 2 * HEIGHT, 2 * WIDTH))
            write_image(root / f"photos/view_{index}.png", photo)
