"""Crops of real renders where an error of one kind is largest, which types of artefacts are compared with.

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
"""The error energy that each type of artefact represents; other types have no energy of their own."""

ADDED = 0.9
"""Least contrast of a render's crop, as a share of the photo's, at which its error counts as an added artefact."""

Place = tuple[int, int]
"""Top and left of a crop, pixels."""
Size = tuple[int, int]
"""Height and width of a crop, pixels."""


@dataclass(frozen=True)
class Crop:
    """A crop of a render with its error.

    Args:
        view: index of its pair.
        place: its position in the view.
        energies: of its error, in the order of `ENERGIES`.
        contrast: its standard deviation over that of the photo.
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
    all_crops = []
    for view, (render, photo) in enumerate(pairs):
        for place in places(render.shape[-2], render.shape[-1], size):
            render_crop, photo_crop = cut(render, place, size), cut(photo, place, size)
            contrast = float(render_crop.std() / photo_crop.std().clamp_min(1e-6))
            all_crops.append(Crop(view, place, error_energies(render_crop, photo_crop), contrast))
    return all_crops


def worst(candidates: Sequence[Crop], kind: str) -> Crop:
    """The crop that shows a kind of error best: e^2 / sum of the crop's energies, with e the kind's own.

    The crop shall show an artefact that the render adds. An object that the render lacks altogether, such as a pole
    that no training view shows, is an equally large error, but no enhancer could repair it. Therefore crops with less
    than `ADDED` of the photo's contrast are used only if there are no others. Blur, which always loses contrast, is
    exempt.

    Args:
        candidates: crops, at least one.
        kind: one of `ENERGIES`.
    """
    index = ENERGIES.index(kind)
    eligible = [crop for crop in candidates if kind == "blur" or crop.contrast >= ADDED] or candidates
    return max(eligible, key=lambda crop: float(crop.energies[index] ** 2 / crop.energies.sum().clamp_min(1e-12)))


def energies_of(members: Sequence[Crop]) -> Float[Tensor, "n 6"]:
    """The energies of crops, one a row."""
    return torch.stack([crop.energies for crop in members])
