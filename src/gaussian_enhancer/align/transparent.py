"""References at dark pixels where the target's splat is transparent.

Over a black background, a splat can represent a dark surface by transparency, which looks the same as a hole. There is
no depth by which a reference could be checked, so none counts as visible, and a network fills the surface like a hole.

Axes: h height, w width of the target; p, q of a reference.
"""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from gaussian_enhancer.align.projection import ReferenceProjection, project_pixels, sample_projected_pair
from gaussian_enhancer.align.reproject import Warped
from gaussian_enhancer.types import Camera

OPACITY = 0.5
"""Opacity below which a pixel counts as transparent. Over black, its colours are below this value too."""
COLOUR_DIFFERENCE = 0.1
"""Largest difference, in [0, 1], of any channel between colours that count as the same."""
PLAIN_SHARE = 0.2
"""Share of transparent pixels from which on they are taken for a plain background, where colours agree by chance."""


def dark_transparent_pixels(
    image: Float[Tensor, "3 h w"], alpha: Float[Tensor, "1 h w"] | None
) -> Bool[Tensor, "1 h w"] | None:
    """Mask of the pixels at which a dark surface may be transparent; None if no pixel is transparent, or too many.

    Args:
        image: the render, [0, 1].
        alpha: rendered opacity; None if unknown.
    """
    if alpha is None:
        return None
    transparent = alpha < OPACITY
    share = float(transparent.float().mean())
    return transparent & (image.amax(0, keepdim=True) < OPACITY) if 0 < share < PLAIN_SHARE else None


def mark_dark_pixels_visible(
    warped: Warped,
    mask: Bool[Tensor, "1 h w"],
    image: Float[Tensor, "3 h w"],
    depth: Float[Tensor, "1 h w"],
    cameras: tuple[Camera, Camera],
    photo: Float[Tensor, "3 p q"],
    render: Float[Tensor, "3 _ _"] | None,
) -> Warped:
    """Make a reference visible at pixels of a mask where its photo and its render both have the target's colour.

    Without the render of the reference's view, nothing is changed.

    Args:
        warped: the reference on the target's grid.
        mask: mask of `dark_transparent_pixels`.
        image: the target's render, [0, 1].
        depth: z of the target, filled in holes (`fill_depth`).
        cameras: cameras of the target and of the reference.
        photo: the reference, in the exposure of its render.
        render: the splat's render of the reference's view, of any size; None if unknown.
    """
    unseen = mask & (warped.visibility <= 0)
    if render is None or warped.render is None or not bool(unseen.any()):
        return warped
    target, reference = cameras
    size = photo.shape[-2], photo.shape[-1]
    projected = project_pixels(ReferenceProjection.between(target, reference.resized(*size), depth), depth)
    unseen &= projected.inside > 0
    colour, rendered = sample_projected_pair(photo, render, projected, size, unseen.to(depth))
    difference = torch.maximum((colour - image).abs(), (rendered - image).abs()).amax(0)
    same = unseen & (difference < COLOUR_DIFFERENCE)
    return Warped(
        torch.where(same, colour, warped.colour),
        torch.where(same, 1.0, warped.visibility),
        torch.where(same, rendered, warped.render),
    )
