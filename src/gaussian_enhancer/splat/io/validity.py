"""Checks that the Gaussians of a splat can be rendered, for all file formats.

Axes: n Gaussians, k spherical-harmonics coefficients, s scale axes.
"""

import warnings
from pathlib import Path

import torch
from jaxtyping import Bool
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.types import Gaussians

LIMITS: dict[str, tuple[float, float]] = {
    "means": (-1e15, 1e15),
    "log_scales": (-100.0, 40.0),
    "quaternions": (-1e15, 1e15),
    "opacity_logits": (-torch.finfo(torch.float32).max, torch.finfo(torch.float32).max),
    "sh": (-1e9, 1e9),
    "smoothing": (0.0, 1e15),
}
"""Range of valid values of each tensor; beyond it, colours, depths or gradients overflow in single precision.

Measured: gradients stop being finite at log scales of 60 and -1000 and at harmonics of 1e20.
"""


def renderable_mask(gaussians: Gaussians) -> Bool[Tensor, " n"]:
    """Mask of Gaussians whose values all lie within `LIMITS` (NaN does not) and whose quaternion is not zero."""
    mask = gaussians.quaternions.detach().double().square().sum(1) > 0
    for name, (low, high) in LIMITS.items():
        values = getattr(gaussians, name)
        if values is not None:
            values = values.detach().flatten(1) if values.dim() > 1 else values.detach()[:, None]
            mask = mask & ((values >= low) & (values <= high)).all(1)
    return mask


def hide_unrenderable(gaussians: Gaussians) -> Gaussians:
    """Make every Gaussian that cannot be rendered transparent, at the origin and of unit size.

    The number of Gaussians does not change. Gradients with respect to the original values are 0 for these Gaussians.
    """
    if _is_plainly_valid(gaussians):
        return gaussians
    renderable = renderable_mask(gaussians)
    neutral_values = {"opacity_logits": -1e4, "quaternions": 1.0}

    def kept(name: str) -> Tensor | None:
        values = getattr(gaussians, name)
        if values is None:
            return None
        return torch.where(renderable.view(-1, *[1] * (values.dim() - 1)), values, neutral_values.get(name, 0.0))

    return Gaussians(**{name: kept(name) for name in LIMITS})  # type: ignore[arg-type]


def _is_plainly_valid(gaussians: Gaussians) -> bool:
    """Quick test: whether the smallest and largest values alone show that every Gaussian can be rendered."""
    if len(gaussians) == 0:
        return True
    for name, (low, high) in LIMITS.items():
        values = getattr(gaussians, name)
        if values is not None and values.numel():
            smallest, largest = values.detach().aminmax()
            if not (float(smallest) >= low and float(largest) <= high):
                return False
    return bool((gaussians.quaternions.detach().abs().amax(1) > 0).all())


def refuse_or_drop_invalid(path: str | Path, gaussians: Gaussians, invalid: str = "refuse") -> Gaussians:
    """Return the Gaussians if all can be rendered; otherwise raise an error, or drop the invalid ones with a warning.

    Args:
        path: the file that they were read from, named in errors.
        gaussians: the Gaussians of the file.
        invalid: "refuse" raises if any Gaussian is invalid, "drop" leaves the invalid ones out.

    Raises:
        InputError: if there are no Gaussians, some cannot be rendered and ``invalid`` is "refuse", none can be
            rendered, or ``invalid`` is another word.
    """
    if invalid not in ("refuse", "drop"):
        raise InputError("invalid", f"is {invalid!r}", 'use "refuse" or "drop"')
    if len(gaussians) == 0:
        raise InputError(path, "holds no Gaussians", "export the splat again")
    renderable = renderable_mask(gaussians)
    if bool(renderable.all()):
        return gaussians
    invalid_rows = (~renderable).nonzero().flatten()
    received = (
        f"{len(invalid_rows)} of {len(gaussians)} Gaussians are not finite, too large or lack a rotation "
        f"(first: {int(invalid_rows[0])})"
    )
    if invalid == "refuse":
        raise InputError(path, received, "repair the file or pass invalid=drop to leave them out")
    if len(invalid_rows) == len(gaussians):
        raise InputError(path, received, "export the splat again")
    warnings.warn(f"{path}: {received}; they were dropped", stacklevel=2)
    return gaussians[renderable]
