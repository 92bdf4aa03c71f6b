"""Loss terms, unreduced: what each pixel costs.

Axes: b batch, c channels, h height, w width. Every term takes the enhanced view, the photo and the render it started
from, in that order, and returns a cost per pixel, so that a caller may mask or weigh before it averages.
"""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.ssim import gaussian, ssim_map

Images = Float[Tensor, "b c h w"]


@runtime_checkable
class Term(Protocol):
    """Cost per pixel of an enhanced view against the photo, knowing the render it started from."""

    def __call__(self, enhanced: Tensor, photo: Tensor, render: Tensor) -> Tensor:
        """Return unreduced costs."""
        ...


@dataclass(frozen=True)
class Charbonnier:
    """Term: smooth absolute difference, sqrt(d^2 + softness^2) - softness (Lai et al., CVPR 2017).

    Args:
        softness: difference below which the cost is quadratic, > 0.
    """

    softness: float = 1e-3

    def __call__(self, enhanced: Images, photo: Images, render: Images) -> Images:
        """Cost per pixel."""
        return ((enhanced - photo).square() + self.softness**2).sqrt() - self.softness


@dataclass(frozen=True)
class SquaredError:
    """Term: squared difference; its mean is what PSNR is the logarithm of."""

    def __call__(self, enhanced: Images, photo: Images, render: Images) -> Images:
        """Cost per pixel."""
        return (enhanced - photo).square()


@dataclass(frozen=True)
class DSSIM:
    """Term: `dssim`, 1 - SSIM."""

    def __call__(self, enhanced: Images, photo: Images, render: Images) -> Images:
        """Cost per pixel."""
        return dssim(enhanced, photo)


def dssim(enhanced: Images, photo: Images) -> Images:
    """1 - SSIM (`ssim_map`).

    Args:
        enhanced: colours in [0, 1].
        photo: colours in [0, 1].
    """
    return 1 - ssim_map(enhanced, photo, _window_means)


def _window_means(images: Float[Tensor, "*n h w"]) -> Float[Tensor, "*n h w"]:
    """Images under SSIM's window: on crops, a product with band matrices costs a fifth of a convolution."""
    rows, columns = (_window_band(length, images) for length in images.shape[-2:])
    return rows @ (images @ columns)


def _window_band(length: int, like: Tensor) -> Float[Tensor, "{length} {length}"]:
    """SSIM's window along an axis as a symmetric band matrix, zeros outside."""
    offsets = torch.arange(length, dtype=like.dtype, device=like.device)
    return gaussian(offsets[:, None] - offsets)


@dataclass(frozen=True)
class GradientDifference:
    """Term: absolute difference of the forward differences along x and y: punishes blur more than a shift of tone."""

    def __call__(self, enhanced: Images, photo: Images, render: Images) -> Images:
        """Cost per pixel."""
        difference = enhanced - photo
        along_x = F.pad(difference[..., :, 1:] - difference[..., :, :-1], (0, 1))
        along_y = F.pad(difference[..., 1:, :] - difference[..., :-1, :], (0, 0, 0, 1))
        return along_x.abs() + along_y.abs()


@dataclass(frozen=True)
class FrequencyDifference:
    """Term: absolute difference of the orthonormal Fourier spectra, |F(d)|, laid out as `torch.fft.fft2` gives it.

    The L1 form of the spectral losses in image restoration (Cho et al., ICCV 2021); the orthonormal transform keeps
    its size independent of the image's.
    """

    def __call__(self, enhanced: Images, photo: Images, render: Images) -> Images:
        """Cost per frequency."""
        return (torch.fft.fft2((enhanced - photo).float(), norm="ortho").abs().square() + 1e-8).sqrt()


@dataclass(frozen=True)
class Harm:
    """Term: how much worse than the render a neighbourhood became, max(0, mean |e - p| - mean |r - p|) over a window.

    Args:
        window: side of the neighbourhood, odd: single pixels may lose where their surroundings win.
    """

    window: int = 9

    def __call__(self, enhanced: Images, photo: Images, render: Images) -> Images:
        """Cost per pixel."""
        change = (enhanced - photo).abs() - (render - photo).abs()
        padding = self.window // 2
        return F.relu(F.avg_pool2d(change, self.window, stride=1, padding=padding, count_include_pad=False))


@dataclass(frozen=True)
class Relative:
    """Another term in units of what the render costs: term(enhanced) / (mean term(render) + floor), image by image.

    An absolute cost is ruled by the worst renders, where there is most to gain, and hardly notices when a good render
    is made worse. Relative to the render, one per cent of a good render's error weighs as much as one of a bad one's,
    as in a gain measured in dB.

    Args:
        term: what is measured.
        floor: render's cost below which nothing more is asked for, > 0.
        unit: what the render's cost is measured by; None means by ``term``. `Harm`, of which a render has none, needs
            one.
    """

    term: Term
    floor: float
    unit: Term | None = None

    def __call__(self, enhanced: Images, photo: Images, render: Images) -> Images:
        """Cost per pixel; 1 on average where nothing was changed and the floor is far."""
        with torch.no_grad():
            unit = self.term if self.unit is None else self.unit
            before = unit(render, photo, render).mean(dim=(1, 2, 3), keepdim=True)
        return self.term(enhanced, photo, render) / (before + self.floor)
