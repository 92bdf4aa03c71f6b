"""A scene's fingerprint: six energies of the residual render - photo, one per kind of error.

Each energy is a mean square of a (filtered) part of the residual. It does not depend on bit depth and is proportional
to the square of the residual, and the energies of independent errors add up.

Axes: c channels, h height, w width.
"""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
import torch.nn.functional as F
from jaxtyping import Float
from kornia.filters import gaussian_blur2d
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import write_json
from gaussian_enhancer.scene.rendered import RenderedSet

DETAIL_SIGMA = 1.5
"""Standard deviation in pixels of the Gaussian that separates detail, which it removes."""
LOW_FREQUENCY_SIGMA = 1 / 6
"""Standard deviation, relative to the larger side, of the Gaussian that separates low frequencies, which it keeps.

Medium frequencies lie between the two Gaussians.
"""
ENERGIES = ("blur", "noise", "anisotropy", "banding", "low_frequency", "floater")


@dataclass(frozen=True)
class Fingerprint:
    """Six energies of the residual r = render - photo, each a mean over pixels, channels and views; colours in [0, 1].

    Args:
        blur: energy of the detail that is locally proportional to the photo's detail, which the render has lost.
        noise: energy of the remaining detail, uncorrelated with the photo's.
        anisotropy: part of ``noise`` whose gradients have a common direction within a few pixels, as needles do.
        banding: energy of medium frequencies whose gradients have a common direction over long distances, as bands do.
        low_frequency: energy after strong smoothing, as of veils and colour shifts.
        floater: energy of undirected medium frequencies that is concentrated in few places, as of blobs.
        views: number of measured views.

    Raises:
        InputError: an energy is negative or not finite, or there are no views.
    """

    blur: float
    noise: float
    anisotropy: float
    banding: float
    low_frequency: float
    floater: float
    views: int

    def __post_init__(self) -> None:
        for name in ENERGIES:
            value = getattr(self, name)
            if not math.isfinite(value) or value < 0:
                raise InputError(f"fingerprint's {name}", f"is {value}", "measure it again on finite images")
        if self.views < 1:
            raise InputError("fingerprint's views", f"are {self.views}", "measure it on at least one view")

    def energies(self) -> Float[Tensor, "6"]:
        """The energies in the order of `ENERGIES`, in double precision."""
        return torch.tensor([getattr(self, name) for name in ENERGIES], dtype=torch.float64)

    def table(self) -> str:
        """Amplitudes (square roots of the energies) in units of 1/255, one per line, for the terminal."""
        amplitudes = (f"{name:<14}{255 * getattr(self, name) ** 0.5:8.3f}" for name in ENERGIES)
        return "\n".join((f"{'amplitude':<14}{'1/255':>8}   ({self.views} views)", *amplitudes))

    def to_json(self, path: str | Path) -> None:
        """Write the fingerprint as JSON, atomically.

        Raises:
            InputError: the file cannot be written.
        """
        write_json(path, dataclasses.asdict(self), indent=1)


def measure_fingerprint(
    renders: Sequence[Float[Tensor, "3 _ _"]], photos: Sequence[Float[Tensor, "3 _ _"]]
) -> Fingerprint:
    """Measure a fingerprint on pairs of a render and its photo. All views have equal weight, whatever their size.

    Args:
        renders: sRGB in [0, 1].
        photos: photos of the same views, each of its render's size.

    Raises:
        InputError: there are no pairs, the numbers of renders and photos differ, sizes differ or a value is not finite.
    """
    if not renders or len(renders) != len(photos):
        raise InputError("fingerprint", f"got {len(renders)} renders and {len(photos)} photos", "give pairs")
    for index, (render, photo) in enumerate(zip(renders, photos, strict=True)):
        if render.shape != photo.shape:
            received = f"has the shape {tuple(render.shape)} beside a photo of {tuple(photo.shape)}"
            raise InputError(f"render {index}", received, "bring both to the same size")
    return _mean_fingerprint([error_energies(render, photo) for render, photo in zip(renders, photos, strict=True)])


def fingerprint_of_training_views(rendered: RenderedSet) -> Fingerprint:
    """The fingerprint of a splat on its training views, which are the references of its set.

    Args:
        rendered: a fitted run's renders, including its training views.

    Raises:
        InputError: no training view has both a render and a photo.
    """
    pairs = [(view.read, view.read_photo) for view in rendered.references]
    energies = [error_energies(read(), photo()) for read, photo in pairs if read is not None and photo is not None]
    if not energies:
        received = "has no training view with both a render and a photo"
        raise InputError(rendered.name, received, "render the run's training views as well")
    return _mean_fingerprint(energies)


