"""Small copies of published layouts: COLMAP binaries with downscaled folders, Blender files with alpha."""

import json
from pathlib import Path

import numpy as np
from PIL import Image

from support.captures_on_disk import (
    COUNT,
    DOT,
    HEIGHT,
    WIDTH,
    colmap_to_binary,
    dot_image,
    opengl_to_world,
    pinhole,
    pose,
    save,
    write_colmap,
)


def write_pyramid(root: Path, factors: tuple[int, ...] = (1, 2, 4)) -> None:
    """A scene as Mip-NeRF 360 comes: a binary model of the full size, photos at several sizes."""
    names = write_colmap(root)
    colmap_to_binary(root / "sparse/0")
    for factor in factors:
        for index, name in enumerate(names):
            rotation, translation = pose(index)
            x, y = pinhole(rotation @ DOT + translation) / factor
            grey = dot_image(x, y, HEIGHT // factor, WIDTH // factor, sigma=1.5 if factor == 1 else 1.0)
            save(root / ("images" if factor == 1 else f"images_{factor}") / name, grey)
    if 1 not in factors:
        for name in names:
            (root / "images" / name).unlink()
        (root / "images").rmdir()


def write_synthetic(root: Path, size: int = 16, counts: tuple[int, int, int] = (4, 2, 3)) -> None:
    """An object as NeRF-Synthetic comes: RGBA photos, a file of cameras a side, depth beside test photos."""
    for side, count in zip(("train", "val", "test"), counts, strict=True):
        frames = []
        for index in range(count):
            save_rgba(root / side / f"r_{index}.png", object_image(size))
            if side == "test":
                save_rgba(root / side / f"r_{index}_depth_0001.png", object_image(size))
            frames.append({"file_path": f"./{side}/r_{index}", "transform_matrix": opengl_to_world(index % COUNT)})
        content = {"camera_angle_x": 0.7, "frames": frames}
        (root / f"transforms_{side}.json").write_text(json.dumps(content))


def object_image(size: int) -> np.ndarray:
    """Red in the middle, half covered at its left edge, nothing around; colour under nothing is green."""
    image = np.zeros((size, size, 4), dtype=np.uint8)
    image[..., 1] = 255
    inner = slice(size // 4, 3 * size // 4)
    image[inner, inner] = (255, 0, 0, 255)
    image[inner, size // 4] = (255, 0, 0, 128)
    return image


def save_rgba(path: Path, image: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(image, "RGBA").save(path)
