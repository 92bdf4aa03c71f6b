"""Sensor noise of a camera, as it appears after the camera's image processing.

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
    """A camera's image processing, from the sensor's signal to the sRGB image.

    Args:
        gain: gain of each colour channel: white balance times brightness, > 0.
        matrix: colour matrix from the sensor's colours to linear sRGB; its rows sum to 1.
    """

    gain: Float[Tensor, "b 3"]
    matrix: Float[Tensor, "b 3 3"]

    def unprocess(self, image: Float[Tensor, "b 3 h w"]) -> Float[Tensor, "b 3 h w"]:
        """Compute the sensor's linear signal from an sRGB image, both in [0, 1]; the inverse of `process`."""
        gamma_encoded = 0.5 - torch.sin(torch.asin(1 - 2 * image.clamp(0, 1)) / 3)
        linear = gamma_encoded.clamp_min(DARKEST) ** GAMMA
        raw = torch.einsum("bij,bjhw->bihw", torch.linalg.inv(self.matrix), linear)
        return raw / self.gain[..., None, None]

    def process(self, raw: Float[Tensor, "b 3 h w"]) -> Float[Tensor, "b 3 h w"]:
        """Compute the sRGB image by gains, clipping, colour matrix, gamma 2.2 and the tone curve 3 x^2 - 2 x^3."""
        balanced = (raw * self.gain[..., None, None]).clamp(0, 1)
        linear = torch.einsum("bij,bjhw->bihw", self.matrix, balanced)
        gamma_encoded = linear.clamp(DARKEST, 1) ** (1 / GAMMA)
        return gamma_encoded.square() * (3 - 2 * gamma_encoded)


def random_processing(generators: Sequence[torch.Generator], like: Tensor) -> CameraProcessing:
    """Draw cameras with plausible gains and colour matrices.

    The gains are those of Brooks et al. (CVPR 2019): red 1.9 to 2.4, blue 1.5 to 1.9, all times a brightness of 1 to
    1.6. Instead of measured colour matrices, random ones of the same structure are drawn: 1.3 to 1.9 on the diagonal,
    negative elsewhere, rows of sum 1. Their inverse has no negative entry, so that all colours of a photo are within
    the sensor's range.

    Args:
        generators: one for each sample.
        like: a tensor with the dtype and device of the result.
    """
    red, blue, brightness = uniform(0.0, 1.0, (3,), generators, like).unbind(1)
    gain = (
        torch.stack([1.9 + 0.5 * red, torch.ones_like(red), 1.5 + 0.4 * blue], dim=1) * (1 + 0.6 * brightness)[:, None]
    )
    spread, split = uniform(0.0, 1.0, (2, 3), generators, like).unbind(1)
    spread, split = 0.3 + 0.6 * spread, 0.3 + 0.4 * split
    off_diagonal = torch.diag_embed(split).roll(1, dims=2) + torch.diag_embed(1 - split).roll(2, dims=2)
    matrix = torch.diag_embed(1 + spread) - spread[..., None] * off_diagonal
    return CameraProcessing(gain, matrix)


def sensor_noise(
    raw: Float[Tensor, "b 3 h w"], strength: Float[Tensor, " b"], generators: Sequence[torch.Generator]
) -> Float[Tensor, "b 3 h w"]:
    """Shot and read noise of a Bayer sensor, n ~ N(0, shot raw + read), demosaicked to three channels.

    At strength 1, shot is between 0.0002 and 0.002, and log read = 2.18 log shot + 1.2 + N(0, 0.26), the line that
    Brooks et al. (CVPR 2019) fitted to the Darmstadt noise dataset. The standard deviation is proportional to the
    strength. Brooks et al. use shot noise up to 0.012; here it is lower, because photos for splats are taken in good
    light, and splatting averages over them. As demosaicking is linear, it is applied to the noise alone, so that the
    signal keeps its sharpness.

    Args:
        raw: the sensor's signal, >= 0.
        strength: strength for each sample, [0, 1].
        generators: one for each sample.
    """
    height, width = raw.shape[-2:]
    shot = torch.exp(uniform(math.log(2e-4), math.log(2e-3), (), generators, raw))
    read = torch.exp(2.18 * torch.log(shot) + 1.2 + 0.26 * normal((), generators, raw))
    padded = F.pad(raw, (0, width % 2, 0, height % 2), mode="replicate")
    deviation = (per_sample(shot) * rgb_to_raw(padded, CFA.BG) + per_sample(read)).sqrt()
    raw_noise = per_sample(strength) * deviation * normal(tuple(deviation.shape[1:]), generators, raw)
    return raw_to_rgb(raw_noise, CFA.BG)[..., :height, :width]


def sensor(view: View, strength: Float[Tensor, " b"], generators: Sequence[torch.Generator]) -> View:
    """Add sensor noise after a camera's processing: clamp(x + process(raw + n) - process(raw)), raw = unprocess(x).

    Unprocessing, noise and processing follow Brooks et al. (CVPR 2019): see `CameraProcessing`, `random_processing` and
    `sensor_noise`. No gradient is passed through the noise, because the camera's curve is infinitely steep at black.

    Depth and opacity stay unchanged.
    """
    with torch.no_grad():
        camera = random_processing(generators, view.image)
        raw = camera.unprocess(view.image)
        change = camera.process(raw + sensor_noise(raw, strength, generators)) - camera.process(raw)
    return replace(view, image=(view.image + change).clamp(0, 1))
