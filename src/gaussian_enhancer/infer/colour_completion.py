"""Extrapolation of a network's colour change to pixels that no reference shows.

A network corrects a render where warped photos show it, and changes little elsewhere. If it removes haze in one half of
an image, an edge is visible where the correction ends. Here the smooth part of the change is modelled from the pixels
that references show, and elsewhere the model's prediction replaces it. The model is that of the guided filter (He et
al., "Guided Image Filtering", TPAMI 2013): within a window, the change is an affine function of the render's colour.

Axes: b batch, h height, w width, i j cells of a coarse grid, c output channel, k input channel.
"""

from collections.abc import Callable

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.align.projection import can_use_kernels
from gaussian_enhancer.types import NetworkInput, numpy_view

GRID = 100
"""Cells of the coarse grid along an image's longer side."""
WINDOW, SMOOTH, EDGE = 6.0, 2.0, 1.0
"""Standard deviations in cells: of the model's window, of the blur that extracts the smooth part, and of the transition
between pixels that references show and others."""
REGULARISATION = 1e-3
"""Variance of colour below which the model hardly depends on colour; epsilon of He et al."""
PRIOR = 0.01
"""Visible share of a window at which its own model and that of the whole image have equal weight."""

OPAQUE = 0.5
"""Opacity from which the completion is applied in full; below, its share falls linearly to 0."""


def complete_change(enhanced: Float[Tensor, "b 3 h w"], views: NetworkInput) -> Float[Tensor, "b 3 h w"]:
    """Replace the smooth part of the change where no reference is visible by the one that visible pixels predict.

    Pixels stay as they are where references are visible, where the render's opacity is zero, and in images in which no
    reference is visible at all.

    Args:
        enhanced: the network's output, in [0, 1].
        views: the render, the visibility of its references and its opacity.

    Returns:
        Colours that may leave [0, 1] slightly.
    """
    visibility = (
        views.visibility.amax(1).float() if views.visibility.shape[1] else torch.zeros_like(views.render[:, :1])
    )
    if not bool((visibility > 0).any()):
        return enhanced
    size = enhanced.shape[-2:]
    grid_size = [max(1, round(side * min(1.0, GRID / max(size)))) for side in size]
    render, change, weight = (
        F.interpolate(image.float(), grid_size, mode="area")
        for image in (views.render, enhanced - views.render, visibility)
    )
    matrix, offset = _colour_model(render, change, weight)
    unseen = (1 - _blur(weight, EDGE)) * (visibility.flatten(1).amax(1) > 0)[:, None, None, None]
    model = torch.cat([matrix.flatten(1, 2), offset - _blur(change, SMOOTH), unseen], dim=1)
    opaque = torch.ones_like(visibility) if views.alpha is None else (views.alpha / OPAQUE).clamp(max=1)
    complete = complete_compiled if can_use_kernels(enhanced, views.render, opaque, model) else complete_torch
    return complete(enhanced, views.render, opaque, model)


def complete_torch(
    enhanced: Float[Tensor, "b 3 h w"],
    render: Float[Tensor, "b 3 h w"],
    opaque: Float[Tensor, "b 1 h w"],
    model: Float[Tensor, "b 13 i j"],
) -> Float[Tensor, "b 3 h w"]:
    """Compute enhanced + unseen x opaque x (matrix render + offset), with the model interpolated between cell centres.

    Readable equivalent of the compiled kernel, on any device. Interpolation is linear.

    Args:
        enhanced: the network's output.
        render: the render.
        opaque: share of the completion that is applied at a pixel.
        model: the matrix's nine values by rows, the three offsets, and ``unseen``: the degree, in [0, 1], to which no
            reference shows a cell.
    """
    size = enhanced.shape[-2:]
    unseen = F.interpolate(model[:, 12:], size, mode="bilinear", align_corners=False) * opaque
    images = []
    for channel in range(3):  # one at a time, so that large images need little memory
        planes = torch.cat([model[:, 3 * channel : 3 * channel + 3], model[:, 9 + channel, None]], dim=1)
        pixel_model = F.interpolate(planes, size, mode="bilinear", align_corners=False)
        change = (pixel_model[:, :3] * render).sum(1) + pixel_model[:, 3]
        images.append(enhanced[:, channel] + unseen[:, 0] * change)
    return torch.stack(images, dim=1)


