"""What every splat file must hold to be rendered, whatever its format.

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
"""Within which every value of a splat lies; beyond, colours, depths or gradients overflow in single precision.

Measured: gradients stop being finite at log scales of 60 and -1000 and at harmonics of 1e20.
"""


def renderable_mask(gaussians: Gaussians) -> Bool[Tensor, " n"]:
    """Which Gaussians have values within `LIMITS` throughout, NaN being none, and a rotation of non-zero length."""
    mask = gaussians.quaternions.detach().double().square().sum(1) > 0
    for name, (low, high) in LIMITS.items():
        values = getattr(gaussians, name)
        if values is not None:
            values = values.detach().flatten(1) if values.dim() > 1 else values.detach()[:, None]
            mask = mask & ((values >= low) & (values <= high)).all(1)
    return mask


def hide_unrenderable(gaussians: Gaussians) -> Gaussians:
    """The same splat with every Gaussian that cannot be rendered transparent, at the origin and of unit size.

    Its count stays, and its tensors' gradients are 0 there.
    """
    if _is_plainly_valid(gaussians):
        return gaussians
    good = renderable_mask(gaussians)
    neutral = {"opacity_logits": -1e4, "quaternions": 1.0}

    def kept(name: str) -> Tensor | None:
        values = getattr(gaussians, name)
        if values is None:
            return None
        return torch.where(good.view(-1, *[1] * (values.dim() - 1)), values, neutral.get(name, 0.0))

    return Gaussians(**{name: kept(name) for name in LIMITS})  # type: ignore[arg-type]


def _is_plainly_valid(gaussians: Gaussians) -> bool:
    """Whether the extremes alone, which cost little, show that every Gaussian can be rendered."""
    if len(gaussians) == 0:
        return True
    for name, (low, high) in LIMITS.items():
        values = getattr(gaussians, name)
        if values is not None and values.numel():
            least, largest = values.detach().aminmax()
            if not (float(least) >= low and float(largest) <= high):
                return False
    return bool((gaussians.quaternions.detach().abs().amax(1) > 0).all())


def refuse_or_drop_invalid(path: str | Path, gaussians: Gaussians, invalid: str = "refuse") -> Gaussians:
    """Return the Gaussians if all can be rendered; else refuse them, or drop the bad ones with a warning.

    Args:
        path: the file they came from, named in errors.
        gaussians: what was read.
        invalid: "refuse" raises on the first bad Gaussian, "drop" leaves the bad ones out.

    Raises:
        InputError: if there are no Gaussians, or some cannot be rendered and ``invalid`` is "refuse".
    """
    if invalid not in ("refuse", "drop"):
        raise InputError("invalid", f"is {invalid!r}", 'use "refuse" or "drop"')
    if len(gaussians) == 0:
        raise InputError(path, "holds no Gaussians", "export the splat again")
    good = renderable_mask(gaussians)
    if bool(good.all()):
        return gaussians
    bad = (~good).nonzero().flatten()
    found = (
        f"{len(bad)} of {len(gaussians)} Gaussians are not finite, too large or lack a rotation (first: {int(bad[0])})"
    )
    if invalid == "refuse":
        raise InputError(path, found, "repair the file or pass invalid=drop to leave them out")
    if len(bad) == len(gaussians):
        raise InputError(path, found, "export the splat again")
    warnings.warn(f"{path}: {found}; they were dropped", stacklevel=2)
    return gaussians[good]
