"""References at pixels where the target's splat is transparent.

A splat over black leaves dark surfaces transparent, and holes too. There it has no depth by which a reference could be
checked, so no reference counts as visible, and a network takes dark surfaces for holes and fills them.

Axes: h height, w width of the target; p, q of a reference.
"""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from gaussian_enhancer.align.projection import ReferenceProjection, project_pixels, sample_image
from gaussian_enhancer.align.reproject import Warped
from gaussian_enhancer.types import Camera

OPACITY = 0.5
"""Opacity below which a pixel counts as transparent. Over black, its colours are below this value too."""
COLOUR_DIFFERENCE = 0.1
"""Largest difference, in [0, 1], of any channel between colours that count as the same."""
PLAIN_SHARE = 0.2
"""Share of transparent pixels from which on they are taken for a plain background, where colours agree by chance."""


def dark_transparent(
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


def show_dark_surfaces(
    warped: Warped,
    transparent: Bool[Tensor, "1 h w"],
    image: Float[Tensor, "3 h w"],
    depth: Float[Tensor, "1 h w"],
    cameras: tuple[Camera, Camera],
    photo: Float[Tensor, "3 p q"],
    render: Float[Tensor, "3 _ _"] | None,
) -> Warped:
    """Make a reference visible at transparent pixels where its photo and its render both have the target's colour.

    Without the render of the reference's view, nothing is changed.

    Args:
        warped: the reference on the target's grid.
        transparent: mask of `dark_transparent`.
        image: the target's render, [0, 1].
        depth: z of the target, filled in holes (`fill_depth`).
        cameras: cameras of the target and of the reference.
        photo: the reference, in the exposure of its render.
        render: the splat's render of the reference's view, of any size; None if unknown.
    """
    if render is None or warped.render is None:
        return warped
    target, reference = cameras
    height, width = photo.shape[-2:]
    projected = project_pixels(ReferenceProjection.between(target, reference.resized(height, width), depth), depth)
    checked = transparent & (warped.visibility <= 0) & (projected.inside > 0)
    if not bool(checked.any()):
        return warped
    x, y = (position[checked][None, None] for position in (projected.x, projected.y))
    colours = sample_image(photo, x, y)[0, :, 0]
    rendered = sample_image(render, x * (render.shape[-1] / width), y * (render.shape[-2] / height))[0, :, 0]
    expected = image[:, checked[0]]
    differences = torch.maximum((colours - expected).abs().amax(0), (rendered - expected).abs().amax(0))
    same = differences < COLOUR_DIFFERENCE
    shown = checked.masked_scatter(checked, same)[0]
    colour, visibility, warped_render = warped.colour.clone(), warped.visibility.clone(), warped.render.clone()
    colour[:, shown], visibility[:, shown], warped_render[:, shown] = colours[:, same], 1.0, rendered[:, same]
    return Warped(colour, visibility, warped_render)
