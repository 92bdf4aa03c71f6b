"""Diversity of the samples of one view.

Axes: n samples, c channels, h height, w width.
"""

from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.errors import InputError


def diversity(samples: Float[Tensor, "n c h w"]) -> float:
    """Mean over pixels and channels of the standard deviation (ddof 1) over samples.

    Renders and their differences from the photo have the same diversity. The estimate grows slightly with n, so compare
    only sets with the same number of samples.

    Args:
        samples: renders of one view, simulated with several seeds or fitted in several ways.

    Raises:
        InputError: there is a single sample.
    """
    if len(samples) < 2:
        raise InputError("samples", f"has {len(samples)}", "give at least two of the same view")
    return samples.double().std(dim=0, correction=1).mean().item()
