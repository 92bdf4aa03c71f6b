"""PlayCanvas's compressed .ply, as SuperSplat and splat-transform write it (read only).

Element ``chunk`` holds, for each run of 256 Gaussians, the range of position, log scale and (newer files) base
colour. Element ``vertex`` holds four 32-bit words per Gaussian, most significant field first: position and scale
11-10-11 bits within the chunk's range, rotation 2-10-10-10 (index of the largest of w, x, y, z, then the other
three over +-1/sqrt(2)), colour 8-8-8 with 8 bits of opacity. Element ``sh``, if present, holds the higher harmonics as
bytes over [-4, 4], channel-major as in 3DGS. Source: the format as documented by PlayCanvas (splat-transform, MIT).

Axes: n Gaussians.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.splat.io.ply import read_elements
from gaussian_enhancer.splat.io.quantised import bit_field, complete_quaternion, float_tensor, opacity_logits
from gaussian_enhancer.splat.io.validity import refuse_or_drop_invalid
from gaussian_enhancer.splat.oracle import SH_0
from gaussian_enhancer.types import Gaussians

_CHUNK = 256
_PACKED = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
_REMEDY = "export the splat again with SuperSplat or splat-transform"


def read_compressed_ply(path: str | Path, *, invalid: str = "refuse") -> Gaussians:
    """Read PlayCanvas's compressed .ply, float32 on the CPU.

    Args:
        path: the file.
        invalid: what to do with Gaussians that cannot be rendered: "refuse" or "drop".

    Raises:
        InputError: if the file is missing, truncated, of another layout, or holds invalid Gaussians that are refused.
    """
    elements = read_elements(path)
    for name in ("chunk", "vertex"):
        if name not in elements:
            raise InputError(path, f"has no {name} element", "read it as a plain .ply, or export it again")
    chunk, vertex = elements["chunk"], elements["vertex"]
    _check(path, chunk, vertex, elements.get("sh"))
    # The range of each Gaussian's values: that of its chunk, repeated for the chunk's 256 Gaussians.
    ranges = np.repeat(chunk, _CHUNK)[: len(vertex)]
    colour = np.stack([bit_field(vertex["packed_color"], shift, 8) for shift in (24, 16, 8)], axis=1)
    if "min_r" in (chunk.dtype.names or ()):
        colour = _within_range(ranges, colour, ("r", "g", "b"))
    sh = ((colour - 0.5) / SH_0)[:, None, :]
    if "sh" in elements:
        sh = np.concatenate([sh, _higher_harmonics(elements["sh"])], axis=1)
    gaussians = Gaussians(
        means=float_tensor(_within_range(ranges, _triple(vertex["packed_position"]), ("x", "y", "z"))),
        log_scales=float_tensor(
            _within_range(ranges, _triple(vertex["packed_scale"]), ("scale_x", "scale_y", "scale_z"))
        ),
        quaternions=float_tensor(_rotations(vertex["packed_rotation"])),
        opacity_logits=float_tensor(opacity_logits((vertex["packed_color"] & np.uint32(255)).astype(np.uint8))),
        sh=float_tensor(sh),
    )
    return refuse_or_drop_invalid(path, gaussians, invalid)


def _check(path: str | Path, chunk: np.ndarray, vertex: np.ndarray, sh: np.ndarray | None) -> None:
    """Raise an error for a layout or a count that would be misread."""
    axes: tuple[str, ...] = ("x", "y", "z", "scale_x", "scale_y", "scale_z")
    if "min_r" in (chunk.dtype.names or ()):
        axes = (*axes, "r", "g", "b")
    required = [f"{end}_{axis}" for end in ("min", "max") for axis in axes]
    missing = [name for name in required if name not in (chunk.dtype.names or ())]
    missing += [name for name in _PACKED if name not in (vertex.dtype.names or ())]
    if missing:
        raise InputError(path, f"has no {', '.join(missing)}", _REMEDY)
    if any(vertex.dtype[name] != np.dtype("u4") for name in _PACKED):
        raise InputError(path, "has packed properties that are not of type uint", _REMEDY)
    expected = -(-len(vertex) // _CHUNK)
    if len(chunk) != expected:
        received = f"has {len(chunk)} chunks where {len(vertex)} Gaussians need {expected}"
        raise InputError(path, received, _REMEDY)
    if sh is None:
        return
    if len(sh) != len(vertex):
        raise InputError(path, f"has harmonics for {len(sh)} of {len(vertex)} Gaussians", _REMEDY)
    names = sh.dtype.names or ()
    if len(names) not in (9, 24, 45) or set(names) != {f"f_rest_{i}" for i in range(len(names))}:
        raise InputError(path, f"has {len(names)} f_rest properties", "export 9, 24 or 45 (degree 1 to 3)")


def _triple(packed: np.ndarray) -> Float[np.ndarray, "n 3"]:
    """The three fields of 11-10-11 words, as fractions in [0, 1]."""
    return np.stack([bit_field(packed, 21, 11), bit_field(packed, 11, 10), bit_field(packed, 0, 11)], axis=1)


def _within_range(ranges: np.ndarray, fraction: np.ndarray, axes: tuple[str, ...]) -> Float[np.ndarray, "n 3"]:
    """Convert fractions to values between the ``min_`` and ``max_`` of their chunks."""
    low = np.stack([ranges[f"min_{axis}"] for axis in axes], axis=1).astype(np.float64)
    high = np.stack([ranges[f"max_{axis}"] for axis in axes], axis=1).astype(np.float64)
    return low * (1.0 - fraction) + high * fraction


def _rotations(packed: np.ndarray) -> Float[np.ndarray, "n 4"]:
    """Quaternions (w, x, y, z) of 2-10-10-10 words."""
    components = np.stack([bit_field(packed, shift, 10) for shift in (20, 10, 0)], axis=1)
    return complete_quaternion((components - 0.5) * np.sqrt(2.0), (packed >> np.uint32(30)).astype(np.int64))


def _higher_harmonics(sh: np.ndarray) -> Float[np.ndarray, "n k 3"]:
    """Coefficients of degree 1 and up from bytes; the bytes 0 and 255 stand for the ends of the range."""
    count = len(sh.dtype.names or ())
    stored_bytes = np.stack([sh[f"f_rest_{i}"] for i in range(count)], axis=1).astype(np.float64)
    fraction = np.where(stored_bytes == 0, 0.0, np.where(stored_bytes == 255, 1.0, (stored_bytes + 0.5) / 256.0))
    return ((fraction - 0.5) * 8.0).reshape(len(sh), 3, count // 3).transpose(0, 2, 1)
