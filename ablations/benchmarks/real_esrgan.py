"""Real-ESRGAN's second-order degradation at scale 1, which `degradation.py` compares the simulator with.

X. Wang, L. Xie, C. Dong, Y. Shan, "Real-ESRGAN: Training Real-World Blind Super-Resolution with Pure Synthetic Data",
ICCVW 2021, section 3, with the ranges of section 4.1; those of the resizes, which the paper leaves to its released
options, are from there. Two rounds of blur, resize, noise and JPEG, then a sinc filter, before or after the last JPEG.
As in the released training, all images of a batch share a resize; blur, noise and quality are drawn for each image.
Kernels are applied without padding to the largest, and the result is resized to the input's size.
Axes: b batch, h height, w width, k side of a kernel.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Float
from kornia.color import rgb_to_grayscale
from kornia.enhance import jpeg_codec_differentiable
from kornia.filters import filter2d
from torch import Tensor

Images = Float[Tensor, "b 3 h w"]
Range = tuple[float, float]


@dataclass(frozen=True)
class Order:
    """One round of the degradation.

    Args:
        blurred: probability of a blur.
        sigma: standard deviations of a blur along its axes in pixels.
        directions: probabilities that the resize enlarges, shrinks, or keeps the size.
        scale: range of the resize factor.
        noise: standard deviation of Gaussian noise, of 255.
        poisson: scale of Poisson noise.
    """

    blurred: float
    sigma: Range
    directions: tuple[float, float, float]
    scale: Range
    noise: Range
    poisson: Range


FIRST = Order(1.0, (0.2, 3.0), (0.2, 0.7, 0.1), (0.15, 1.5), (1.0, 30.0), (0.05, 3.0))
SECOND = Order(0.8, (0.2, 1.5), (0.3, 0.4, 0.3), (0.3, 1.2), (1.0, 25.0), (0.05, 2.5))
KINDS = {"gaussian": 0.7, "generalised": 0.15, "plateau": 0.15}
ISOTROPIC = {"gaussian": 0.45 / 0.7, "generalised": 0.8, "plateau": 0.8}
SHAPE: dict[str, Range] = {"gaussian": (1.0, 1.0), "generalised": (0.5, 4.0), "plateau": (1.0, 2.0)}
SINC, GREY, GAUSSIAN, FINAL_SINC = 0.1, 0.4, 0.5, 0.8
QUALITY: Range = (30, 95)
SIZES: Range = (3, 10)


class SecondOrder:
    """Real-ESRGAN's degradation of a batch."""

    def __call__(self, images: Images, generator: torch.Generator) -> Images:
        """Degrade images in [0, 1]; the result has their size.

        Args:
            images: sRGB.
            generator: source of all randomness.
        """
        draw = Draw(generator)
        size = images.shape[-2:]
        once = jpeg(self._round(images, FIRST, size, draw), draw)
        twice = self._round(once, SECOND, size, draw)
        if draw.chance(0.5):
            return jpeg(sharpened(resized(twice, size, draw), draw), draw)
        return sharpened(resized(jpeg(twice, draw), size, draw), draw)

    def _round(self, images: Images, order: Order, size: Sequence[int], draw: "Draw") -> Images:
        if draw.chance(order.blurred):
            images = filtered(images, [blur_kernel(order.sigma, draw) for _ in images])
        low, high = order.scale
        up, down, _ = order.directions
        position = draw.uniform(0, 1)
        scale = draw.uniform(1, high) if position < up else draw.uniform(low, 1) if position < up + down else 1.0
        images = resized(images, [max(1, int(side * scale)) for side in size], draw)
        return torch.stack([noisy(image, order, draw) for image in images])


@dataclass(frozen=True)
class Draw:
    """Random numbers of one generator."""

    generator: torch.Generator

    def uniform(self, low: float, high: float) -> float:
        """A number in [low, high)."""
        return low + (high - low) * float(torch.rand((), generator=self.generator))

    def chance(self, share: float) -> bool:
        """Whether something of this chance happens."""
        return self.uniform(0, 1) < share

    def side(self) -> int:
        """Side of a kernel: 7, 9 ... 21, with equal probability."""
        return 1 + 2 * int(self.uniform(SIZES[0], SIZES[1] + 1))


