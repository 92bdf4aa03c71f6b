"""Which parts of an image need work, as few rectangles, and cutting a view down to one of them.

Axes: h height, w width, i = ceil(h / BLOCK), j = ceil(w / BLOCK) blocks.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from gaussian_enhancer.align.alignment import Pixels
from gaussian_enhancer.types import Camera

BLOCK = 16
"""Side of a block in pixels: networks halve their grid at multiples of it, so that a cut moves no pixel's phase."""


@dataclass(frozen=True)
class Region:
    """A rectangle of pixels; ``bottom`` and ``right`` lie outside."""

    top: int
    left: int
    bottom: int
    right: int

    @property
    def area(self) -> int:
        """Number of pixels."""
        return (self.bottom - self.top) * (self.right - self.left)

    def grown(self, margin: int, height: int, width: int) -> "Region":
        """The region with a margin on every side, within an image."""
        top, left = max(0, self.top - margin), max(0, self.left - margin)
        return Region(top, left, min(height, self.bottom + margin), min(width, self.right + margin))

    def within(self, outer: "Region") -> "Region":
        """The same pixels, counted from another region's first."""
        return Region(self.top - outer.top, self.left - outer.left, self.bottom - outer.top, self.right - outer.left)

    def cut(self, image: Tensor, scale: int = 1) -> Tensor:
        """The region's part of an image (..., height, width) on a grid that is finer by ``scale``."""
        rows, columns = (slice(scale * a, scale * b) for a, b in ((self.top, self.bottom), (self.left, self.right)))
        return image[..., rows, columns]


def background_blocks(
    image: Float[Tensor, "3 h w"], background: Sequence[float], tolerance: float
) -> Bool[Tensor, "i j"]:
    """Blocks that show nothing but the background's colour.

    Opacity does not tell them: sparse fits put Gaussians of the background's colour all over it.

    Args:
        image: the render, [0, 1].
        background: the colour under it, [0, 1].
        tolerance: largest difference of any channel at any pixel of the block, in [0, 1].
    """
    colour = image.new_tensor(background)[:, None, None]
    difference = (image - colour).abs().amax(0)[None, None]
    return F.max_pool2d(difference, BLOCK, ceil_mode=True)[0, 0] <= tolerance


def regions_of(needed: Bool[Tensor, "i j"], height: int, width: int, margin: int) -> tuple[Region, ...]:
    """Rectangles that hold all blocks that need work: one, or several where gaps between them are worth it.

    A recursive X-Y cut (Nagy and Seth, ICPR 1984): a rectangle is cut at rows and columns without a needed block, as
    long as the parts with their margins are smaller than four fifths of the whole with its own.

    Args:
        needed: blocks that need work.
        height: of the image, in pixels.
        width: of the image, in pixels.
        margin: pixels around a region that are computed as well.
    """

    def pixels(box: tuple[int, int, int, int]) -> Region:
        top, left, bottom, right = (BLOCK * side for side in box)
        return Region(top, left, min(bottom, height), min(right, width))

    def cost(boxes: Sequence[tuple[int, int, int, int]]) -> int:
        return sum(pixels(box).grown(margin, height, width).area for box in boxes)

    def divided(box: tuple[int, int, int, int]) -> list[tuple[int, int, int, int]]:
        inside = mask[box[0] : box[2], box[1] : box[3]]
        for axis in (1, 0):
            runs = list(_runs(np.asarray(inside.any(axis))))
            if len(runs) < 2:
                continue
            offset = box[1 - axis]
            strips = [
                (offset + a, box[1], offset + b, box[3]) if axis else (box[0], offset + a, box[2], offset + b)
                for a, b in runs
            ]
            parts = [part for strip in strips for part in divided(_tightened(mask, strip))]
            if cost(parts) < 0.8 * cost([box]):
                return parts
        return [box]

    mask = needed.cpu().numpy()
    if not mask.any():
        return ()
    return tuple(map(pixels, divided(_tightened(mask, (0, 0, *mask.shape)))))


def cut_pixels(target: Pixels, region: Region) -> Pixels:
    """A target as if its camera had taken the region alone.

    Args:
        target: render, and depth and opacity of its size where they are known.
        region: what is kept.
    """
    return replace(
        target,
        image=region.cut(target.image),
        camera=None if target.camera is None else cut_camera(target.camera, region),
        depth=None if target.depth is None else region.cut(target.depth),
        alpha=None if target.alpha is None else region.cut(target.alpha),
    )


def cut_camera(camera: Camera, region: Region) -> Camera:
    """The camera of a region: its principal point moves, what its pixels see stays."""
    K = camera.K.clone()
    K[0, 2] -= region.left
    K[1, 2] -= region.top
    return replace(camera, K=K, height=region.bottom - region.top, width=region.right - region.left)


def _runs(filled: np.ndarray) -> Iterator[tuple[int, int]]:
    """First and last (outside) index of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], filled.astype(np.int8), [0]])))
    yield from zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)


def _tightened(mask: np.ndarray, box: tuple[int, int, int, int]) -> tuple[int, int, int, int]:
    """The smallest box around what is True in a box that holds something."""
    inside = mask[box[0] : box[2], box[1] : box[3]]
    rows, columns = np.flatnonzero(inside.any(1)), np.flatnonzero(inside.any(0))
    return box[0] + int(rows[0]), box[1] + int(columns[0]), box[0] + int(rows[-1]) + 1, box[1] + int(columns[-1]) + 1
