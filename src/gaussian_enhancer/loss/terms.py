"""Loss terms without reduction: a cost per pixel.

Axes: b batch, c channels, h height, w width. Every term takes the enhanced view, the photo and the render that was
enhanced, in that order. It returns a cost per pixel, so that a caller can apply masks or weights before averaging.
"""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.ssim import ssim_map, window_weights

Images = Float[Tensor, "b c h w"]


@runtime_checkable
class Term(Protocol):
    """Cost per pixel of an enhanced view, given the photo and the render that was enhanced."""

    def __call__(self, enhanced: Tensor, photo: Tensor, render: Tensor) -> Tensor:
        """Return the costs without reduction."""
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
    """Term: squared difference, whose mean PSNR is computed from."""

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
    """Local means under SSIM's window, as products with band matrices: on crops a fifth of a convolution's cost."""
    rows, columns = (_window_band(length, images) for length in images.shape[-2:])
    return rows @ (images @ columns)


def _window_band(length: int, like: Tensor) -> Float[Tensor, "{length} {length}"]:
    """SSIM's window along one axis as a symmetric band matrix; equals zero padding at the borders."""
    offsets = torch.arange(length, dtype=like.dtype, device=like.device)
    return window_weights(offsets[:, None] - offsets)


@dataclass(frozen=True)
class GradientDifference:
    """Term: absolute difference of the forward differences along x and y. Penalises blur more than a shift of tone."""

    def __call__(self, enhanced: Images, photo: Images, render: Images) -> Images:
        """Cost per pixel."""
        difference = enhanced - photo
        along_x = F.pad(difference[..., :, 1:] - difference[..., :, :-1], (0, 1))
        along_y = F.pad(difference[..., 1:, :] - difference[..., :-1, :], (0, 0, 0, 1))
        return along_x.abs() + along_y.abs()


@dataclass(frozen=True)
class FrequencyDifference:
    """Term: absolute difference of the orthonormal Fourier spectra, |F(d)|, laid out as `torch.fft.fft2` gives it.

    The L1 form of the spectral losses in image restoration (Cho et al., ICCV 2021). With the orthonormal transform the
    magnitude of the loss does not depend on the size of the image.
    """

    def __call__(self, enhanced: Images, photo: Images, render: Images) -> Images:
        """Cost per frequency."""
        return (torch.fft.fft2((enhanced - photo).float(), norm="ortho").abs().square() + 1e-8).sqrt()


@dataclass(frozen=True)
class Harm:
    """Term: increase of the mean error over a window, max(0, mean |e - p| - mean |r - p|).

    Here e is the enhanced view, p the photo and r the render.

    Args:
        window: side of the window in pixels, odd. A single pixel may become worse if its window improves.
    """

    window: int = 9

    def __call__(self, enhanced: Images, photo: Images, render: Images) -> Images:
        """Cost per pixel."""
        change = (enhanced - photo).abs() - (render - photo).abs()
        padding = self.window // 2
        return F.relu(F.avg_pool2d(change, self.window, stride=1, padding=padding, count_include_pad=False))


@dataclass(frozen=True)
class Relative:
    """Another term relative to the render's cost: term(enhanced) / (mean unit(render) + floor), for each image.

    An absolute cost is dominated by the worst renders, where most can be gained, and changes little when a good render
    is made worse. Relative to the render, one per cent of a good render's error weighs as much as one per cent of a bad
    one's, as in a gain in dB.

    Args:
        term: the term that is made relative.
        floor: added to the render's cost, > 0; limits the weight of renders whose cost is below it.
        unit: the term that measures the render's cost; None takes ``term``. `Harm` requires one, since it is 0 for the
            render itself.
    """

    term: Term
    floor: float
    unit: Term | None = None

    def __call__(self, enhanced: Images, photo: Images, render: Images) -> Images:
        """Cost per pixel; with the default unit, its mean is about 1 for an unchanged render far above the floor."""
        with torch.no_grad():
            unit_term = self.term if self.unit is None else self.unit
            render_cost = unit_term(render, photo, render).mean(dim=(1, 2, 3), keepdim=True)
        return self.term(enhanced, photo, render) / (render_cost + self.floor)