def blur_kernel(sigma: Range, draw: Draw) -> Float[Tensor, "k k"]:
    """A sinc, Gaussian, generalised Gaussian or plateau-shaped kernel (equations 2 to 4 with d = Cᵀ Σ⁻¹ C).

    exp(-d^β / 2) with β = 1 for the Gaussian, 1 / (1 + d^β) for the plateau.
    """
    side = draw.side()
    if draw.chance(SINC):
        return sinc_kernel(side, draw.uniform(math.pi / (3 if side < 13 else 5), math.pi))
    u = draw.uniform(0, 1)
    kind = "gaussian" if u < KINDS["gaussian"] else "generalised" if u < 1 - KINDS["plateau"] else "plateau"
    along = across = draw.uniform(*sigma)
    angle = 0.0
    if not draw.chance(ISOTROPIC[kind]):
        across, angle = draw.uniform(*sigma), draw.uniform(-math.pi, math.pi)
    x, y = _offsets(side)
    first = (math.cos(angle) * x + math.sin(angle) * y) / along
    second = (math.cos(angle) * y - math.sin(angle) * x) / across
    distance = (first.square() + second.square()) ** draw.uniform(*SHAPE[kind])
    kernel = 1 / (1 + distance) if kind == "plateau" else torch.exp(-0.5 * distance)
    return kernel / kernel.sum()


def sinc_kernel(side: int, cutoff: float) -> Float[Tensor, "k k"]:
    """The circular low-pass filter, ω / (2 π r) · J₁(ω r) (equation 5), which rings and overshoots."""
    x, y = _offsets(side)
    radius = torch.sqrt(x.square() + y.square())
    kernel = cutoff * torch.special.bessel_j1(cutoff * radius) / (2 * math.pi * radius.clamp_min(1e-6))
    kernel[side // 2, side // 2] = cutoff**2 / (4 * math.pi)
    return kernel / kernel.sum()


def _offsets(side: int) -> tuple[Tensor, Tensor]:
    line = torch.arange(side, dtype=torch.float32) - side // 2
    return line[None, :], line[:, None]


def filtered(images: Images, kernels: Sequence[Float[Tensor, "_ _"]]) -> Images:
    """Filter each image by its own kernel, with reflection padding."""
    return torch.cat([filter2d(images[i : i + 1], kernel[None]) for i, kernel in enumerate(kernels)])


def resized(images: Images, size: Sequence[int], draw: Draw) -> Images:
    """Resize by area, bilinear or bicubic interpolation, with equal probability."""
    mode = ("area", "bilinear", "bicubic")[int(draw.uniform(0, 3))]
    options = {} if mode == "area" else {"align_corners": False}
    return F.interpolate(images, size=tuple(size), mode=mode, **options)


def noisy(image: Float[Tensor, "3 h w"], order: Order, draw: Draw) -> Float[Tensor, "3 h w"]:
    """Add Gaussian or Poisson noise, in grey or in colour."""
    grey = draw.chance(GREY)
    if draw.chance(GAUSSIAN):
        noise = torch.randn((1 if grey else 3, *image.shape[1:]), generator=draw.generator)
        return (image + noise * draw.uniform(*order.noise) / 255).clamp(0, 1)
    light = image.clamp(0, 1)
    light = rgb_to_grayscale(light[None])[0] if grey else light
    noise = torch.poisson(light * 255, generator=draw.generator) / 255 - light
    return (image + noise * draw.uniform(*order.poisson)).clamp(0, 1)


def jpeg(images: Images, draw: Draw) -> Images:
    """Compress each image by JPEG, at a quality of its own."""
    quality = torch.tensor([draw.uniform(*QUALITY) for _ in images])
    return jpeg_codec_differentiable(images.clamp(0, 1), quality)


def sharpened(images: Images, draw: Draw) -> Images:
    """Apply the final sinc filter where it is drawn."""
    kernels = []
    for _ in images:
        kernel = sinc_kernel(21, draw.uniform(math.pi / 3, math.pi)) if draw.chance(FINAL_SINC) else torch.ones(1, 1)
        kernels.append(kernel)
    return filtered(images, kernels).clamp(0, 1)
