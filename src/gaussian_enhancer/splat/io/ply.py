"""Splats as .ply in the original 3DGS layout.

One ``vertex`` element of float32 properties: x, y, z, nx, ny, nz, f_dc_0..2, f_rest_0.. (channel-major: all
of red's higher harmonics first), opacity (logit), scale_0..2 (natural logarithm; 2DGS writes two), rot_0..3
(w, x, y, z) and, from Mip-Splatting, filter_3D (world units). Source: Kerbl et al., 3D Gaussian Splatting,
SIGGRAPH 2023, and the files that its trainer and those of 2DGS and Mip-Splatting write.

Axes: n Gaussians, k spherical-harmonics coefficients, s scale axes.
"""

import io
import re
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from plyfile import PlyData, PlyElement

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import atomic_write
from gaussian_enhancer.ply_file import read_ply_elements
from gaussian_enhancer.splat.io.quantised import float_tensor, opacity_logits
from gaussian_enhancer.splat.io.validity import refuse_or_drop_invalid
from gaussian_enhancer.types import Gaussians

_POSITION = ("x", "y", "z")
_NORMAL = ("nx", "ny", "nz")
_BASE_COLOUR = ("f_dc_0", "f_dc_1", "f_dc_2")
_ROTATION = ("rot_0", "rot_1", "rot_2", "rot_3")
_REST_COUNTS = (0, 9, 24, 45)  # three channels of degree 0, 1, 2, 3 without the constant


def read_ply(path: str | Path, *, invalid: str = "refuse") -> Gaussians:
    """Read a splat in the original 3DGS layout (3DGS, 2DGS or Mip-Splatting), float32 on the CPU.

    Infinite opacity logits, which converters write for opacities of exactly 0 and 1, become those of the compressed
    formats' lowest and highest byte.

    Args:
        path: the file, binary or ASCII.
        invalid: what to do with Gaussians that cannot be rendered: "refuse" or "drop".

    Raises:
        InputError: if the file is missing, truncated, not a splat, or holds invalid Gaussians that are refused.
    """
    vertex = read_elements(path).get("vertex")
    if vertex is None:
        raise InputError(path, "has no vertex element", "give a .ply that a splat trainer wrote")
    names = vertex.dtype.names or ()
    rest_names = _numbered(names, "f_rest_")
    scale_names = _numbered(names, "scale_")
    _require(path, names, (*_POSITION, *_BASE_COLOUR, "opacity", "scale_0", "scale_1", *_ROTATION))
    if len(rest_names) not in _REST_COUNTS:
        raise InputError(path, f"has {len(rest_names)} f_rest properties", "export 0, 9, 24 or 45 (degree 0 to 3)")
    if len(scale_names) not in (2, 3):
        raise InputError(path, f"has {len(scale_names)} scale properties", "export three, or two for 2DGS disks")
    count = vertex.shape[0]
    constant = _columns(vertex, _BASE_COLOUR)[:, None, :]
    higher = _columns(vertex, rest_names).reshape(count, 3, len(rest_names) // 3).transpose(0, 2, 1)
    gaussians = Gaussians(
        means=float_tensor(_columns(vertex, _POSITION)),
        log_scales=float_tensor(_columns(vertex, scale_names)),
        quaternions=float_tensor(_columns(vertex, _ROTATION)),
        opacity_logits=float_tensor(_finite_logits(_columns(vertex, ("opacity",))[:, 0])),
        sh=float_tensor(np.concatenate([constant, higher], axis=1)),
        smoothing=float_tensor(_columns(vertex, ("filter_3D",))[:, 0]) if "filter_3D" in names else None,
    )
    return refuse_or_drop_invalid(path, gaussians, invalid)


def write_ply(path: str | Path, gaussians: Gaussians) -> None:
    """Write a splat in the original 3DGS layout, binary little-endian; it is written completely or not at all.

    Args:
        path: the file to write; parent folders are created.
        gaussians: the splat; two scale axes give a 2DGS file, ``smoothing`` gives Mip-Splatting's filter_3D.

    Raises:
        InputError: if the file cannot be written.
    """
    count, coefficients = gaussians.sh.shape[:2]
    higher = gaussians.sh[:, 1:].transpose(1, 2).reshape(count, 3 * (coefficients - 1))
    blocks: dict[tuple[str, ...], torch.Tensor] = {
        _POSITION: gaussians.means,
        _NORMAL: torch.zeros_like(gaussians.means),
        _BASE_COLOUR: gaussians.sh[:, 0],
        tuple(f"f_rest_{i}" for i in range(3 * (coefficients - 1))): higher,
        ("opacity",): gaussians.opacity_logits[:, None],
        tuple(f"scale_{i}" for i in range(gaussians.log_scales.shape[1])): gaussians.log_scales,
        _ROTATION: gaussians.quaternions,
    }
    if gaussians.smoothing is not None:
        blocks[("filter_3D",)] = gaussians.smoothing[:, None]
    names = [name for block in blocks for name in block]
    values = torch.cat([block.detach().to("cpu", torch.float32) for block in blocks.values()], dim=1).numpy()
    vertex = np.ascontiguousarray(values).view([(name, "<f4") for name in names])[:, 0]
    content = io.BytesIO()  # numpy's writing to a file does not report a disk that becomes full at the very end
    PlyData([PlyElement.describe(vertex, "vertex")], byte_order="<").write(content)
    with atomic_write(path) as temporary:
        temporary.write_bytes(content.getbuffer())


def read_elements(path: str | Path) -> dict[str, np.ndarray]:
    """Read the elements of a splat's .ply as structured arrays, by name.

    Raises:
        InputError: if the file is missing, truncated, or not a .ply.
    """
    return read_ply_elements(path, ("vertex", "chunk", "sh"), "give a .ply that a splat trainer wrote")


def _numbered(names: tuple[str, ...], prefix: str) -> tuple[str, ...]:
    """Names of the properties ``prefix0, prefix1, ...``, sorted by number."""
    matching = [name for name in names if re.fullmatch(rf"{prefix}\d+", name)]
    return tuple(sorted(matching, key=lambda name: int(name[len(prefix) :])))


def _require(path: str | Path, names: tuple[str, ...], required: tuple[str, ...]) -> None:
    missing = [name for name in required if name not in names]
    if missing:
        raise InputError(path, f"has no {', '.join(missing)}", "give a .ply that a splat trainer wrote")


def _columns(vertex: np.ndarray, names: tuple[str, ...]) -> np.ndarray:
    """Properties as the columns of a float32 matrix of shape (n, len(names))."""
    columns = np.empty((vertex.shape[0], len(names)), dtype=np.float32)
    with np.errstate(over="ignore"):  # doubles beyond float32 become infinite, which validation reports
        for i, name in enumerate(names):
            columns[:, i] = vertex[name]
    return columns


def _finite_logits(logits: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """The logits with infinite ones (opacity 0 or 1) replaced by finite ones; NaN stays and is reported as invalid."""
    transparent, opaque = opacity_logits(np.array([0, 255], dtype=np.uint8))
    return np.nan_to_num(logits, nan=np.nan, neginf=transparent, posinf=opaque)
