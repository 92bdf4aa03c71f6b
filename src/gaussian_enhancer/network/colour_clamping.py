"""Clamping of enhanced colours to the local range of render and references.

Axes: b batch, h height, w width.
"""

from collections.abc import Callable

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from gaussian_enhancer.align.projection import can_use_kernels
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.types import NetworkInput, numpy_view


def clamp_to_references(
    image: Float[Tensor, "b 3 h w"], views: NetworkInput, window: int = 3, clamp_unseen: bool = False
) -> Float[Tensor, "b 3 h w"]:
    """Clamp each channel of an image to the range of render and references in a window around the pixel.

    The limits are the minimum and the maximum over the window of the render and, where they are visible, of the
    references. Photos on the target's grid show which colours an enhanced pixel may have, up to misalignment. Colours
    outside that range are errors of the network, for instance bright patches in a shadow unlike those of its training
    data. The neighbourhood clamping of temporal anti-aliasing (Karis, "High-Quality Temporal Supersampling", SIGGRAPH
    2014) limits a history to the current frame in the same way. Pixels at which no reference is visible are
    clamped to [0, 1] alone: no photo shows their colours, and those of the render may be those of a hole of the splat.
    Gradients treat the limits as constants.

    Args:
        image: enhanced image, finite.
        views: render and warped references of the same size.
        window: side of the window in pixels, odd.
        clamp_unseen: also clamp pixels at which no reference is visible, in images with a visible reference.

    Raises:
        InputError: the window has no centre.
    """
    check_window(window)
    inputs = image, views.render, views.references, views.visibility
    clamp = clamp_compiled if can_use_kernels(*inputs) else clamp_torch
    return clamp(image, views, window // 2, clamp_unseen)


def clamp_torch(
    image: Float[Tensor, "b 3 h w"], views: NetworkInput, reach: int, clamp_unseen: bool = False
) -> Float[Tensor, "b 3 h w"]:
    """Clamp the image to the limits of its windows. Readable twin of the compiled kernel, for any device.

    Args:
        image: enhanced image.
        views: render and warped references of the same size.
        reach: pixels from a window's centre to its border.
        clamp_unseen: see `clamp_to_references`.
    """
    hidden = views.visibility <= 0
    limited = torch.empty_like(image, memory_format=torch.contiguous_format)
    for channel in range(3):  # one channel at a time, to limit the memory for large images
        low, high = _colour_limits(views, hidden, channel, reach)
        limited[:, channel] = image[:, channel].clamp(low, high)
    unseen = hidden.flatten(1).all(1)[:, None, None, None] if clamp_unseen else hidden.all(1)
    return torch.where(unseen, image.clamp(0, 1), limited)


def clamp_compiled(
    image: Float[Tensor, "b 3 h w"], views: NetworkInput, reach: int, clamp_unseen: bool = False
) -> Float[Tensor, "b 3 h w"]:
    """Compiled version of `clamp_torch`."""
    from gaussian_enhancer.compiled import kernel_lock
    from gaussian_enhancer.network.colour_clamping_kernels import clamp

    limited = torch.empty_like(image, memory_format=torch.contiguous_format)
    with kernel_lock:
        for index, result in enumerate(limited):
            inputs = (numpy_view(images[index]) for images in (image, views.render, views.references, views.visibility))
            clamps_all = clamp_unseen and bool((views.visibility[index] > 0).any())
            clamp(*inputs, reach, clamps_all, result.numpy())
    return limited


@torch.no_grad()
def _colour_limits(
    views: NetworkInput, hidden: Bool[Tensor, "b r 1 h w"], channel: int, reach: int
) -> tuple[Float[Tensor, "b h w"], Float[Tensor, "b h w"]]:
    """Minimum and maximum of a channel around each pixel."""
    low = views.render[:, channel].clone()
    high = low.clone()
    for i in range(views.references.shape[1]):
        photo, unseen = views.references[:, i, channel], hidden[:, i, 0]
        torch.minimum(low, photo.masked_fill(unseen, torch.inf), out=low)
        torch.maximum(high, photo.masked_fill(unseen, -torch.inf), out=high)
    for axis in (1, 2):
        low, high = (
            _spread_extremes(low, axis, reach, torch.minimum),
            _spread_extremes(high, axis, reach, torch.maximum),
        )
    return low, high


def check_window(window: int) -> None:
    """Refuse windows with an even side, which have no centre.

    Raises:
        InputError: the side is not odd, or not positive.
    """
    if window < 1 or window % 2 == 0:
        raise InputError("colour_clamping", f"is a window of {window} pixels", "use an odd number, or 0 for no limit")


def _spread_extremes(
    plane: Float[Tensor, "b h w"], axis: int, reach: int, choose: Callable[..., Tensor]
) -> Float[Tensor, "b h w"]:
    """Minimum or maximum within reach along an axis; windows are cropped at the border."""
    extremes = plane.clone()
    length = plane.shape[axis]
    for step in range(1, min(reach, length - 1) + 1):
        first, last = plane.narrow(axis, 0, length - step), plane.narrow(axis, step, length - step)
        before, after = extremes.narrow(axis, 0, length - step), extremes.narrow(axis, step, length - step)
        choose(before, last, out=before)
        choose(after, first, out=after)
    return extremes