def complete_compiled(
    enhanced: Float[Tensor, "b 3 h w"],
    render: Float[Tensor, "b 3 h w"],
    opaque: Float[Tensor, "b 1 h w"],
    model: Float[Tensor, "b 13 i j"],
) -> Float[Tensor, "b 3 h w"]:
    """Compute `complete_torch` by the compiled kernel."""
    from gaussian_enhancer.compiled import kernel_lock
    from gaussian_enhancer.infer.colour_completion_kernels import complete

    result = torch.empty_like(enhanced, memory_format=torch.contiguous_format)
    with kernel_lock:
        for b, image in enumerate(result):
            inputs = (
                numpy_view(enhanced[b]),
                numpy_view(render[b]),
                numpy_view(opaque[b, 0]),
                numpy_view(model[b]),
            )
            complete(*inputs, image.numpy())
    return result


def _colour_model(
    render: Float[Tensor, "b 3 i j"], change: Float[Tensor, "b 3 i j"], weight: Float[Tensor, "b 1 i j"]
) -> tuple[Float[Tensor, "b 3 3 i j"], Float[Tensor, "b 3 i j"]]:
    """Matrix and offset of each window's affine model; those of the whole image where little of a window is visible."""
    visible_share = _blur(weight, WINDOW)
    matrix, offset = _fit_affine(render, change, weight, lambda image: _blur(image, WINDOW))
    image_fit = _fit_affine(render, change, weight, lambda image: image.mean((2, 3), keepdim=True))
    share = visible_share / (visible_share + PRIOR)
    return share[:, None] * matrix + (1 - share[:, None]) * image_fit[0], share * offset + (1 - share) * image_fit[1]


def _fit_affine(
    render: Tensor, change: Tensor, weight: Tensor, averaged: Callable[[Tensor], Tensor]
) -> tuple[Float[Tensor, "b 3 3 i j"], Float[Tensor, "b 3 i j"]]:
    """Weighted least-squares fit of the change as an affine function of colour, over the windows of ``averaged``."""
    mean_weight = averaged(weight).clamp_min(1e-6)
    mean_colour, mean_change = averaged(render * weight) / mean_weight, averaged(change * weight) / mean_weight
    pairs = torch.cat([render, change], dim=1)[:, :, None] * render[:, None]
    second_moments = averaged((pairs * weight[:, None]).flatten(1, 2)).unflatten(1, (6, 3)) / mean_weight[:, None]
    covariance = second_moments[:, :3] - mean_colour[:, :, None] * mean_colour[:, None]
    cross_covariance = second_moments[:, 3:] - mean_change[:, :, None] * mean_colour[:, None]
    regularised = covariance.permute(0, 3, 4, 1, 2) + REGULARISATION * torch.eye(3).to(covariance)
    matrix = torch.linalg.solve(regularised, cross_covariance.permute(0, 3, 4, 2, 1)).permute(0, 4, 3, 1, 2)
    return matrix, mean_change - (matrix * mean_colour[:, None]).sum(2)


def _blur(image: Float[Tensor, "b c i j"], deviation: float) -> Float[Tensor, "b c i j"]:
    """Gaussian blur with replicated borders. Kornia has the same, but takes 0.7 s to import."""
    radius = int(3 * deviation)
    offsets = torch.arange(-radius, radius + 1, dtype=image.dtype, device=image.device)
    weights = torch.exp(-offsets.square() / (2 * deviation**2))
    weights = (weights / weights.sum()).expand(image.shape[1], 1, 1, -1)
    padded = F.pad(image, (radius, radius, radius, radius), mode="replicate")
    rows = F.conv2d(padded, weights, groups=image.shape[1])
    return F.conv2d(rows, weights.transpose(2, 3), groups=image.shape[1])
