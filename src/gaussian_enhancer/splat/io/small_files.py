"""Writing of small splat files for viewers: PlayCanvas compressed .ply and Niantic's .spz, by the package gsply.

Both formats store ellipsoids only, and neither has a field for Mip-Splatting's 3D filter. The filter is therefore
applied to scales and opacities before writing, as its authors do for viewers. A .spz has other axes than 3DGS's .ply.
gsply does not convert between them, so this module does.
"""

import math
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import atomic_write
from gaussian_enhancer.optional_library import optional_library
from gaussian_enhancer.splat.filters import apply_3d_filter
from gaussian_enhancer.splat.io.spz import half_turn
from gaussian_enhancer.types import Gaussians, numpy_view

ENDINGS: Mapping[str, str] = {"compressed": ".compressed.ply", "spz": ".spz"}
"""File name ending of each format."""
MOST_BITS = 20
"""Largest number of fractional bits of a position in a .spz."""


def check_format(name: str, gaussians: Gaussians) -> None:
    """Raise an error for a format that is unknown, cannot hold a splat, or cannot be written here.

    Args:
        name: "compressed" or "spz".
        gaussians: the splat to be written.

    Raises:
        InputError: the format is unknown, the splat consists of disks, or gsply is not installed.
    """
    if name not in ENDINGS:
        raise InputError("format", f"is {name!r}", f"choose ply, {', '.join(ENDINGS)}")
    if gaussians.log_scales.shape[1] != 3:
        raise InputError(f"format={name}", "holds no disks of 2DGS", "use format=ply")
    _library()


def write_compressed(path: Path, gaussians: Gaussians, name: str) -> None:
    """Write a splat in a compressed format, which rounds its values.

    Args:
        path: the file to write, with the ending of the format (`ENDINGS`).
        gaussians: ellipsoids.
        name: "compressed" or "spz".

    Raises:
        InputError: see `check_format`; or the file cannot be written.
    """
    check_format(name, gaussians)
    converted = _apply_filter(gaussians.to("cpu"))
    converted = half_turn(converted) if name == "spz" else converted
    fields = {
        "means": converted.means,
        "scales": converted.log_scales,
        "quats": torch.nn.functional.normalize(converted.quaternions, dim=1),
        "opacities": converted.opacity_logits,
        "sh0": converted.sh[:, 0],
        "shN": converted.sh[:, 1:],
    }
    data = _library().GSData(**{key: numpy_view(value.float()) for key, value in fields.items()})
    with tempfile.TemporaryDirectory() as folder:  # gsply chooses the ending of its file itself
        gsply_file = Path(folder) / f"splat{ENDINGS[name]}"
        if name == "spz":
            _library().write_spz(gsply_file, data, fractional_bits=_fractional_bits(converted))
        else:
            _library().plywrite(gsply_file, data, compressed=True)
        content = gsply_file.read_bytes()
    with atomic_write(path) as temporary:
        temporary.write_bytes(content)


def _apply_filter(gaussians: Gaussians) -> Gaussians:
    """The splat with its 3D filter applied."""
    if gaussians.smoothing is None:
        return gaussians
    scales, opacities = apply_3d_filter(
        gaussians.log_scales.exp(), gaussians.opacity_logits.sigmoid(), gaussians.smoothing
    )
    opacities = opacities.clamp(1e-6, 1 - 1e-6)
    return replace(gaussians, log_scales=scales.log(), opacity_logits=opacities.logit(), smoothing=None)


def _fractional_bits(gaussians: Gaussians) -> int:
    """Number of fractional bits, of 24 in all, that the largest coordinate leaves, up to `MOST_BITS`."""
    largest = float(gaussians.means.abs().max()) if len(gaussians) else 1.0
    return max(1, min(MOST_BITS, 22 - math.floor(math.log2(max(largest, 1e-6)))))


def _library() -> Any:
    return optional_library("gsply", "format", "formats", otherwise="use format=ply")
