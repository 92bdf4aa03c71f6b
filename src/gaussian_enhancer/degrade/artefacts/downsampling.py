"""Lost resolution: smaller by one kind of interpolation, larger again by another.

Axes: b batch, h height, w width, n length of an axis, m positions, t taps (four).
"""

from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from gaussian_enhancer.degrade.artefacts.rng import uniform, whole_numbers
from gaussian_enhancer.degrade.artefacts.view import View, per_sample

KINDS = ("nearest", "bilinear", "bicubic")
LARGEST = 3.0
"""Factor at strength 1."""

ONSET = 0.1


def taps(
    position: Float[Tensor, "b m"], kind: Int64[Tensor, " b"]
) -> tuple[Int64[Tensor, "b m t"], Float[Tensor, "b m t"]]:
    """The four grid points around positions and their weights, which sum to 1.

    Bicubic is Keys' kernel with a = -0.75, nearest rounds halves up.

    Args:
        position: on the grid, which has a point at each whole number.
        kind: of each sample, an index into `KINDS`.

    Returns:
        Indices, which may lie beyond an axis's ends, and weights.
    """
    first = position.floor()
    t = position - first
    zero, a = torch.zeros_like(t), -0.75
    near, far = (t, 1 - t), (1 + t, 2 - t)
    inner = [(a + 2) * d**3 - (a + 3) * d**2 + 1 for d in near]
    outer = [a * (d**3 - 5 * d**2 + 8 * d - 4) for d in far]
    upper = (t >= 0.5).to(t.dtype)
    choices = torch.stack(
        [
            torch.stack([zero, 1 - upper, upper, zero], dim=-1),
            torch.stack([zero, 1 - t, t, zero], dim=-1),
            torch.stack([outer[0], *inner, outer[1]], dim=-1),
        ]
    )
    index = first.long()[..., None] + torch.arange(-1, 3, device=t.device)
    return index, choices[kind, torch.arange(len(kind), device=t.device)]


def resampling_matrix(
    length: int,
    factor: Float[Tensor, " b"],
    phase: Float[Tensor, " b"],
    down: Int64[Tensor, " b"],
    up: Int64[Tensor, " b"],
) -> Float[Tensor, "b n n"]:
    """The effect on an axis of being sampled at every ``factor``-th pixel and enlarged again, as a matrix.

    The axis goes on at its ends with the values that it ends with. No low-pass filter precedes the sampling.

    Args:
        length: of the axis, pixels.
        factor: distance of the samples, pixels, >= 1.
        phase: shift of the samples, pixels.
        down: kind of interpolation at the samples, an index into `KINDS`.
        up: kind of interpolation between the samples, an index into `KINDS`.
    """
    pixel = torch.arange(length, device=factor.device, dtype=factor.dtype)
    start = 0.5 * (factor - 1) + phase
    coarse, outer = taps((pixel - start[:, None]) / factor[:, None], up)
    position = start[:, None] + factor[:, None] * coarse.flatten(1)
    fine, inner = taps(position, down)
    index = fine.clamp(0, length - 1).reshape(len(factor), length, 16)
    weight = (outer[..., None] * inner.unflatten(1, (length, 4))).flatten(2)
    return weight.new_zeros(len(factor), length, length).scatter_add_(2, index, weight)


def downsampling(view: View, strength: Float[Tensor, " b"], generators: Sequence[torch.Generator]) -> View:
    """Sample the image more coarsely by a factor of 3^strength and enlarge it again; fades in up to strength 0.1.

    Down and up take two different kinds of interpolation. Where the samples lie within the pixels is random along
    each axis, which is what NeRFLiX's random alignment of the stride is for. Both steps are linear and separable:
    each axis is multiplied by one matrix, which costs O(h w (h + w)).

    Args:
        view: what is degraded; depth and opacity stay.
        strength: of each sample, [0, 1].
        generators: one for each sample.
    """
    image = view.image
    # Positions in double precision: single precision would round some to another pixel.
    phase = uniform(-0.5, 0.5, (2,), generators, image).double()
    down, other = whole_numbers(0, 2, generators), whole_numbers(1, 2, generators)
    before = torch.tensor(down, device=image.device)
    after = torch.tensor([(d + o) % 3 for d, o in zip(down, other, strict=True)], device=image.device)
    factor = LARGEST ** strength.double()
    rows, columns = (
        resampling_matrix(length, factor, phase[:, axis] * (factor - 1), before, after).to(image)[:, None]
        for axis, length in enumerate(image.shape[-2:])
    )
    coarse = (rows @ image @ columns.mT).clamp(0, 1)
    fade = per_sample((strength / ONSET).clamp(max=1))
    return replace(view, image=image + fade * (coarse - image))
