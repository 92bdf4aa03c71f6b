"""Check that network inputs have finite values within range."""

import dataclasses

from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.types import NetworkInput

LARGEST = 1e3
"""Largest accepted magnitude. Renders exceed [0, 1] only slightly; squares of much larger values overflow float16."""


def refuse_not_finite(views: NetworkInput) -> None:
    """Refuse values that are not finite or too large, which a network would spread over the image.

    Depth need not be finite: where it is not, it counts as unknown.

    Args:
        views: the network's input.

    Raises:
        InputError: colours, visibility or opacity are not finite or beyond 1000 somewhere.
    """
    for field in dataclasses.fields(views):
        image = getattr(views, field.name)
        if image is None or field.name in ("depth", "depth_unit"):
            continue
        if image.numel() == 0 or _in_range(image):
            continue
        count = int((~(image.abs() <= LARGEST)).sum())
        received = f"has {count} values that are not finite or beyond {LARGEST:g} in its {field.name.replace('_', ' ')}"
        raise InputError("view to enhance", received, "render it again, or leave that part out")


def _in_range(image: Tensor) -> bool:
    smallest, largest = image.aminmax()  # one pass; comparisons with NaN are false
    return float(smallest) >= -LARGEST and float(largest) <= LARGEST
