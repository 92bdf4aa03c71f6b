"""Lost resolution: the image is downsampled and upsampled again, by two different kinds of interpolation.

Axes: b batch, h height, w width, n length of an axis, m positions, t taps (four).
"""

from collections.abc import Sequence

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from gaussian_enhancer.degrade.artefacts.rng import uniform, whole_numbers
from gaussian_enhancer.degrade.artefacts.view import View, fade_in

KINDS = ("nearest", "bilinear", "bicubic")
LARGEST = 3.0
"""Downsampling factor at strength 1."""


def taps(
    position: Float[Tensor, "b m"], kind: Int64[Tensor, " b"]
) -> tuple[Int64[Tensor, "b m t"], Float[Tensor, "b m t"]]:
    """The four grid points around each position, and their interpolation weights, which sum to 1.

    Bicubic is Keys' kernel with a = -0.75; nearest rounds halves up.

    Args:
        position: positions on a grid with a point at each whole number.
        kind: kind of interpolation of each sample, an index into `KINDS`.

    Returns:
        Indices, which may lie outside the axis, and weights.
    """
    first = position.floor()
    fraction = position - first
    zero, a = torch.zeros_like(fraction), -0.75
    near, far = (fraction, 1 - fraction), (1 + fraction, 2 - fraction)
    inner = [(a + 2) * d**3 - (a + 3) * d**2 + 1 for d in near]
    outer = [a * (d**3 - 5 * d**2 + 8 * d - 4) for d in far]
    rounds_up = (fraction >= 0.5).to(fraction.dtype)
    choices = torch.stack(
        [
            torch.stack([zero, 1 - rounds_up, rounds_up, zero], dim=-1),
            torch.stack([zero, 1 - fraction, fraction, zero], dim=-1),
            torch.stack([outer[0], *inner, outer[1]], dim=-1),
        ]
    )
    index = first.long()[..., None] + torch.arange(-1, 3, device=fraction.device)
    return index, choices[kind, torch.arange(len(kind), device=fraction.device)]


def resampling_matrix(
    length: int,
    factor: Float[Tensor, " b"],
    phase: Float[Tensor, " b"],
    down: Int64[Tensor, " b"],
    up: Int64[Tensor, " b"],
) -> Float[Tensor, "b n n"]:
    """The matrix that samples an axis at every ``factor``-th pixel and enlarges the result to the original length.

    The values at both ends of the axis are repeated outside. No low-pass filter is applied before the sampling.

    Args:
        length: length of the axis in pixels.
        factor: distance of the samples in pixels, >= 1.
        phase: shift of the samples in pixels.
        down: kind of interpolation for downsampling, an index into `KINDS`.
        up: kind of interpolation for upsampling, an index into `KINDS`.
    """
    pixel = torch.arange(length, device=factor.device, dtype=factor.dtype)
    first_position = 0.5 * (factor - 1) + phase
    coarse_index, outer_weight = taps((pixel - first_position[:, None]) / factor[:, None], up)
    position = first_position[:, None] + factor[:, None] * coarse_index.flatten(1)
    fine_index, inner_weight = taps(position, down)
    index = fine_index.clamp(0, length - 1).reshape(len(factor), length, 16)
    weight = (outer_weight[..., None] * inner_weight.unflatten(1, (length, 4))).flatten(2)
    return weight.new_zeros(len(factor), length, length).scatter_add_(2, index, weight)


def downsampling(view: View, strength: Float[Tensor, " b"], generators: Sequence[torch.Generator]) -> View:
    """Downsample the image by a factor of 3^strength and enlarge it again; the change fades in up to strength 0.1.

    The two steps use different kinds of interpolation. The position of the samples relative to the pixels is random
    along each axis, which serves the same purpose as NeRFLiX's random alignment of the stride. Both steps are linear
    and separable: each axis is multiplied by one matrix, which costs O(h w (h + w)).

    Depth and opacity stay unchanged.
    """
    image = view.image
    # Positions are in double precision: single precision would round some of them to another pixel.
    phase = uniform(-0.5, 0.5, (2,), generators, image).double()
    down, difference = whole_numbers(0, 2, generators), whole_numbers(1, 2, generators)
    down_kind = torch.tensor(down, device=image.device)
    up_kind = torch.tensor([(d + o) % 3 for d, o in zip(down, difference, strict=True)], device=image.device)
    factor = LARGEST ** strength.double()
    rows, columns = (
        resampling_matrix(length, factor, phase[:, axis] * (factor - 1), down_kind, up_kind).to(image)[:, None]
        for axis, length in enumerate(image.shape[-2:])
    )
    coarse = (rows @ image @ columns.mT).clamp(0, 1)
    return fade_in(view, coarse, strength)
