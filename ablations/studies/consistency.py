"""Temporal consistency of a sequence of images: neighbouring frames are compared after warping one onto the other.

Axes: h height, w width.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.align.reproject import reproject
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.types import Camera, quantise_8_bit

TOLERANCE = 0.02
"""Standard deviation of the relative depth difference of one surface."""
PROTOCOL = (
    "8-bit images; the next frame read bilinearly through this frame's rendered depth; pixels weighed by visibility, "
    f"relative depth difference of one standard deviation {TOLERANCE}"
)
"""Protocol of all records of consistency."""


@dataclass(frozen=True)
class FrameGeometry:
    """Camera and geometry of a frame, independent of the method that made its image.

    Args:
        camera: camera of the frame's size.
        depth: rendered z in scene units, 0 where nothing was hit.
        alpha: rendered opacity; with None, holes of the depth count as invisible.
    """

    camera: Camera
    depth: Float[Tensor, "1 h w"]
    alpha: Float[Tensor, "1 h w"] | None = None


@dataclass(frozen=True)
class WarpedError:
    """Difference between a frame and another one warped onto it.

    Args:
        mean: mean absolute colour difference over visible pixels, [0, 1]; NaN if no pixel is visible.
        rms: root mean square colour difference over the same pixels.
        visible: share of the frame's pixels that both frames show.
    """

    mean: float
    rms: float
    visible: float

    @property
    def decibel(self) -> float:
        """-20 log10 of ``rms``: the short-range error as a PSNR; infinite for equal frames."""
        return math.inf if self.rms == 0 else -20 * math.log10(self.rms)


def warped_error(
    image: Float[Tensor, "3 h w"], geometry: FrameGeometry, other: Float[Tensor, "3 h w"], other_geometry: FrameGeometry
) -> WarpedError:
    """Warp another frame onto this one through this frame's depth, and compare them where both show the same surface.

    With v the visibility from `reproject` (inside, in front, opaque, depths agree) and J the warped other frame:
    mean = sum v |I - J| / (3 sum v), rms = sqrt(sum v (I - J)^2 / (3 sum v)).

    Bilinear sampling blurs J, so that sharp frames differ slightly even if they are consistent: compare the result with
    that of photos along the same path. Source: the short-range consistency of Huang et al., Learning to Stylize Novel
    Views, ICCV 2021, with rendered depth in place of optical flow.

    Args:
        image: this frame, [0, 1]; quantised to 8 bits as in `measure_pair`.
        geometry: its camera and geometry.
        other: the other frame, [0, 1]; quantised likewise.
        other_geometry: its camera and geometry.

    Raises:
        InputError: an image, its depth and its camera differ in size.
    """
    for frame, frame_geometry in ((image, geometry), (other, other_geometry)):
        _same_size(frame, frame_geometry)
    depth_test = other_geometry.depth, geometry.alpha, TOLERANCE
    warped = reproject(geometry.camera, geometry.depth, other_geometry.camera, quantise_8_bit(other), *depth_test)
    weight = warped.visibility.double()
    total = float(weight.sum())
    if total == 0:
        return WarpedError(math.nan, math.nan, 0.0)
    difference = (quantise_8_bit(image) - warped.colour).double()
    mean = float((difference.abs() * weight).sum()) / (3 * total)
    square = float((difference.square() * weight).sum()) / (3 * total)
    return WarpedError(mean, math.sqrt(square), total / weight.numel())


def sequence_errors(
    images: Sequence[Float[Tensor, "3 h w"]], geometries: Sequence[FrameGeometry]
) -> tuple[WarpedError, ...]:
    """The `warped_error` of every frame with the next one warped onto it.

    Args:
        images: frames along a path.
        geometries: camera and geometry of each frame.

    Raises:
        InputError: counts differ, or there are fewer than two frames.
    """
    if len(images) != len(geometries):
        raise InputError("frames", f"are {len(images)} for {len(geometries)} places", "give one place for each frame")
    if len(images) < 2:
        raise InputError("frames", f"are {len(images)}", "give at least two to compare")
    neighbours = itertools.pairwise(zip(images, geometries, strict=True))
    return tuple(warped_error(*frame, *next_frame) for frame, next_frame in neighbours)


def _same_size(image: Tensor, geometry: FrameGeometry) -> None:
    sizes = [tuple(image.shape[-2:]), tuple(geometry.depth.shape[-2:]), (geometry.camera.height, geometry.camera.width)]
    if len(set(sizes)) > 1:
        size_texts = " and ".join(f"{width}x{height}" for height, width in dict.fromkeys(sizes))
        raise InputError("frame", f"has image, depth and camera of {size_texts}", "bring them to one size")
