"""Depth as network input: inverse depth in units of the image's median depth, which removes the scene's scale.

Axes: b batch, h height, w width.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.types import single_precision, usable_depth

MAX_INVERSE_DEPTH = 4
"""Largest normalised inverse depth."""


def depth_unit(depth: Float[Tensor, "b 1 h w"]) -> Float[Tensor, " b"]:
    """Median usable depth of each image, which is the length that counts as 1; 1 if an image has no usable depth."""
    known_depth = torch.where(usable_depth(depth), depth, torch.full_like(depth, torch.nan)).flatten(1)
    return torch.nan_to_num(single_precision(known_depth).nanmedian(dim=1).values, nan=1.0).clamp_min(1e-30)


def normalised_inverse_depth(depth: Float[Tensor, "b 1 h w"], unit: Float[Tensor, " b"]) -> Float[Tensor, "b 1 h w"]:
    """Inverse depth, unit / depth, limited to [0, `MAX_INVERSE_DEPTH`]. 0 where nothing was hit.

    It does not depend on the scene's scale.

    Args:
        depth: z in scene units.
        unit: the length that counts as 1, > 0.
    """
    usable = usable_depth(depth)
    ratio = unit[:, None, None, None] / single_precision(torch.where(usable, depth, torch.ones_like(depth)))
    return torch.where(usable, ratio.clamp(0, MAX_INVERSE_DEPTH), torch.zeros_like(ratio))