def _mean_fingerprint(energies: Sequence[Float[Tensor, "6"]]) -> Fingerprint:
    """The fingerprint with the mean energies of several views."""
    mean = torch.stack(list(energies)).mean(0).tolist()
    return Fingerprint(**dict(zip(ENERGIES, mean, strict=True)), views=len(energies))


def error_energies(render: Float[Tensor, "3 h w"], photo: Float[Tensor, "3 h w"]) -> Float[Tensor, "6"]:
    """The six energies of one view, in the order of `ENERGIES`.

    Args:
        render: sRGB in [0, 1].
        photo: photo of the same view.
    """
    target = photo.float()[None]
    residual = render.float()[None] - target
    coarse_sigma = max(2 * DETAIL_SIGMA, LOW_FREQUENCY_SIGMA * max(residual.shape[-2:]))
    smoothed = smooth(residual, DETAIL_SIGMA)
    coarse = smooth(residual, coarse_sigma)
    detail = residual - smoothed
    correlated = project_onto_photo(detail, target - smooth(target, DETAIL_SIGMA))
    uncorrelated = detail - correlated
    needles, _ = split_by_direction(uncorrelated, 2 * DETAIL_SIGMA)
    bands, blobs = split_by_direction(smoothed - coarse, coarse_sigma / 2)
    energies = (
        correlated.square().mean(),
        uncorrelated.square().mean(),
        needles.mean(),
        bands.mean(),
        coarse.square().mean(),
        excess_over_median(blobs),
    )
    return torch.stack(energies).double().cpu()


def smooth(image: Float[Tensor, "1 c h w"], sigma: float) -> Float[Tensor, "1 c h w"]:
    """Gaussian smoothing; wide Gaussians are computed at a lower resolution.

    Args:
        image: image of any size.
        sigma: standard deviation in pixels.
    """
    height, width = image.shape[-2:]
    factor = max(1, int(sigma / 4))
    if factor > 1:
        coarse_size = max(1, height // factor), max(1, width // factor)
        image, sigma = F.interpolate(image, coarse_size, mode="area"), sigma / factor
    size = 2 * math.ceil(3 * sigma) + 1
    image = gaussian_blur2d(image, (size, size), (sigma, sigma), border_type="replicate")
    return F.interpolate(image, (height, width), mode="bilinear", align_corners=False) if factor > 1 else image


def project_onto_photo(
    error_detail: Float[Tensor, "1 3 h w"], photo_detail: Float[Tensor, "1 3 h w"]
) -> Float[Tensor, "1 3 h w"]:
    """The part of an error's detail that is locally proportional to the photo's detail.

    <r, p> / <p, p> p, with inner products over channels and a Gaussian window of 6 times `DETAIL_SIGMA`. The window is
    wide enough for the chance correlation of noise to be small.

    Args:
        error_detail: the error's detail r.
        photo_detail: the photo's detail p.
    """
    correlation = smooth((error_detail * photo_detail).sum(1, keepdim=True), 6 * DETAIL_SIGMA)
    photo_energy = smooth(photo_detail.square().sum(1, keepdim=True), 6 * DETAIL_SIGMA)
    # A uniform photo has no detail to lose: below this limit the projection would be onto rounding errors.
    factor = correlation / photo_energy.clamp_min(1e-10)
    return torch.where(photo_energy > 1e-10, factor, torch.zeros_like(factor)) * photo_detail


def split_by_direction(
    band: Float[Tensor, "1 3 h w"], window: float
) -> tuple[Float[Tensor, "1 1 h w"], Float[Tensor, "1 1 h w"]]:
    """Split the local energy of an error into a directed and an undirected part.

    The directed share is the coherence (l1 - l2) / (l1 + l2) of the structure tensor with eigenvalues l1 >= l2.

    Args:
        band: a frequency band of an error.
        window: standard deviation in pixels of the window for mean energies and for the structure tensor.
    """
    padded = F.pad(band, (1, 1, 1, 1), mode="replicate")
    right = (padded[..., 1:-1, 2:] - padded[..., 1:-1, :-2]) / 2
    down = (padded[..., 2:, 1:-1] - padded[..., :-2, 1:-1]) / 2
    products = torch.stack([band.square(), right.square(), down.square(), right * down], 1).mean(2)
    energy, xx, yy, xy = smooth(products, window).split(1, dim=1)
    coherence = torch.hypot(xx - yy, 2 * xy) / (xx + yy).clamp_min(1e-30)
    return energy * coherence, energy * (1 - coherence)


def excess_over_median(energy: Float[Tensor, "1 1 h w"]) -> Float[Tensor, ""]:
    """Excess of the mean over the median: near 0 for a uniform energy, near the mean for one in few places.

    Args:
        energy: energy at each pixel, averaged over a neighbourhood.
    """
    return (energy.mean() - energy.median()).clamp_min(0)
