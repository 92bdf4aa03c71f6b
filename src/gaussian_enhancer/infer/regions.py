"""Regions of an image: finding the blocks to enhance, covering them with rectangles, and cropping a view.

Axes: h height, w width, i = ceil(h / BLOCK), j = ceil(w / BLOCK) blocks.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from gaussian_enhancer.align.alignment import LoadedView
from gaussian_enhancer.types import Region

BLOCK = 16
"""Side of a block in pixels. Crops at its multiples keep each pixel's position in the networks' downsampling grids."""


def background_blocks(
    image: Float[Tensor, "3 h w"], background: Sequence[float], tolerance: float
) -> Bool[Tensor, "i j"]:
    """Blocks that show only the background's colour.

    Opacity cannot find them, since sparse fits cover the background with Gaussians of its colour.

    Args:
        image: the render, [0, 1].
        background: the background's colour, [0, 1].
        tolerance: largest difference of any channel at any pixel of the block, in [0, 1].
    """
    colour = image.new_tensor(background)[:, None, None]
    difference = (image - colour).abs().amax(0)[None, None]
    return F.max_pool2d(difference, BLOCK, ceil_mode=True)[0, 0] <= tolerance


def cover_with_regions(needed: Bool[Tensor, "i j"], height: int, width: int, margin: int) -> tuple[Region, ...]:
    """Cover all needed blocks with rectangles.

    A recursive X-Y cut (Nagy and Seth, ICPR 1984): a rectangle is cut at rows or columns that contain no needed block,
    if the parts with their margins have less than four fifths of the area of the whole with its margin.

    Args:
        needed: blocks that must be covered.
        height: height of the image in pixels.
        width: width of the image in pixels.
        margin: width in pixels of the border around a region that is computed with it.
    """

    def pixels(box: tuple[int, int, int, int]) -> Region:
        top, left, bottom, right = (BLOCK * side for side in box)
        return Region(top, left, min(bottom, height), min(right, width))

    def cost(boxes: Sequence[tuple[int, int, int, int]]) -> int:
        return sum(pixels(box).expand(margin, height, width).area for box in boxes)

    def divided(box: tuple[int, int, int, int]) -> list[tuple[int, int, int, int]]:
        box_mask = mask[box[0] : box[2], box[1] : box[3]]
        for axis in (1, 0):
            filled_runs = list(_runs(np.asarray(box_mask.any(axis))))
            if len(filled_runs) < 2:
                continue
            offset = box[1 - axis]
            strips = [
                (offset + a, box[1], offset + b, box[3]) if axis else (box[0], offset + a, box[2], offset + b)
                for a, b in filled_runs
            ]
            parts = [part for strip in strips for part in divided(_tight_box(mask, strip))]
            if cost(parts) < 0.8 * cost([box]):
                return parts
        return [box]

    mask = needed.cpu().numpy()
    if not mask.any():
        return ()
    return tuple(map(pixels, divided(_tight_box(mask, (0, 0, *mask.shape)))))


def cut_pixels(target: LoadedView, region: Region) -> LoadedView:
    """Crop a target and its camera to a region.

    Args:
        target: render, with depth and opacity of the same size if they are known.
        region: the region in pixels of the render.
    """
    return replace(
        target,
        image=region.crop(target.image),
        camera=None if target.camera is None else target.camera.crop(region),
        depth=None if target.depth is None else region.crop(target.depth),
        alpha=None if target.alpha is None else region.crop(target.alpha),
    )


def _runs(filled: np.ndarray) -> Iterator[tuple[int, int]]:
    """Start and end (exclusive) of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], filled.astype(np.int8), [0]])))
    yield from zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)


def _tight_box(mask: np.ndarray, box: tuple[int, int, int, int]) -> tuple[int, int, int, int]:
    """The bounding box of the True entries within a box, which must contain at least one."""
    box_mask = mask[box[0] : box[2], box[1] : box[3]]
    rows, columns = np.flatnonzero(box_mask.any(1)), np.flatnonzero(box_mask.any(0))
    return box[0] + int(rows[0]), box[1] + int(columns[0]), box[0] + int(rows[-1]) + 1, box[1] + int(columns[-1]) + 1
