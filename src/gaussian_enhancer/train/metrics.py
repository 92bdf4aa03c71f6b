"""Validation metrics: gain of an enhanced image over the render, as a torchmetrics collection."""

from collections.abc import Callable

from torch import Tensor
from torchmetrics import MeanMetric, MetricCollection

from gaussian_enhancer.ssim import ssim_map

Quality = Callable[[Tensor, Tensor], Tensor]
"""A quality measure of an image and its photo; higher is better."""


class MeanGain(MeanMetric):
    """Mean over views of quality(enhanced, photo) - quality(render, photo), synchronised over processes.

    Args:
        quality: a quality measure of an image and its photo.
    """

    def __init__(self, quality: Quality) -> None:
        super().__init__(nan_strategy="disable")
        self.quality = quality

    def update(self, enhanced: Tensor, render: Tensor, photo: Tensor) -> None:  # type: ignore[override]
        """Add one view to the mean.

        Args:
            enhanced: the network's image.
            render: the splat's render, enlarged to the size of the enhanced image.
            photo: the ground truth.
        """
        super().update(self.quality(enhanced, photo) - self.quality(render, photo))


def gains(**qualities: Quality) -> MetricCollection:
    """Metrics with the mean gain of each quality measure, named ``gain/NAME``."""
    return MetricCollection(
        {name: MeanGain(quality) for name, quality in qualities.items()}, prefix="gain/", compute_groups=False
    )


def psnr(enhanced: Tensor, photo: Tensor) -> Tensor:
    """Peak signal-to-noise ratio of images in [0, 1] in dB, at most 100."""
    from torchmetrics.functional.image import peak_signal_noise_ratio

    return peak_signal_noise_ratio(enhanced, photo, data_range=1.0).clamp_max(100)


def ssim(enhanced: Tensor, photo: Tensor) -> Tensor:
    """Structural similarity, mean over all pixels (`ssim_map`)."""
    return ssim_map(enhanced, photo).mean()
