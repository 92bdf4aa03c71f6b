"""Every reader of files: a small real file, ways to damage it, and what must hold of whatever is still read."""

import gzip
import io
import json
import random
import struct
import warnings
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from test_compressed_ply import elements
from test_compressed_ply import write as write_compressed
from test_opensfm import write_opensfm
from test_spz import attributes, header, packed

from fuzz.mutate import broken_bytes, broken_json, broken_text
from gaussian_enhancer.align.alignment import Reprojected
from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.infer.change_confidence import ChangeConfidence
from gaussian_enhancer.infer.weights import load_weights, save_weights
from gaussian_enhancer.scene.capture import open_capture
from gaussian_enhancer.scene.depth_files import ReadDepth, depth_size
from gaussian_enhancer.scene.path_files import FilePath, read_path
from gaussian_enhancer.scene.photos import read_header, read_photo
from gaussian_enhancer.scene.renders import read_run
from gaussian_enhancer.splat.io.open import read_splat
from gaussian_enhancer.splat.io.ply import write_ply
from gaussian_enhancer.splat.methods import ThreeDGS
from gaussian_enhancer.splat.render import render
from gaussian_enhancer.types import Camera, Gaussians, identity_camera
from support.captures_on_disk import colmap_to_binary, write_camera_path, write_colmap, write_transforms
from support.foreign_splats import write_checkpoint
from support.networks import trained
from support.synthetic_runs import write_plane_run

CAMERA = ("fl_x", "fl_y", "cx", "cy", "w", "h", "width", "height", "fx", "fy", "focal", "k1", "camera_angle_x")
Damage = Callable[[bytes, random.Random], tuple[str, bytes, bool]]


@dataclass(frozen=True)
class Reader:
    """One reader.

    Args:
        make: writes small real files into a folder.
        files: those that are damaged.
        damage: how: the way's name, the content, whether it must be refused.
        read: what a user's command would do.
        faults: what is wrong with what was read.
    """

    make: Callable[[Path], Any]
    files: tuple[str, ...]
    damage: Damage
    read: Callable[[Path], Any]
    faults: Callable[[Any], list[str]]


def plain(damage: Callable[[bytes, random.Random], tuple[str, bytes]]) -> Damage:
    return lambda data, draw: (*damage(data, draw), False)


def of_json(data: bytes, draw: random.Random) -> tuple[str, bytes, bool]:
    return broken_json(data, draw, CAMERA)


# What must hold ---------------------------------------------------------------------------------------------------


def camera_faults(camera: Camera) -> list[str]:
    finite = bool(torch.isfinite(camera.K).all() and torch.isfinite(camera.world_to_camera).all())
    turned = camera.rotation.double() @ camera.rotation.double().T
    rules = {
        "camera not finite": finite,
        "no rotation": bool((turned - torch.eye(3)).abs().max() < 1e-3),
        "centre not finite or far": bool(camera.centre.abs().max() < 1e10),
        "no focal length": bool(0 < camera.K[0, 0] < 1e9 and 0 < camera.K[1, 1] < 1e9),
        "no size": 1 <= camera.width < 1e5 and 1 <= camera.height < 1e5,
    }
    return [rule for rule, holds in rules.items() if not holds]


def image_faults(image: torch.Tensor, channels: int = 3) -> list[str]:
    right = image.dim() == 3 and image.shape[0] == channels and image.numel() > 0
    inside = bool((image >= 0).all()) and bool((image <= 1).all())
    return [] if right and inside else ["image not in [0, 1]"]


def scene_faults(scene: Any) -> list[str]:
    found = [fault for photo in scene.photos for fault in camera_faults(photo.camera)]
    found += [fault for photo in scene.photos[:2] for fault in image_faults(photo.read())]
    if scene.points is not None and not bool(torch.isfinite(scene.points.positions).all()):
        found.append("points not finite")
    if len({photo.name for photo in scene.photos}) != len(scene.photos):
        found.append("names twice")
    return found


