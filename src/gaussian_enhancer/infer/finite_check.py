"""Refusing views with values that are not finite."""

import dataclasses

import torch

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.types import NetworkInput


def refuse_not_finite(views: NetworkInput) -> None:
    """Refuse views with values that are not finite, since a network would spread them over the image.

    Depth that is not finite is allowed: it counts as unknown.

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
