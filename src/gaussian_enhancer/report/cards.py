"""Pictures of a view's card, and the error scale shared by all cards of a page."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from gaussian_enhancer.report.compared import ComparedView, ViewPixels, size_of
from gaussian_enhancer.report.figures import (
    absolute_error,
    apply_colour_map,
    colour_map,
    data_uri,
    error_scale,
    sample_values,
)

PAGE_BYTES = 40_000_000
"""Maximum number of bytes of all pictures of a page together, before base64."""

IMAGE_BYTES = 600_000
"""Maximum number of bytes of one picture."""


@dataclass(frozen=True)
class CardImages:
    """Settings that the pictures of a page share.

    Args:
        scale: error that maps to the lightest colour, the same for all maps of the page; None if no view has a photo.
        budget: maximum number of bytes of one picture.
        ramp: the error colours as a CSS list, dark to light.
        portrait: whether all pictures are taller than wide.
    """

    scale: float | None
    budget: int
    ramp: str
    portrait: bool

    @classmethod
    def of(cls, views: Sequence[ComparedView]) -> "CardImages":
        """Determine the settings from the views that get pictures."""
        errors, portrait = [], True
        for view in views:
            images = view.read()
            portrait &= images.raw.shape[1] > images.raw.shape[2]
            if images.photo is not None:
                errors += [
                    sample_values(absolute_error(image, images.photo)) for image in (images.raw, images.enhanced)
                ]
        colours = [", ".join(f"{100 * c:.1f}%" for c in colour) for colour in colour_map(9).tolist()]
        return cls(
            scale=error_scale(errors) if errors else None,
            budget=min(IMAGE_BYTES, PAGE_BYTES // (5 * len(views))),
            ramp=", ".join(f"rgb({colour})" for colour in colours),
            portrait=portrait,
        )


def pictured_indices(count: int, worst: int | None, max_pictured: int) -> list[int]:
    """Indices of the views shown with pictures: all, or an even selection that includes the worst.

    Args:
        count: number of views.
        worst: index of the worst view; None if no view has a gain.
        max_pictured: maximum number of views with pictures.
    """
    if count <= max_pictured:
        return list(range(count))
    selected = {round(i * (count - 1) / max(1, max_pictured - 1)) for i in range(max_pictured)}
    if worst is not None and worst not in selected:
        selected.remove(min(selected, key=lambda i: abs(i - worst)))
        selected.add(worst)
    return sorted(selected)


@dataclass(frozen=True)
class Picture:
    """One picture of a card.

    Args:
        name: its CSS class.
        uri: the picture as a ``data:`` URI.
        alt: alternative text: what the picture shows.
    """

    name: str
    uri: str
    alt: str


@dataclass(frozen=True)
class Card:
    """One view as ``templates/card.html`` shows it.

    Args:
        index: index of the view in the report; names the anchor ``view-INDEX``.
        view: the view.
        worst: whether this view has the worst gain.
        size: width and height as text.
        ratio: width over height.
        with_photo: whether there is a photo.
        pictures: render, enhanced render and, where there is a photo, the photo and both errors.
    """

    index: int
    view: ComparedView
    worst: bool
    size: str
    ratio: str
    with_photo: bool
    pictures: tuple[Picture, ...]


def card(index: int, view: ComparedView, shared: CardImages, *, worst: bool) -> Card:
    """Read a view's images and make its pictures.

    Args:
        index: index of the view in the report.
        view: the view.
        shared: settings that all pictures share.
        worst: whether this view has the worst gain.
    """
    images = view.read()
    ratio = f"{images.raw.shape[-1] / images.raw.shape[-2]:.5f}"
    pictures = tuple(_pictures(images, shared))
    return Card(index, view, worst, size_of(images.raw), ratio, images.photo is not None, pictures)


def _pictures(images: ViewPixels, shared: CardImages) -> Iterator[Picture]:
    yield Picture("raw", data_uri(images.raw, shared.budget), "render")
    yield Picture("enhanced", data_uri(images.enhanced, shared.budget), "enhanced render")
    if images.photo is None or shared.scale is None:
        return
    yield Picture("photo", data_uri(images.photo, shared.budget), "photo")
    for name, image, label in (("raw", images.raw, "render"), ("enhanced", images.enhanced, "enhanced")):
        errors = apply_colour_map(absolute_error(image, images.photo), shared.scale)
        yield Picture(f"error-{name}", data_uri(errors, shared.budget // 3), f"error of the {label}")