def run_faults(rendered: Any) -> list[str]:
    views = [*rendered.targets, *rendered.references]
    centres = {tuple(view.camera.centre.tolist()) for view in views}
    found = [fault for view in views for fault in camera_faults(view.camera)]
    return found if len(centres) == len(views) else [*found, "one camera for two views"]


def path_faults(path: FilePath) -> list[str]:
    return [fault for camera in path.cameras for fault in camera_faults(camera)]


def splat_faults(gaussians: Gaussians) -> list[str]:
    values = [gaussians.means, gaussians.log_scales, gaussians.quaternions, gaussians.opacity_logits, gaussians.sh]
    if not all(bool(torch.isfinite(value).all()) for value in values):
        return ["not finite"]
    if gaussians.log_scales.shape[1] != 3:
        return []
    image = render(gaussians, identity_camera(16, 16, 16.0), ThreeDGS())
    return [] if bool(torch.isfinite(image.colour).all()) else ["render not finite"]


def depth_faults(read: tuple[tuple[int, int], torch.Tensor]) -> list[str]:
    size, depth = read
    right = depth.shape == (1, *size) and bool(torch.isfinite(depth).all()) and bool((depth >= 0).all())
    return [] if right and bool((depth <= 1e12).all()) else ["depth out of range"]


def weights_faults(pretrained: Any) -> list[str]:
    finite = all(bool(torch.isfinite(value).all()) for value in pretrained.network.state_dict().values())
    return [] if finite and isinstance(pretrained.card, dict) and pretrained.strength is not None else ["not finite"]


# Damage that knows the format ------------------------------------------------------------------------------------


def of_spz(data: bytes, draw: random.Random) -> tuple[str, bytes, bool]:
    kind = draw.choice(("outside", "inside", "inside", "bomb", "count"))
    if kind == "outside":
        return (*broken_bytes(data, draw), False)
    if kind == "bomb":
        return kind, gzip.compress(header(3, 1, draw.choice((5, 10**6))) + bytes(30_000_000)), True
    if kind == "count":
        return kind, packed(3, 1, attributes(3, 1), count=draw.choice((0, 5, 7, 10**6, 2**31, 2**32 - 1))), True
    name, inner = broken_bytes(gzip.decompress(data), draw)
    return f"inside {name}", gzip.compress(inner), False


def of_spz4(data: bytes, draw: random.Random) -> tuple[str, bytes, bool]:
    if draw.random() < 0.8:
        return (*broken_bytes(data, draw), False)
    import zstandard

    start = 32 + 16 * data[15]
    bomb = zstandard.ZstdCompressor().compress(bytes(200_000_000))
    table = struct.pack("<Q", len(bomb)) + data[40:start]
    return "bomb", data[:32] + table + bomb + data[start:], True


