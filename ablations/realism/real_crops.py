"""Crops of renders where an error of one kind is largest: what types of artefacts are held against.

Axes: h height, w width of a view; n crops.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.degrade.gates.fingerprint import ENERGIES, error_energies

KINDS: Mapping[str, str] = {
    "needle": "anisotropy",
    "banding": "banding",
    "floater": "floater",
    "cloudy": "low_frequency",
    "blur": "blur",
    "noise": "noise",
}
"""The error energy that types of artefacts stand for; the others have none of their own."""

ADDED = 0.9
"""Least contrast of a render's crop, as a share of the photo's, for an artefact to be something added."""

Place = tuple[int, int]
"""Top and left of a crop, pixels."""
Size = tuple[int, int]
"""Height and width of a crop, pixels."""


@dataclass(frozen=True)
class Crop:
    """A crop of a render with its error.

    Args:
        view: which of the given pairs it belongs to.
        place: where it lies.
        energies: of its error, in the order of `ENERGIES`.
        contrast: its standard deviation over the photo's.
    """

    view: int
    place: Place
    energies: Float[Tensor, "6"]
    contrast: float


def places(height: int, width: int, size: Size) -> Iterator[Place]:
    """Tops and lefts of crops that overlap by half."""
    for top in range(0, max(1, height - size[0] + 1), max(1, size[0] // 2)):
        for left in range(0, max(1, width - size[1] + 1), max(1, size[1] // 2)):
            yield top, left


def cut(image: Float[Tensor, "*c h w"], place: Place, size: Size) -> Float[Tensor, "*c _ _"]:
    """A crop of an image."""
    top, left = place
    return image[..., top : top + size[0], left : left + size[1]]


def crops(pairs: Sequence[tuple[Float[Tensor, "3 _ _"], Float[Tensor, "3 _ _"]]], size: Size) -> list[Crop]:
    """Every crop of renders, with its error.

    Args:
        pairs: renders and photos of the same views.
        size: of a crop.
    """
    found = []
    for view, (render, photo) in enumerate(pairs):
        for place in places(render.shape[-2], render.shape[-1], size):
            made, truth = cut(render, place, size), cut(photo, place, size)
            contrast = float(made.std() / truth.std().clamp_min(1e-6))
            found.append(Crop(view, place, error_energies(made, truth), contrast))
    return found


def worst(found: Sequence[Crop], kind: str) -> Crop:
    """The crop that shows a kind of error best: e^2 / sum of the crop's energies, with e the kind's own.

    What is asked for is what a render adds. Something of the photo that is missing altogether, a pole that no fitted
    view saw, is an error as large, but none that an enhancer could mend: crops of less than `ADDED` of the photo's
    contrast count only where there are no others, and where the kind is not blur, which is a loss by its nature.

    Args:
        found: crops, at least one.
        kind: one of `ENERGIES`.
    """
    index = ENERGIES.index(kind)
    among = [crop for crop in found if kind == "blur" or crop.contrast >= ADDED] or found
    return max(among, key=lambda crop: float(crop.energies[index] ** 2 / crop.energies.sum().clamp_min(1e-12)))


def energies_of(found: Sequence[Crop]) -> Float[Tensor, "n 6"]:
    """The energies of crops, one a row."""
    return torch.stack([crop.energies for crop in found])
