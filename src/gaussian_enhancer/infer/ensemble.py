"""Mean of two enhancements of a view: with all references, and without the least useful one.

Errors of warped photos differ from reference to reference, so that they partly cancel in the mean. Axes: b batch, h
height, w width.
"""

import dataclasses

from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.types import NetworkInput

MIN_REFERENCES = 3
"""Smallest number of references of which one may be left out."""
SHARE = 1.2
"""Share of the mean change that is applied. The confidence sets the shares of a single enhancement, which errs more."""


def without_last_reference(views: NetworkInput) -> NetworkInput:
    """The network input without the last reference, which is the least useful one (`rank_references`)."""
    fields = "references", "visibility", "reference_renders", "fine_references"
    images = {name: getattr(views, name) for name in fields}
    kept = {name: image[:, :-1] for name, image in images.items() if image is not None}
    return dataclasses.replace(views, **kept)


def mean_change(
    render: Float[Tensor, "b 3 h w"], first: Float[Tensor, "b 3 h w"], second: Float[Tensor, "b 3 h w"]
) -> Float[Tensor, "b 3 h w"]:
    """The render plus `SHARE` of the mean change of two enhancements, in [0, 1].

    Args:
        render: the render.
        first: one enhanced image, whose change is limited.
        second: the other one.
    """
    return render.lerp((first + second) / 2, SHARE).clamp(0, 1)
