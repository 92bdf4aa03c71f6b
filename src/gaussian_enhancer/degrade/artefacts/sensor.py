"""Noise of a camera's sensor, as it looks after the camera's image processing.

Axes: b batch, h height, w width.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
import torch.nn.functional as F
from jaxtyping import Float
from kornia.color import CFA, raw_to_rgb, rgb_to_raw
from torch import Tensor

from gaussian_enhancer.degrade.artefacts.rng import normal, uniform
from gaussian_enhancer.degrade.artefacts.view import View, per_sample

DARKEST = 1e-8
GAMMA = 2.2


@dataclass(frozen=True)
class CameraProcessing:
    """What a camera does between its sensor and its file.

    Args:
        gain: of the colour channels, white balance times brightness, > 0.
        matrix: from the sensor's colours to linear sRGB; its rows sum to 1.
    """

    gain: Float[Tensor, "b 3"]
    matrix: Float[Tensor, "b 3 3"]

    def unprocess(self, image: Float[Tensor, "b 3 h w"]) -> Float[Tensor, "b 3 h w"]:
        """The sensor's linear signal, in [0, 1], of an sRGB image in [0, 1]; the inverse of `process`."""
        lifted = 0.5 - torch.sin(torch.asin(1 - 2 * image.clamp(0, 1)) / 3)
        linear = lifted.clamp_min(DARKEST) ** GAMMA
        raw = torch.einsum("bij,bjhw->bihw", torch.linalg.inv(self.matrix), linear)
        return raw / self.gain[..., None, None]

    def process(self, raw: Float[Tensor, "b 3 h w"]) -> Float[Tensor, "b 3 h w"]:
        """The sRGB image of a sensor's signal: gains, clipping, colour matrix, gamma 2.2, tone curve 3 x^2 - 2 x^3."""
        balanced = (raw * self.gain[..., None, None]).clamp(0, 1)
        linear = torch.einsum("bij,bjhw->bihw", self.matrix, balanced)
        lifted = linear.clamp(DARKEST, 1) ** (1 / GAMMA)
        return lifted.square() * (3 - 2 * lifted)


def random_processing(generators: Sequence[torch.Generator], like: Tensor) -> CameraProcessing:
    """Cameras with plausible gains and colour matrices.

    Gains as Brooks et al. (CVPR 2019): red 1.9 to 2.4, blue 1.5 to 1.9, all times a brightness of 1 to 1.6. Instead of
    measured matrices, random ones of the same make: 1.3 to 1.9 on the diagonal, negative beside it, rows of sum 1, so
    that the inverse has no negative entry and no colour of a photo leaves the sensor's range.

    Args:
        generators: one for each sample.
        like: a tensor whose type and device the result has.
    """
    red, blue, brightness = uniform(0.0, 1.0, (3,), generators, like).unbind(1)
    gain = (
        torch.stack([1.9 + 0.5 * red, torch.ones_like(red), 1.5 + 0.4 * blue], dim=1) * (1 + 0.6 * brightness)[:, None]
    )
    spread, left = uniform(0.0, 1.0, (2, 3), generators, like).unbind(1)
    spread, left = 0.3 + 0.6 * spread, 0.3 + 0.4 * left
    other = torch.diag_embed(left).roll(1, dims=2) + torch.diag_embed(1 - left).roll(2, dims=2)
    matrix = torch.diag_embed(1 + spread) - spread[..., None] * other
    return CameraProcessing(gain, matrix)


def sensor_noise(
    raw: Float[Tensor, "b 3 h w"], strength: Float[Tensor, " b"], generators: Sequence[torch.Generator]
) -> Float[Tensor, "b 3 h w"]:
    """Shot and read noise of a Bayer sensor, n ~ N(0, shot raw + read), made three channels by demosaicking.

    At strength 1, shot is between 0.0002 and 0.002 and log read = 2.18 log shot + 1.2 + N(0, 0.26), the line that
    Brooks et al. (CVPR 2019) fitted to the Darmstadt noise dataset; the standard deviation grows linearly with the
    strength. Theirs reaches 0.012: a splat's photos are taken in good light, and splatting averages over them. As
    demosaicking is linear, the noise alone may take that way, and the signal keeps its sharpness.

    Args:
        raw: the sensor's signal, >= 0.
        strength: of each sample, [0, 1].
        generators: one for each sample.
    """
    height, width = raw.shape[-2:]
    shot = torch.exp(uniform(math.log(2e-4), math.log(2e-3), (), generators, raw))
    read_noise = torch.exp(2.18 * torch.log(shot) + 1.2 + 0.26 * normal((), generators, raw))
    even = F.pad(raw, (0, width % 2, 0, height % 2), mode="replicate")
    deviation = (per_sample(shot) * rgb_to_raw(even, CFA.BG) + per_sample(read_noise)).sqrt()
    read_deviation = per_sample(strength) * deviation * normal(tuple(deviation.shape[1:]), generators, raw)
    return raw_to_rgb(read_deviation, CFA.BG)[..., :height, :width]


def sensor(view: View, strength: Float[Tensor, " b"], generators: Sequence[torch.Generator]) -> View:
    """Sensor noise pushed through a camera: clamp(x + process(raw + n) - process(raw)) with raw = unprocess(x).

    Unprocessing, noise and processing as Brooks et al. (CVPR 2019): see `CameraProcessing`, `random_processing` and
    `sensor_noise`. To the gradient the noise is a constant: the camera's curve is infinitely steep at black.

    Args:
        view: what is degraded; depth and opacity stay.
        strength: of each sample, [0, 1].
        generators: one for each sample.
    """
    with torch.no_grad():
        camera = random_processing(generators, view.image)
        raw = camera.unprocess(view.image)
        change = camera.process(raw + sensor_noise(raw, strength, generators)) - camera.process(raw)
    return replace(view, image=(view.image + change).clamp(0, 1))
