"""Photo-consistency of warped references with the render and with each other, for ranking and for rejecting pixels.

Axes: h height, w width of the target.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from gaussian_enhancer.align.projection import can_use_kernels
from gaussian_enhancer.align.reproject import Warped
from gaussian_enhancer.types import numpy_view

WINDOW = 7
"""Side in pixels of the squares over which references are compared."""
OUTLIER_DIFFERENCE = 0.15
"""Colour difference of an outlier from the render and from another reference, in [0, 1]; outliers differ by more."""
OUTLIER_AGREEMENT = 0.6
"""Share of that difference by which the other reference may differ from the render."""
LEAST_VISIBILITY = 0.3
"""Product of the visibilities of two references below which they are not compared."""


def rank_references(weights: Sequence[Float[Tensor, "1 h w"]], keep: int) -> list[int]:
    """Indices of the references that together show most of the target, best first.

    References are selected greedily: the next one is that which increases the maximum weight so far the most. A tenth
    of its mean weight is added, so that photo-consistency decides between references that show the same.

    Args:
        weights: weight of each reference at each pixel, at least 0 (`reference_weight`).
        keep: maximum number of returned indices.
    """
    if not weights:
        return []
    flat_weights = [weight.flatten() for weight in weights]
    mean = torch.stack([weight.mean() for weight in flat_weights])
    order: list[int] = []
    candidates, increase, maximum = list(range(len(flat_weights))), mean, torch.zeros_like(flat_weights[0])
    while candidates and len(order) < keep:
        if order:
            maximum = torch.maximum(maximum, flat_weights[order[-1]])
            increase = torch.stack([(flat_weights[i] - maximum).clamp_min(0).mean() for i in candidates])
        gain = increase + 0.1 * mean[candidates]
        order.append(candidates.pop(int(gain.argmax()) if len(candidates) > 1 else 0))
    return order


def reference_weight(
    warped: Warped, difference: Float[Tensor, "1 h w"], softness: float = 0.08
) -> Float[Tensor, "1 h w"]:
    """Weight of a reference at each pixel: visibility x exp(-difference / softness).

    Args:
        warped: the reference on the render's grid.
        difference: difference from the render (`photometric_difference`).
        softness: colour difference at which the weight falls to 1/e.
    """
    return warped.visibility * torch.exp(difference * (-1 / softness))


def photometric_difference(warped: Warped, image: Float[Tensor, "3 h w"]) -> Float[Tensor, "1 h w"]:
    """Mean absolute colour difference of a reference to the render where it is visible, over 7x7 pixels.

    Args:
        warped: the reference on the render's grid.
        image: the render.
    """
    visibility = warped.visibility
    if can_use_kernels(warped.colour, image, visibility):
        return _photometric_difference_compiled(warped, image)
    difference = (warped.colour - image).abs().mean(0, keepdim=True)
    weighted, total = F.avg_pool2d(
        torch.cat([difference * visibility, visibility]), WINDOW, 1, WINDOW // 2, count_include_pad=False
    ).split(1)
    return weighted / total.clamp_min(1e-6)


def _photometric_difference_compiled(warped: Warped, image: Float[Tensor, "3 h w"]) -> Float[Tensor, "1 h w"]:
    """Compiled version of `photometric_difference`."""
    from gaussian_enhancer.align.reproject_kernels import window_difference
    from gaussian_enhancer.compiled import kernel_lock

    result = torch.empty_like(warped.visibility, memory_format=torch.contiguous_format)
    with kernel_lock:
        window_difference(
            numpy_view(warped.colour),
            numpy_view(image),
            numpy_view(warped.visibility[0]),
            WINDOW // 2,
            result[0].numpy(),
        )
    return result


def hide_inconsistent(
    warped: Sequence[Warped], differences: Sequence[Float[Tensor, "1 h w"]], limit: float
) -> list[Warped]:
    """Set a reference's visibility to 0 where it differs from the render by more than a limit or is an outlier.

    It is an outlier where the render and another reference contradict it and agree with each other. This rejects what
    only one photo shows, such as a passer-by or an over-exposed area, and errors of the warp.

    Args:
        warped: references on the render's grid.
        differences: difference of each from the render (`photometric_difference`).
        limit: largest accepted difference from the render, in [0, 1].
    """
    consistent = [difference <= limit for difference in differences]
    visibilities = [view.visibility * mask for view, mask in zip(warped, consistent, strict=True)]
    for i, j in combinations(range(len(warped)), 2):
        visibility = visibilities[i] * visibilities[j]
        between = photometric_difference(replace(warped[i], visibility=visibility), warped[j].colour)
        comparable = visibility > LEAST_VISIBILITY
        for one, other in ((i, j), (j, i)):
            contradiction = torch.minimum(between, differences[one])
            agrees = differences[other] < OUTLIER_AGREEMENT * contradiction
            consistent[one] = consistent[one] & ~((contradiction > OUTLIER_DIFFERENCE) & agrees & comparable)
    return [_keep(view, mask) for view, mask in zip(warped, consistent, strict=True)]


def _keep(warped: Warped, kept: Bool[Tensor, "1 h w"]) -> Warped:
    """A reference with visibility and colours of 0 outside of a mask."""
    mask = kept.to(warped.visibility.dtype)
    render = None if warped.render is None else warped.render * mask
    return replace(warped, colour=warped.colour * mask, visibility=warped.visibility * mask, render=render)
