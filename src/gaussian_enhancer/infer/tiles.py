"""Enhancing large images in overlapping tiles, so that memory does not grow with the image.

Axes: b batch, h height, w width, H = scale h, W = scale w, n pixels of a tile along an axis.
"""

from collections.abc import Callable, Iterator

import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.types import NetworkInput

Network = Callable[[NetworkInput], Float[Tensor, "b 3 H W"]]


def enhance_tiled(
    network: Network,
    views: NetworkInput,
    tile: int = 768,
    halo: int = 64,
    blend: int = 32,
    stride: int = 16,
    scale: int = 1,
) -> Float[Tensor, "b 3 H W"]:
    """Run a network over overlapping tiles and blend them.

    Each tile has a halo, which is discarded, and a ramp over which it fades into its neighbour. The result equals that
    of the whole image where the halo is as wide as the network's receptive field; the ramp hides the difference
    elsewhere. Depth is normalised by the whole image's ``depth_unit``, which must be given where depth is.

    Args:
        network: maps views to enhanced images.
        views: the whole image.
        tile: side of a tile with its halo; a multiple of stride. This and the next three are in pixels of the render.
        halo: pixels on each inner side that are computed and discarded, a multiple of stride.
        blend: pixels over which neighbours fade into each other, a multiple of stride.
        stride: tiles start at multiples of this, as the network's own grid does.
        scale: resolution of the enhanced image relative to the render's.

    Raises:
        InputError: the tile leaves no room within its halo, or sides are no multiples of the stride.
    """
    check_tiles(tile, halo, blend, stride)
    height, width = views.render.shape[-2:]
    if height <= tile and width <= tile:
        return network(views)
    result = views.render.new_zeros(len(views.render), 3, scale * height, scale * width)
    grid = scale * tile, scale * halo, scale * blend
    columns = list(_weighted_spans(scale * width, *grid))
    for top, bottom, down in _weighted_spans(scale * height, *grid):
        for left, right, across in columns:
            enhanced = network(_crop(views, *(side // scale for side in (top, bottom, left, right))))
            weight = (down[:, None] * across).to(result)
            result[..., top:bottom, left:right].addcmul_(weight, enhanced.to(result))
    return result


def check_tiles(tile: int, halo: int = 64, blend: int = 32, stride: int = 16) -> None:
    """Refuse sizes that `enhance_tiled` cannot use.

    Raises:
        InputError: the tile leaves no room within its halo, or sides are no multiples of the stride.
    """
    if any(side % stride for side in (tile, halo, blend)):
        raise InputError("tile", f"has sides {tile}, {halo}, {blend}", f"use multiples of {stride}")
    if tile < 2 * halo + 2 * blend:
        raise InputError("tile", f"is {tile} with a halo of {halo}", f"use at least {2 * halo + 2 * blend}")


def _spans(length: int, tile: int, halo: int, blend: int) -> Iterator[tuple[int, int]]:
    """First and last (exclusive) pixel of the tiles along one axis; what is kept of them overlaps by the ramp."""
    step = tile - 2 * halo - blend
    start = 0
    while True:
        end = min(start + tile, length)
        yield start, end
        if end == length:
            return
        start += step


def _weighted_spans(length: int, tile: int, halo: int, blend: int) -> Iterator[tuple[int, int, Float[Tensor, " n"]]]:
    """The tiles along one axis with the weight of each of their pixels; over all tiles a pixel's weights sum to 1."""
    spans = list(_spans(length, tile, halo, blend))
    ramps = [_ramp(start, end, length, halo, blend) for start, end in spans]
    total = torch.zeros(length)
    for (start, end), ramp in zip(spans, ramps, strict=True):
        total[start:end] += ramp
    for (start, end), ramp in zip(spans, ramps, strict=True):
        yield start, end, ramp / total[start:end]


def _ramp(start: int, end: int, length: int, halo: int, blend: int) -> Float[Tensor, " n"]:
    """Weight of each pixel along one axis: 0 in the halo, rising over the ramp, 1 inside and at the image's border."""
    position = torch.arange(start, end, dtype=torch.float32) + 0.5
    before = torch.ones_like(position) if start == 0 else ((position - start - halo) / blend).clamp(0, 1)
    after = torch.ones_like(position) if end == length else ((end - halo - position) / blend).clamp(0, 1)
    return torch.minimum(before, after)


def _crop(views: NetworkInput, top: int, bottom: int, left: int, right: int) -> NetworkInput:
    return views.map_images(lambda image, n: image[..., n * top : n * bottom, n * left : n * right])
