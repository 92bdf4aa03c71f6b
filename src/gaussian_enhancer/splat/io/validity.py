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


def renderable(gaussians: Gaussians) -> Bool[Tensor, " n"]:
    """Which Gaussians have finite values throughout and a rotation of non-zero length."""
    mask = gaussians.quaternions.square().sum(1) > 0
    for values in (gaussians.means, gaussians.log_scales, gaussians.quaternions, gaussians.sh.flatten(1)):
        mask = mask & torch.isfinite(values).all(1)
    mask = mask & torch.isfinite(gaussians.opacity_logits)
    if gaussians.smoothing is not None:
        mask = mask & torch.isfinite(gaussians.smoothing) & (gaussians.smoothing >= 0)
    return mask


def validated(path: str | Path, gaussians: Gaussians, invalid: str = "refuse") -> Gaussians:
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
    good = renderable(gaussians)
    if bool(good.all()):
        return gaussians
    bad = (~good).nonzero().flatten()
    found = f"{len(bad)} of {len(gaussians)} Gaussians are not finite or lack a rotation (first: {int(bad[0])})"
    if invalid == "refuse":
        raise InputError(path, found, "repair the file or pass invalid=drop to leave them out")
    if len(bad) == len(gaussians):
        raise InputError(path, found, "export the splat again")
    warnings.warn(f"{path}: {found}; they were dropped", stacklevel=2)
    return gaussians[good]
