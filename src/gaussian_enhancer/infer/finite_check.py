"""Views that a network cannot make anything of."""

import dataclasses

import torch

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.types import NetworkInput


def refuse_not_finite(views: NetworkInput) -> None:
    """Refuse views with numbers that are not finite, which a network would spread over the image.

    Depth that is not finite counts as unknown and is left to the network.

    Args:
        views: what is known of the targets.

    Raises:
        InputError: colours, visibility or opacity are not finite somewhere.
    """
    for field in dataclasses.fields(views):
        image = getattr(views, field.name)
        if image is None or field.name in ("depth", "depth_unit"):
            continue
        if bool(torch.isfinite(image.sum())):  # one pass; a sum that overflows is looked at again
            continue
        count = int((~torch.isfinite(image)).sum())
        if count:
            received = f"has {count} values that are not finite in its {field.name.replace('_', ' ')}"
            raise InputError("view to enhance", received, "render it again, or leave that part out")
