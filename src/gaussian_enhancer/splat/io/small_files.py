"""Splats as small files for viewers: PlayCanvas compressed .ply and Niantic's .spz, written by the package gsply.

Both store ellipsoids alone. Mip-Splatting's 3D filter has no place in them. It is applied to scales and opacities
first, as its authors do for viewers. A .spz has axes of its own, into which gsply does not turn a splat. That is done
here.
"""

import math
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import whole_file
from gaussian_enhancer.optional_library import optional_library
from gaussian_enhancer.splat.filters import apply_3d_filter
from gaussian_enhancer.splat.io.spz import half_turn
from gaussian_enhancer.types import Gaussians

ENDINGS: Mapping[str, str] = {"compressed": ".compressed.ply", "spz": ".spz"}
"""How files of each format end."""
MOST_BITS = 20
"""Of a position in a .spz behind the binary point."""


def check_format(name: str, gaussians: Gaussians) -> None:
    """Refuse a format that is unknown, cannot hold a splat, or cannot be written here.

    Args:
        name: "compressed" or "spz".
        gaussians: what would be written.

    Raises:
        InputError: the format is unknown, the splat consists of disks, or gsply is not installed.
    """
    if name not in ENDINGS:
        raise InputError("format", f"is {name!r}", f"choose ply, {', '.join(ENDINGS)}")
    if gaussians.log_scales.shape[1] != 3:
        raise InputError(f"format={name}", "holds no disks of 2DGS", "use format=ply")
    _library()


def write_small(path: Path, gaussians: Gaussians, name: str) -> None:
    """Write a splat in a format that rounds it.

    Args:
        path: with the ending of the format (`ENDINGS`).
        gaussians: ellipsoids.
        name: "compressed" or "spz".

    Raises:
        InputError: see `check_format`; or the file cannot be written.
    """
    check_format(name, gaussians)
    shown_gaussians = _apply_filter(gaussians.to("cpu"))
    shown_gaussians = half_turn(shown_gaussians) if name == "spz" else shown_gaussians
    parts = {
        "means": shown_gaussians.means,
        "scales": shown_gaussians.log_scales,
        "quats": torch.nn.functional.normalize(shown_gaussians.quaternions, dim=1),
        "opacities": shown_gaussians.opacity_logits,
        "sh0": shown_gaussians.sh[:, 0],
        "shN": shown_gaussians.sh[:, 1:],
    }
    data = _library().GSData(**{key: value.detach().float().contiguous().numpy() for key, value in parts.items()})
    with tempfile.TemporaryDirectory() as folder:  # gsply chooses the ending of what it writes
        made = Path(folder) / f"splat{ENDINGS[name]}"
        if name == "spz":
            _library().write_spz(made, data, fractional_bits=_fractional_bits(shown_gaussians))
        else:
            _library().plywrite(made, data, compressed=True)
        content = made.read_bytes()
    with whole_file(path) as temporary:
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
    """As many of a position's 24 bits behind the point as its largest coordinate leaves."""
    largest = float(gaussians.means.abs().max()) if len(gaussians) else 1.0
    return max(1, min(MOST_BITS, 22 - math.floor(math.log2(max(largest, 1e-6)))))


def _library() -> Any:
    return optional_library("gsply", "format", "formats", otherwise="use format=ply")
