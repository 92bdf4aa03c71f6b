"""A fitted run's folder made without fitting: a textured plane, blurred photos as renders, exact depth."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from PIL import Image

from gaussian_enhancer.scene.cameras import write_cameras
from gaussian_enhancer.scene.photos import read_photo
from gaussian_enhancer.scene.rendered import RenderedView
from gaussian_enhancer.splat.io.ply import read_ply, write_ply
from gaussian_enhancer.types import Camera, Gaussians, identity_camera


def plane_camera(index: int, height: int, width: int) -> Camera:
    camera = identity_camera(height, width, float(width))
    pose = torch.eye(4)
    pose[:3, 3] = -torch.tensor([0.15 * (index % 4) - 0.2, 0.12 * (index // 4) - 0.1, 0.02 * index])
    return Camera(camera.K, pose, height, width)


def plane_view(camera: Camera, texture: torch.Tensor, distance: float = 3.0) -> tuple[torch.Tensor, torch.Tensor]:
    """Photo and depth of a plane at a distance, textured over [-3, 3]^2."""
    y, x = torch.meshgrid(torch.arange(camera.height) + 0.5, torch.arange(camera.width) + 0.5, indexing="ij")
    rays = torch.linalg.inv(camera.K) @ torch.stack([x, y, torch.ones_like(x)]).flatten(1)
    reach = distance - camera.centre[2]
    points = camera.centre[:, None] + rays * reach
    grid = (points[:2].T / 3).view(1, camera.height, camera.width, 2)
    photo = F.grid_sample(texture[None], grid, align_corners=False, padding_mode="reflection")[0]
    return photo.clamp(0, 1), torch.full((1, camera.height, camera.width), float(reach))


def write_plane_run(
    folder: Path, seed: int = 0, views: int = 8, size: tuple[int, int] = (48, 64), steps: tuple[int, ...] = (100,)
) -> Path:
    """Write a run with every fourth view held out; the render is the photo, blurred and noisy."""
    generator = torch.Generator().manual_seed(seed)
    texture = torch.rand(3, 192, 192, generator=generator)
    coarse = F.interpolate(torch.rand(1, 3, 12, 12, generator=generator), size=(192, 192), mode="bicubic")[0]
    texture = (0.4 * texture + 0.6 * coarse).clamp(0, 1)
    views_, sides = [], []
    for index in range(views):
        camera = plane_camera(index, *size)
        photo, depth = plane_view(camera, texture)
        side = "test" if index % 4 == 0 else "train"
        views_.append(RenderedView(f"view_{index:03d}.png", None, camera))
        sides.append(side)
        for step in steps:
            blurred = F.avg_pool2d(photo[None], 5, 1, 2, count_include_pad=False)[0]
            render = (blurred + 0.02 * torch.randn(blurred.shape, generator=generator)).clamp(0, 1)
            part = folder / side / f"ours_{step}"
            for name, image in (("renders", render), ("gt", photo), ("alpha", torch.ones_like(depth))):
                _write(part / name / f"view_{index:03d}.png", image)
            (part / "depth").mkdir(parents=True, exist_ok=True)
            np.save(part / "depth" / f"view_{index:03d}.npy", depth[0].numpy())
    write_cameras(folder / "cameras.json", views_, sides)
    (folder / "done").write_text("{}")
    return folder


def coloured_sheet(side: int) -> Gaussians:
    """A sheet of ``side`` x ``side`` Gaussians of random colours at depth 3, from -2 to 2."""
    y, x = torch.meshgrid(torch.linspace(-2, 2, side), torch.linspace(-2, 2, side), indexing="ij")
    means = torch.stack([x, y, torch.full_like(x, 3.0)], -1).reshape(-1, 3)
    count = len(means)
    scales = torch.tensor([2.16 / side, 2.16 / side, 0.01]).log().repeat(count, 1)
    turns = torch.tensor([1.0, 0, 0, 0]).repeat(count, 1)
    colours = torch.rand(count, 1, 3, generator=torch.Generator().manual_seed(0))
    return Gaussians(means, scales, turns, torch.full((count,), 4.0), colours)


def coloured_slab() -> Gaussians:
    """A thin slab of 200 Gaussians of random colours and places at depth 3."""
    generator = torch.Generator().manual_seed(0)
    means = torch.rand(200, 3, generator=generator) * torch.tensor([3.0, 3.0, 0.1]) + torch.tensor([-1.5, -1.5, 3.0])
    scales, turns = torch.full((200, 3), -2.0), torch.tensor([1.0, 0, 0, 0]).repeat(200, 1)
    return Gaussians(means, scales, turns, torch.full((200,), 3.0), torch.rand(200, 1, 3, generator=generator))


def _write(path: Path, image: torch.Tensor) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    values = (image * 255).round().byte().permute(1, 2, 0).numpy()
    Image.fromarray(values[..., 0] if values.shape[2] == 1 else values).save(path)


def copy_with_splat(run: Path, folder: Path, gaussians: Gaussians, name: str = "splat.ply") -> Path:
    """A copy of a run with a splat in a file of this name."""
    shutil.copytree(run, folder)
    write_ply(folder / name, gaussians)
    return folder


def copy_with_black_photos(run: Path, folder: Path) -> Path:
    """A copy of a run whose training photos are black and so unlike the splat's renders."""
    shutil.copytree(run, folder)
    for path in (folder / "train/ours_100/gt").iterdir():
        _write(path, torch.zeros_like(read_photo(path)))
    return folder


def copy_with_moved_splat(run: Path, folder: Path) -> Path:
    """A copy of a run whose splat lies outside every view."""
    gaussians = read_ply(run / "splat.ply")
    return copy_with_splat(run, folder, replace(gaussians, means=gaussians.means + 50))
