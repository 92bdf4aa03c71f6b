"""Tiny captures written by hand: a ring of cameras that all photograph one bright dot.

The dot is drawn where each format's own published formula puts it, so that a loader that flips an axis or shifts the
principal point predicts another pixel than the one that is bright.
"""

import json
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from gaussian_enhancer.scene.scene import Scene
from gaussian_enhancer.types import Camera
from support.projection import project

HEIGHT, WIDTH = 48, 64
FX, FY, CX, CY = 70.0, 68.0, 33.5, 22.0
DOT = np.array([0.15, -0.1, 0.2])
COUNT = 9

Lens = Callable[[np.ndarray], np.ndarray]


def pose(index: int) -> tuple[np.ndarray, np.ndarray]:
    """World-to-camera rotation and translation, OpenCV axes, of a camera on a ring that looks near the origin."""
    angle = 0.25 * index
    centre = np.array([3 * np.sin(angle), 0.4 * np.cos(3 * angle) - 0.5, -3 * np.cos(angle)])
    forward = -centre / np.linalg.norm(centre)
    right = np.cross([0.0, 1.0, 0.0], forward)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    return rotation, -rotation @ centre


def pinhole(local: np.ndarray) -> np.ndarray:
    return np.array([FX, FY]) * local[:2] / local[2] + np.array([CX, CY])


def opencv(k1: float, k2: float, p1: float, p2: float) -> Lens:
    """Brown's model as OpenCV documents it."""

    def seen(local: np.ndarray) -> np.ndarray:
        x, y = local[:2] / local[2]
        r2 = x * x + y * y
        radial = 1 + k1 * r2 + k2 * r2 * r2
        u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        return np.array([FX * u + CX, FY * v + CY])

    return seen


def fisheye(k1: float, k2: float) -> Lens:
    """Kannala-Brandt as OpenCV's fisheye module documents it."""

    def seen(local: np.ndarray) -> np.ndarray:
        x, y = local[:2] / local[2]
        r = np.hypot(x, y)
        theta = np.arctan(r)
        bent = theta * (1 + k1 * theta**2 + k2 * theta**4)
        return np.array([FX * x * bent / r + CX, FY * y * bent / r + CY])

    return seen


def dot_image(x: float, y: float, height: int = HEIGHT, width: int = WIDTH, sigma: float = 1.5) -> np.ndarray:
    """Grey level of a soft dot whose centre lies at (x, y), the first pixel's centre being (0.5, 0.5)."""
    columns, rows = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    return np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / (2 * sigma**2))


def dot_centre(image: np.ndarray) -> np.ndarray:
    """Centre of mass (x, y) of a (3, h, w) photo's dot."""
    grey = image.mean(0)
    rows, columns = np.indices(grey.shape) + 0.5
    return np.array([(columns * grey).sum(), (rows * grey).sum()]) / grey.sum()


def predicted_dot(camera: Camera) -> np.ndarray:
    """The pixel at which a camera sees the dot."""
    return project(camera, torch.tensor(DOT, dtype=torch.float32)).numpy()


def assert_dots_are_where_cameras_say(scene: Scene, atol: float = 0.05) -> None:
    assert len(scene.photos) == COUNT
    for photo in scene.photos:
        image = photo.read()
        assert image.shape == (3, photo.camera.height, photo.camera.width)
        np.testing.assert_allclose(dot_centre(image.numpy()), predicted_dot(photo.camera), atol=atol)


