"""Photo-consistency of warped references with the render, for ranking and for rejecting pixels.

Axes: h height, w width of the target.
"""

from collections.abc import Sequence
from dataclasses import replace

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.align.projection import can_use_kernels, kernel_image
from gaussian_enhancer.align.reproject import Warped

WINDOW = 7
"""Side of the squares over which references are compared with the render, in pixels."""


def rank(worth: Sequence[Float[Tensor, "1 h w"]], keep: int) -> list[int]:
    """Indices of the references that together show most of the target, best first.

    The next one is always that which adds most to the best worth so far, counting a tenth of its own worth so that
    agreement decides among those that show the same.

    Args:
        worth: of each reference at each pixel, at least 0 (`reference_weight`).
        keep: how many to return at most.
    """
    if not worth:
        return []
    shown = [one.flatten() for one in worth]
    mean = torch.stack([one.mean() for one in shown])
    order: list[int] = []
    left, added, best = list(range(len(shown))), mean, torch.zeros_like(shown[0])
    while left and len(order) < keep:
        if order:
            best = torch.maximum(best, shown[order[-1]])
            added = torch.stack([(shown[i] - best).clamp_min(0).mean() for i in left])
        gain = added + 0.1 * mean[left]
        order.append(left.pop(int(gain.argmax()) if len(left) > 1 else 0))
    return order


def reference_weight(
    warped: Warped, difference: Float[Tensor, "1 h w"], softness: float = 0.08
) -> Float[Tensor, "1 h w"]:
    """A reference's worth at each pixel: visibility x exp(-difference / softness).

    Args:
        warped: the reference.
        difference: from the render (`photometric_difference`).
        softness: colour difference at which worth falls to 1/e.
    """
    return warped.visibility * torch.exp(difference * (-1 / softness))


def photometric_difference(warped: Warped, image: Float[Tensor, "3 h w"]) -> Float[Tensor, "1 h w"]:
    """Mean absolute colour difference of a reference to the render where it is visible, over 7x7 pixels.

    Args:
        warped: the reference on the render's grid.
        image: the render.
    """
    seen = warped.visibility
    if can_use_kernels(warped.colour, image, seen):
        return _rank_compiled(warped, image)
    difference = (warped.colour - image).abs().mean(0, keepdim=True)
    weighted, total = F.avg_pool2d(
        torch.cat([difference * seen, seen]), WINDOW, 1, WINDOW // 2, count_include_pad=False
    ).split(1)
    return weighted / total.clamp_min(1e-6)


def _rank_compiled(warped: Warped, image: Float[Tensor, "3 h w"]) -> Float[Tensor, "1 h w"]:
    """The same by a compiled kernel."""
    from gaussian_enhancer.align.reproject_kernels import window_difference
    from gaussian_enhancer.splat.compiled import kernel_lock

    result = torch.empty_like(warped.visibility, memory_format=torch.contiguous_format)
    with kernel_lock:
        window_difference(
            kernel_image(warped.colour),
            kernel_image(image),
            kernel_image(warped.visibility[0]),
            WINDOW // 2,
            result[0].numpy(),
        )
    return result


def hide_inconsistent(warped: Warped, difference: Float[Tensor, "1 h w"], limit: float) -> Warped:
    """Set the reference's visibility to 0 where it differs from the render by more than a limit.

    Args:
        warped: the reference on the render's grid.
        difference: from the render (`photometric_difference`).
        limit: of the difference, in [0, 1].
    """
    kept = (difference <= limit).to(difference.dtype)
    render = None if warped.render is None else warped.render * kept
    return replace(warped, colour=warped.colour * kept, visibility=warped.visibility * kept, render=render)
