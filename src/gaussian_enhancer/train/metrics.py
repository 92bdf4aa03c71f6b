"""Validation metrics: how much better an enhanced image is than the render, as a torchmetrics collection."""

from collections.abc import Callable

from torch import Tensor
from torchmetrics import MeanMetric, MetricCollection

from gaussian_enhancer.ssim import ssim_map

Quality = Callable[[Tensor, Tensor], Tensor]
"""A figure of an image against its photo, higher is better."""


class MeanGain(MeanMetric):
    """Mean over views of quality(enhanced, photo) - quality(render, photo); torchmetrics syncs it over processes.

    Args:
        quality: a figure of an image against its photo.
    """

    def __init__(self, quality: Quality) -> None:
        super().__init__(nan_strategy="disable")
        self.quality = quality

    def update(self, enhanced: Tensor, render: Tensor, photo: Tensor) -> None:  # type: ignore[override]
        """Take one view into the mean.

        Args:
            enhanced: the network's image.
            render: the splat's, enlarged to its size.
            photo: the truth.
        """
        super().update(self.quality(enhanced, photo) - self.quality(render, photo))


def gains(**qualities: Quality) -> MetricCollection:
    """The mean gain of each quality, as ``gain/NAME``."""
    return MetricCollection(
        {name: MeanGain(one) for name, one in qualities.items()}, prefix="gain/", compute_groups=False
    )


def psnr(enhanced: Tensor, photo: Tensor) -> Tensor:
    """Peak signal-to-noise ratio in dB of images in [0, 1], 100 at most."""
    from torchmetrics.functional.image import peak_signal_noise_ratio

    return peak_signal_noise_ratio(enhanced, photo, data_range=1.0).clamp_max(100)


def ssim(enhanced: Tensor, photo: Tensor) -> Tensor:
    """Structural similarity, mean over all pixels (`ssim_map`)."""
    return ssim_map(enhanced, photo).mean()