def save(path: Path, grey: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray((grey * 255).round().astype(np.uint8)).convert("RGB").save(path)


def write_photos(folder: Path, lens: Lens = pinhole, ending: str = ".png", count: int = COUNT) -> list[str]:
    names = [f"view_{i:02d}{ending}" for i in range(count)]
    for i, name in enumerate(names):
        rotation, translation = pose(i)
        x, y = lens(rotation @ DOT + translation)
        save(folder / name, dot_image(x, y))
    return names


def write_colmap(
    root: Path,
    model: str = "PINHOLE",
    params: tuple[float, ...] = (FX, FY, CX, CY),
    lens: Lens = pinhole,
    sparse: str = "sparse/0",
) -> list[str]:
    """A COLMAP text model, as the format's documentation describes it, and its photos."""
    names = write_photos(root / "images", lens)
    folder = root / sparse
    folder.mkdir(parents=True)
    (folder / "cameras.txt").write_text(f"# cameras\n1 {model} {WIDTH} {HEIGHT} {' '.join(map(str, params))}\n")
    lines = ["# images"]
    for i, name in enumerate(names):
        rotation, translation = pose(i)
        x, y = lens(rotation @ DOT + translation)
        values = " ".join(map(repr, map(float, (*quaternion(rotation), *translation))))
        lines += [f"{i + 1} {values} 1 {name}", f"{x} {y} 1"]
    (folder / "images.txt").write_text("\n".join(lines) + "\n")
    track = " ".join(f"{i + 1} 0" for i in range(len(names)))
    (folder / "points3D.txt").write_text(f"# points\n1 {DOT[0]} {DOT[1]} {DOT[2]} 255 51 0 0.1 {track}\n")
    return names


def colmap_to_binary(folder: Path) -> None:
    import pycolmap

    pycolmap.Reconstruction(str(folder)).write_binary(str(folder))
    for file in folder.glob("*.txt"):
        file.unlink()


def quaternion(rotation: np.ndarray) -> np.ndarray:
    """(w, x, y, z); the ring's rotations stay clear of w = 0."""
    w = np.sqrt(max(0.0, 1 + np.trace(rotation))) / 2
    x, y, z = (rotation[2, 1], rotation[0, 2], rotation[1, 0])
    return np.array(
        [w, *((np.array([x, y, z]) - np.array([rotation[1, 2], rotation[2, 0], rotation[0, 1]])) / (4 * w))]
    )


def opengl_to_world(index: int) -> list[list[float]]:
    """Camera-to-world of ring camera ``index`` in OpenGL axes: columns right, up, backward, position."""
    rotation, translation = pose(index)
    right, down, forward = rotation
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2] = right, -down, -forward
    matrix[:3, 3] = -rotation.T @ translation
    return matrix.tolist()


def write_transforms(root: Path, lens: Lens = pinhole, **values: object) -> dict:
    """An instant-ngp or nerfstudio capture; ``values`` go to the file's top level."""
    names = write_photos(root / "images", lens)
    shared = {"fl_x": FX, "fl_y": FY, "cx": CX, "cy": CY, "w": WIDTH, "h": HEIGHT, "aabb_scale": 4}
    frames = [{"file_path": f"images/{n}", "transform_matrix": opengl_to_world(i)} for i, n in enumerate(names)]
    content = {**shared, **values, "frames": frames}
    (root / "transforms.json").write_text(json.dumps(content))
    return content


def write_camera_path(path: Path, **values: object) -> dict:
    """A camera path as nerfstudio's viewer writes it; its field of view is that of FY."""
    degrees = 2 * np.degrees(np.arctan(HEIGHT / (2 * FY)))
    poses = [[number for row in opengl_to_world(i) for number in row] for i in range(COUNT)]
    entries = [{"camera_to_world": pose, "fov": degrees, "aspect": WIDTH / HEIGHT} for pose in poses]
    shared = {"camera_type": "perspective", "render_height": HEIGHT, "render_width": WIDTH, "fps": 24, "seconds": 2}
    content = {**shared, "is_cycle": False, "crop": None, "camera_path": entries, **values}
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content))
    return content


def write_deep_png(path: Path, values: np.ndarray) -> None:
    """A PNG with 16 bits a channel by the format's own rules; 2, 3 or 4 channels."""
    height, width, channels = values.shape
    rows = b"".join(b"\0" + row.astype(">u2").tobytes() for row in values)

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 16, {2: 4, 3: 2, 4: 6}[channels], 0, 0, 0)
    body = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + body)
