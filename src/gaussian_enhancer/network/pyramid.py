"""Padding, averaging and upsampling of network inputs.

Axes: b batch, h height, w width.
"""

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.align.depth_normalisation import depth_unit
from gaussian_enhancer.network.bfloat16 import can_fuse, can_use_kernels, kernel_lock, plane
from gaussian_enhancer.network.halving import halve
from gaussian_enhancer.types import NetworkInput, usable_depth


def pad_to_stride(views: NetworkInput, stride: int) -> NetworkInput:
    """Replicate the last row and column until both sides are multiples of a stride."""
    height, width = views.render.shape[-2:]
    bottom, right = -height % stride, -width % stride
    if bottom == 0 and right == 0:
        return views

    def pad(image: Tensor, finer: int) -> Tensor:
        bottom_margin, right_margin = finer * bottom, finer * right
        flat = image.reshape(-1, *image.shape[-3:])
        if flat.shape[0] == 0:
            return image.new_zeros(*image.shape[:-2], image.shape[-2] + bottom_margin, image.shape[-1] + right_margin)
        flat = F.pad(flat, (0, right_margin, 0, bottom_margin), mode="replicate")
        return flat.reshape(*image.shape[:-2], *flat.shape[-2:])

    return views.map_images(pad)


def average_views(views: NetworkInput) -> NetworkInput:
    """Average all images over squares of 2x2 pixels; sides are even.

    References and their renders are averaged with visibility as weight, depth as inverse depth over usable pixels. The
    depth unit remains that of the full size.

    Args:
        views: network input at full size.
    """
    photos, renders, share = _averaged_references(views)

    depth, unit = views.depth, views.depth_unit
    if depth is not None:
        unit = depth_unit(depth) if unit is None else unit
        usable = usable_depth(depth)
        inverse = torch.where(usable, 1 / torch.where(usable, depth, torch.ones_like(depth)), torch.zeros_like(depth))
        mean, covered = halve(inverse), halve(usable.to(depth.dtype))
        depth = torch.where(covered > 0, covered / torch.where(covered > 0, mean, torch.ones_like(mean)), 0.0)
    return NetworkInput(
        halve(views.render),
        photos,
        share,
        depth,
        None if views.alpha is None else halve(views.alpha),
        unit,
        renders,
    )


def three_scales(views: NetworkInput, stride: int) -> tuple[NetworkInput, NetworkInput, NetworkInput]:
    """Network inputs at 1/4, 1/2 and 1 of their size.

    Args:
        views: network input at full size.
        stride: both sides are padded to a multiple of this number, which is itself a multiple of 4.
    """
    full = pad_to_stride(views, stride)
    half = average_views(full)
    return average_views(half), half, full


def upsample_bicubic(image: Float[Tensor, "b c h w"], scale: int) -> Float[Tensor, "b c H W"]:
    """Upsample an image bicubically by an integer factor, without clamping."""
    if scale == 1:
        return image
    if scale in (2, 4) and image.dtype == torch.float32 and can_use_kernels(image):
        return _upsample_compiled(image, scale)
    return F.interpolate(image, scale_factor=scale, mode="bicubic", align_corners=False)


def _upsample_compiled(image: Float[Tensor, "b c h w"], scale: int) -> Float[Tensor, "b c H W"]:
    """Compiled version of `upsample_bicubic`, one axis after the other."""
    from gaussian_enhancer.network.ssif_sr_kernels import upsample

    height, width = image.shape[-2:]
    result = torch.empty(*image.shape[:-2], scale * height, scale * width)
    shares, starts = _cubic_phases(scale)
    with kernel_lock:
        upsample(plane(image.flatten(0, 1)), shares, starts, result.flatten(0, 1).numpy())
    return result


def _cubic_phases(scale: int) -> tuple[np.ndarray, np.ndarray]:
    """Weights of four pixels for each phase of a fine pixel, and offsets of the first one (Keys, 1981, a = -0.75)."""
    position = (np.arange(scale) + 0.5) / scale - 0.5
    floor = np.floor(position)
    distance = np.abs(np.arange(-1, 3) - (position - floor)[:, None])
    a = -0.75
    near = ((a + 2) * distance - (a + 3)) * distance**2 + 1
    far = ((a * distance - 5 * a) * distance + 8 * a) * distance - 4 * a
    return np.where(distance <= 1, near, far).astype(np.float32), floor.astype(np.int64) - 1


def _averaged_references(
    views: NetworkInput,
) -> tuple[Float[Tensor, "b r 3 _ _"], Float[Tensor, "b r 3 _ _"] | None, Float[Tensor, "b r 1 _ _"]]:
    """References and their renders, averaged with visibility as weight, and the mean visibility."""
    images = views.references, views.reference_renders, views.visibility
    if can_fuse(*images):
        return _halved_references(*images)
    share = halve(views.visibility)

    def visible_mean(image: Tensor) -> Tensor:
        return halve(image * views.visibility) / share.clamp_min(1e-6) * (share > 0)

    renders = views.reference_renders
    return visible_mean(views.references), None if renders is None else visible_mean(renders), share


def _halved_references(
    photos: Float[Tensor, "b r 3 h w"],
    renders: Float[Tensor, "b r 3 h w"] | None,
    visibility: Float[Tensor, "b r 1 h w"],
) -> tuple[Float[Tensor, "b r 3 _ _"], Float[Tensor, "b r 3 _ _"] | None, Float[Tensor, "b r 1 _ _"]]:
    """Compiled version of `_averaged_references`, in one pass over memory, where `can_fuse` holds."""
    from gaussian_enhancer.network.bfloat16_kernels import shrink

    inputs = [plane(image.flatten(0, 1)) for image in (photos, photos if renders is None else renders, visibility)]
    halved = [
        torch.empty(*image.shape[:-2], image.shape[-2] // 2, image.shape[-1] // 2)
        for image in (photos, photos, visibility)
    ]
    with kernel_lock:
        shrink(*inputs, np.float32(renders is not None), *(image.flatten(0, 1).numpy() for image in halved))
    return halved[0], None if renders is None else halved[1], halved[2]