def of_ply(data: bytes, draw: random.Random) -> tuple[str, bytes, bool]:
    kind = draw.choice(("bytes", "bytes", "header", "count", "value"))
    head, mark, body = data.partition(b"end_header\n")
    if kind == "count":
        lines = head.split(b"\n")
        at = draw.choice([i for i, line in enumerate(lines) if line.startswith(b"element")])
        count = draw.choice((b"9223372036854775808", b"-1", b"1e9", b"4294967296", b"99999999", b"0", b"9" * 400))
        lines[at] = b" ".join([*lines[at].split(b" ")[:2], count])
        return kind, b"\n".join(lines) + mark + body, True
    if kind == "header":
        name, changed = broken_text(head, draw)
        return f"header {name}", changed + mark + body, False
    if kind == "value":
        at = 4 * draw.randrange(len(body) // 4)
        value = struct.pack("<f", draw.choice((float("nan"), float("inf"), 1e30, -1e30, 90.0, -1e9)))
        return kind, head + mark + body[:at] + value + body[at + 4 :], False
    return (*broken_bytes(data, draw), False)


def of_npz(data: bytes, draw: random.Random) -> tuple[str, bytes, bool]:
    kind = draw.choice(("bytes", "bytes", "member", "member", "shape", "object", "other"))
    if kind == "bytes":
        return (*broken_bytes(data, draw), False)
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        inner = archive.read("depth.npy")
    name, must = "depth.npy", True
    if kind == "member":
        (way, inner), must = broken_bytes(inner, draw), False
        kind = f"member {way}"
    elif kind == "shape":
        shape = draw.choice((b"(36000, 36000)", b"(-1, 24)", b"(2, 3, 24)", b"()", b"(9999999999, 9999999999)"))
        inner = inner.replace(b"(24, 32)" + b" " * (len(shape) - 8), shape)
        inner = inner if shape in inner else b""
    elif kind == "object":
        stored = io.BytesIO()
        np.save(stored, np.array([{}], dtype=object), allow_pickle=True)
        inner = stored.getvalue()
    else:
        name, inner = draw.choice(("depth.txt", "depth", "a.npy")), inner if draw.random() < 0.5 else b"hello"
        must = False
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(name, inner)
    return kind, made.getvalue(), must


def of_npy(data: bytes, draw: random.Random) -> tuple[str, bytes, bool]:
    if draw.random() < 0.7:
        return (*broken_bytes(data, draw), False)
    at, value = len(data) - 4 * draw.randrange(1, 24 * 32), draw.choice((1e38, -1.0, 3e12))
    return "value", data[:at] + struct.pack("<f", value) + data[at + 4 :], True


def of_weights(data: bytes, draw: random.Random) -> tuple[str, bytes, bool]:
    kind = draw.choice(("bytes", "design", "design", "reference_config", "card", "type", "wide"))
    if kind == "bytes":
        return (*broken_bytes(data, draw), False)
    (size,) = struct.unpack_from("<Q", data)
    head, body = json.loads(data[8 : 8 + size]), data[8 + size :]
    must = False
    if kind == "type":
        name = draw.choice([n for n in head if n != "__metadata__"])
        head[name]["dtype"] = draw.choice(("F64", "I16", "BOOL", "F8_E4M3", "X", "BF16"))
        must = head[name]["dtype"] != "BF16"
    elif kind == "wide":
        design = json.loads(head["__metadata__"]["design"])
        design["widths"] = [1024, 1024, 1024]
        design["blocks"] = draw.choice(([1, 1, 1], [400, 400, 400]))
        head["__metadata__"]["design"], must = json.dumps(design), True
    else:
        text = head["__metadata__"][kind].encode()
        way, text, must = broken_json(text, draw)
        head["__metadata__"][kind], kind = text.decode("latin-1"), f"{kind} {way}"
    told = json.dumps(head).encode()
    return kind, struct.pack("<Q", len(told)) + told + body, must


# Readers ---------------------------------------------------------------------------------------------------------


def splat() -> Gaussians:
    draw = torch.Generator().manual_seed(0)

    def rand(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=draw)

    return Gaussians(
        rand(40, 3) + torch.tensor([0.0, 0.0, 4.0]), rand(40, 3) - 2, rand(40, 4), rand(40), rand(40, 4, 3)
    )


def make_colmap(folder: Path, *, binary: bool) -> None:
    write_colmap(folder)
    if binary:
        colmap_to_binary(folder / "sparse/0")
        for extra in ("rigs.bin", "frames.bin"):
            (folder / "sparse/0" / extra).unlink(missing_ok=True)


def make_depth(folder: Path) -> None:
    depth = np.linspace(1, 5, 24 * 32, dtype=np.float32).reshape(24, 32)
    np.save(folder / "a.npy", depth)
    np.savez_compressed(folder / "a.npz", depth=depth)
    from PIL import Image

    Image.fromarray((depth * 1000).astype(np.uint16)).save(folder / "a.png")
    Image.fromarray(np.random.default_rng(0).integers(0, 255, (24, 32, 3), dtype=np.uint8)).save(folder / "b.jpg")


def read_depth(path: Path) -> tuple[tuple[int, int], torch.Tensor]:
    return depth_size(path), ReadDepth(path, 0.5)()


def read_image(path: Path) -> torch.Tensor:
    found, image = read_header(path), read_photo(path)
    assert image.shape[1:] == (found.height, found.width)
    return image


def depth_reader(name: str, damage: Damage) -> Reader:
    return Reader(make_depth, (name,), damage, lambda folder: read_depth(folder / name), depth_faults)


def splat_reader(make: Callable[[Path], Any], damage: Damage) -> Reader:
    return Reader(make, ("a",), damage, lambda folder: read_splat(folder / "a"), splat_faults)


def weights(folder: Path) -> None:
    config, card = ReferenceConfig(Reprojected(), 2, 4), {"name": "a", "strength": 0.5}
    save_weights(folder / "a.safetensors", trained(), config, card, ChangeConfidence(4))


MODEL = ("cameras", "images", "points3D")
READERS: dict[str, Reader] = {
    "colmap_bin": Reader(
        lambda folder: make_colmap(folder, binary=True),
        tuple(f"sparse/0/{stem}.bin" for stem in MODEL),
        plain(broken_bytes),
        open_capture,
        scene_faults,
    ),
    "colmap_txt": Reader(
        lambda folder: make_colmap(folder, binary=False),
        tuple(f"sparse/0/{stem}.txt" for stem in MODEL),
        plain(broken_text),
        open_capture,
        scene_faults,
    ),
    "transforms": Reader(write_transforms, ("transforms.json",), of_json, open_capture, scene_faults),
    "opensfm": Reader(write_opensfm, ("reconstruction.json",), of_json, open_capture, scene_faults),
    "cameras": Reader(write_plane_run, ("cameras.json",), of_json, read_run, run_faults),
    "camera_path": Reader(
        lambda folder: write_camera_path(folder / "camera_path.json"),
        ("camera_path.json",),
        of_json,
        lambda folder: read_path(folder / "camera_path.json", 48, 64),
        path_faults,
    ),
    "ply": splat_reader(lambda folder: write_ply(folder / "a", splat()), of_ply),
    "compressed_ply": splat_reader(lambda folder: write_compressed(folder / "a", elements(40)), of_ply),
    "spz": splat_reader(lambda folder: (folder / "a").write_bytes(packed(3, 1, attributes(3, 1))), of_spz),
    "spz4": splat_reader(lambda folder: (folder / "a").write_bytes(packed(4, 1, attributes(4, 1))), of_spz4),
    "gsplat_checkpoint": splat_reader(lambda folder: write_checkpoint(folder / "a", splat()), plain(broken_bytes)),
    "depth_npy": depth_reader("a.npy", of_npy),
    "depth_npz": depth_reader("a.npz", of_npz),
    "depth_png": depth_reader("a.png", plain(broken_bytes)),
    "photo_png": Reader(
        make_depth, ("a.png",), plain(broken_bytes), lambda folder: read_image(folder / "a.png"), image_faults
    ),
    "photo_jpg": Reader(
        make_depth, ("b.jpg",), plain(broken_bytes), lambda folder: read_image(folder / "b.jpg"), image_faults
    ),
    "weights": Reader(
        weights, ("a.safetensors",), of_weights, lambda folder: load_weights(folder / "a.safetensors"), weights_faults
    ),
}


def damaged(reader: Reader, folder: Path, seed: str) -> tuple[str, bool]:
    """Damage one file of a folder that the reader made; the way's name and whether it must be refused."""
    draw = random.Random(seed)
    file = folder / draw.choice(reader.files)
    way, content, must = reader.damage(file.read_bytes(), draw)
    must = must and content != file.read_bytes()
    file.write_bytes(content)
    return f"{file.name}: {way}", must


warnings.simplefilter("ignore")
