"""Carrying a network's change of colour on to where no reference reaches.

A network corrects a render where warped photos show it. Where none does, it hardly changes anything. A haze that is
taken away in one half of an image then ends in an outline. Here the smooth part of the change is modelled from the
pixels that references see, and the model's prediction takes its place elsewhere. The model is the guided filter's (He
et al., "Guided Image Filtering", TPAMI 2013): within a window, the change is an affine function of the render's colour.

Axes: b batch, h height, w width, i j cells of a coarse grid, c output channel, k input channel.
"""

from collections.abc import Callable

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.align.projection import array, compiled
from gaussian_enhancer.types import NetworkInput

GRID = 100
"""Cells of the coarse grid along an image's longer side."""
WINDOW, SMOOTH, EDGE = 6.0, 2.0, 1.0
"""Standard deviations, in cells, of the model's window, of what counts as smooth, and of the border between what
references see and what they do not."""
REGULARISATION = 1e-3
"""Variance of colour below which the model does not follow it: He et al.'s epsilon."""
PRIOR = 0.01
"""Share of a window that must be visible for its model to count as much as the whole image's."""

OPAQUE = 0.5
"""Opacity from which a pixel is treated as a surface; towards 0 it is more and more left as it is."""


def complete_change(enhanced: Float[Tensor, "b 3 h w"], views: NetworkInput) -> Float[Tensor, "b 3 h w"]:
    """The enhanced image; where no reference is visible, its change is the smooth one that visible pixels predict.

    Nothing changes where references are visible, where the render's opacity is zero, and in images of which no
    reference shows anything.

    Args:
        enhanced: what the network made of the render, in [0, 1].
        views: the render, the visibility of its references and its opacity.

    Returns:
        Colours that may leave [0, 1] slightly.
    """
    visible = views.visibility.amax(1).float() if views.visibility.shape[1] else torch.zeros_like(views.render[:, :1])
    if not bool((visible > 0).any()):
        return enhanced
    size = enhanced.shape[-2:]
    cells = [max(1, round(side * min(1.0, GRID / max(size)))) for side in size]
    render, change, weight = (
        F.interpolate(image.float(), cells, mode="area") for image in (views.render, enhanced - views.render, visible)
    )
    matrix, offset = _colour_model(render, change, weight)
    unseen = (1 - _blur(weight, EDGE)) * (visible.flatten(1).amax(1) > 0)[:, None, None, None]
    model = torch.cat([matrix.flatten(1, 2), offset - _blur(change, SMOOTH), unseen], dim=1)
    opaque = torch.ones_like(visible) if views.alpha is None else (views.alpha / OPAQUE).clamp(max=1)
    complete = completed_compiled if compiled(enhanced, views.render, opaque, model) else completed
    return complete(enhanced, views.render, opaque, model)


def completed(
    enhanced: Float[Tensor, "b 3 h w"],
    render: Float[Tensor, "b 3 h w"],
    opaque: Float[Tensor, "b 1 h w"],
    model: Float[Tensor, "b 13 i j"],
) -> Float[Tensor, "b 3 h w"]:
    """Enhanced + unseen x opaque x (matrix render + offset), the model linear between its cells' centres.

    Readable twin of the compiled kernel, on any device.

    Args:
        enhanced: what the network made of the render.
        render: the render.
        opaque: share of the completion that a pixel takes.
        model: the matrix's nine values by rows, the three offsets, and how far a cell is unseen.
    """
    size = enhanced.shape[-2:]
    unseen = F.interpolate(model[:, 12:], size, mode="bilinear", align_corners=False) * opaque
    images = []
    for channel in range(3):  # one by one, so that large images need little memory
        planes = torch.cat([model[:, 3 * channel : 3 * channel + 3], model[:, 9 + channel, None]], dim=1)
        fine = F.interpolate(planes, size, mode="bilinear", align_corners=False)
        change = (fine[:, :3] * render).sum(1) + fine[:, 3]
        images.append(enhanced[:, channel] + unseen[:, 0] * change)
    return torch.stack(images, dim=1)


def completed_compiled(
    enhanced: Float[Tensor, "b 3 h w"],
    render: Float[Tensor, "b 3 h w"],
    opaque: Float[Tensor, "b 1 h w"],
    model: Float[Tensor, "b 13 i j"],
) -> Float[Tensor, "b 3 h w"]:
    """The same by a compiled kernel."""
    from gaussian_enhancer.infer.colour_completion_kernels import complete
    from gaussian_enhancer.splat.compiled import kernel_lock

    result = torch.empty_like(enhanced, memory_format=torch.contiguous_format)
    with kernel_lock:
        for b, image in enumerate(result):
            inputs = array(enhanced[b]), array(render[b]), array(opaque[b, 0]), array(model[b])
            complete(*inputs, image.numpy())
    return result


def _colour_model(
    render: Float[Tensor, "b 3 i j"], change: Float[Tensor, "b 3 i j"], weight: Float[Tensor, "b 1 i j"]
) -> tuple[Float[Tensor, "b 3 3 i j"], Float[Tensor, "b 3 i j"]]:
    """Matrix and offset that give each window's change from the colour, the image's own where little is seen."""
    mass = _blur(weight, WINDOW)
    matrix, offset = _fit_affine(render, change, weight, lambda image: _blur(image, WINDOW))
    whole = _fit_affine(render, change, weight, lambda image: image.mean((2, 3), keepdim=True))
    local = mass / (mass + PRIOR)
    return local[:, None] * matrix + (1 - local[:, None]) * whole[0], local * offset + (1 - local) * whole[1]


def _fit_affine(
    render: Tensor, change: Tensor, weight: Tensor, averaged: Callable[[Tensor], Tensor]
) -> tuple[Float[Tensor, "b 3 3 i j"], Float[Tensor, "b 3 i j"]]:
    """The weighted least-squares fit of the change by the render's colour, over the windows of an average."""
    mass = averaged(weight).clamp_min(1e-6)
    colour, mean_change = averaged(render * weight) / mass, averaged(change * weight) / mass
    pairs = torch.cat([render, change], dim=1)[:, :, None] * render[:, None]
    second = averaged((pairs * weight[:, None]).flatten(1, 2)).unflatten(1, (6, 3)) / mass[:, None]
    covariance = second[:, :3] - colour[:, :, None] * colour[:, None]
    cross = second[:, 3:] - mean_change[:, :, None] * colour[:, None]
    regular = covariance.permute(0, 3, 4, 1, 2) + REGULARISATION * torch.eye(3).to(covariance)
    matrix = torch.linalg.solve(regular, cross.permute(0, 3, 4, 2, 1)).permute(0, 4, 3, 1, 2)
    return matrix, mean_change - (matrix * colour[:, None]).sum(2)


def _blur(image: Float[Tensor, "b c i j"], deviation: float) -> Float[Tensor, "b c i j"]:
    """The image under a Gaussian, continued by its border. Kornia has the same, but takes 0.7 s to import."""
    radius = int(3 * deviation)
    offsets = torch.arange(-radius, radius + 1, dtype=image.dtype, device=image.device)
    window = torch.exp(-offsets.square() / (2 * deviation**2))
    window = (window / window.sum()).expand(image.shape[1], 1, 1, -1)
    padded = F.pad(image, (radius, radius, radius, radius), mode="replicate")
    rows = F.conv2d(padded, window, groups=image.shape[1])
    return F.conv2d(rows, window.transpose(2, 3), groups=image.shape[1])
