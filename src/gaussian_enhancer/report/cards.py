"""Card of one view: images under a movable divider, with the numbers below."""

from collections.abc import Sequence
from dataclasses import dataclass

from gaussian_enhancer.report.compared import ComparedView, Images, size_of
from gaussian_enhancer.report.figures import colour_map, data_uri, error, error_map, error_scale, sampled
from gaussian_enhancer.report.markup import Markup, fill, joined, resource, tag
from gaussian_enhancer.report.quantities import Quantity
from gaussian_enhancer.report.summary import gain_of

PAGE_BYTES = 40_000_000
"""Bytes that all pictures of a page may take together, before base64."""

IMAGE_BYTES = 600_000
"""Bytes that one picture may take."""


@dataclass(frozen=True)
class Pictures:
    """What the pictures of a page share.

    Args:
        scale: error of the lightest colour, the same for all maps of the page; None where no view has a photo.
        budget: bytes for one picture.
        ramp: the error colours as a CSS list, dark to light.
        portrait: whether all pictures are higher than wide.
    """

    scale: float | None
    budget: int
    ramp: str
    portrait: bool

    @classmethod
    def of(cls, views: Sequence[ComparedView]) -> "Pictures":
        """The shared scale and budget of the views that get pictures."""
        errors, portrait = [], True
        for view in views:
            images = view.read()
            portrait &= images.raw.shape[1] > images.raw.shape[2]
            if images.photo is not None:
                errors += [sampled(error(image, images.photo)) for image in (images.raw, images.enhanced)]
        colours = [", ".join(f"{100 * c:.1f}%" for c in colour) for colour in colour_map(9).tolist()]
        return cls(
            scale=error_scale(errors) if errors else None,
            budget=min(IMAGE_BYTES, PAGE_BYTES // (5 * len(views))),
            ramp=", ".join(f"rgb({colour})" for colour in colours),
            portrait=portrait,
        )


def pictured(count: int, worst: int | None, most: int) -> list[int]:
    """Indices of the views shown with pictures: all, or an even selection that includes the worst."""
    if count <= most:
        return list(range(count))
    chosen = {round(i * (count - 1) / max(1, most - 1)) for i in range(most)}
    if worst is not None and worst not in chosen:
        chosen.remove(min(chosen, key=lambda i: abs(i - worst)))
        chosen.add(worst)
    return sorted(chosen)


def card(index: int, view: ComparedView, quantities: Sequence[Quantity], pictures: Pictures, *, worst: bool) -> Markup:
    """One view as an article.

    Args:
        index: the view's place in the report; names the anchor ``view-INDEX``.
        view: the view.
        quantities: the metrics of the report, in order.
        pictures: what all pictures share.
        worst: whether this frame fared worst.
    """
    images = view.read()
    with_photo = images.photo is not None
    return fill(
        "card.html",
        {
            "index": str(index),
            "name": view.name,
            "size": size_of(images.raw),
            "ratio": f"{images.raw.shape[-1] / images.raw.shape[-2]:.5f}",
            "badge": tag("span", "worst frame", class_="badge") if worst else Markup(),
            "time": _time(view),
            "images": _pictures(view.name, images, pictures),
            "modes": Markup(resource("modes.html")) if with_photo else Markup(),
            "scale": _legend(pictures.scale) if with_photo and pictures.scale is not None else Markup(),
            "numbers": _numbers(view, quantities),
        },
    )


def _pictures(name: str, images: Images, shared: Pictures) -> Markup:
    shown = {"raw": (images.raw, "render"), "enhanced": (images.enhanced, "enhanced render")}
    budgets = dict.fromkeys(("raw", "enhanced", "photo"), shared.budget)
    if images.photo is not None and shared.scale is not None:
        shown["photo"] = (images.photo, "photo")
        for key, image, alt in (("error-raw", images.raw, "render"), ("error-enhanced", images.enhanced, "enhanced")):
            shown[key] = (error_map(error(image, images.photo), shared.scale), f"error of the {alt}")
            budgets[key] = shared.budget // 3
    return joined(
        *(
            tag("img", class_=key, src=data_uri(image, budgets[key]), alt=f"{alt}, {name}", draggable="false")
            for key, (image, alt) in shown.items()
        )
    )


def _legend(scale: float) -> Markup:
    return tag(
        "div",
        tag("span", "0"),
        tag("i"),
        tag("span", f"≥ {scale:.2f}", data_scale=repr(scale)),
        class_="legend",
        title="mean absolute difference from the photo, 1 is white against black; one scale for the whole page",
    )


def _time(view: ComparedView) -> Markup:
    if view.milliseconds is None:
        return Markup()
    return tag("span", f"{view.milliseconds:.0f} ms", class_="time", data_value=repr(view.milliseconds))


def _numbers(view: ComparedView, quantities: Sequence[Quantity]) -> Markup:
    if not quantities:
        return tag("p", "No photo of this view: nothing to measure against.", class_="quiet")
    heads = [tag("th", text, scope="col") for text in ("", "render", "enhanced", "gain")]
    rows = [_row(view, quantity) for quantity in quantities]
    return tag("table", tag("thead", tag("tr", *heads)), tag("tbody", *rows), class_="numbers")


def _row(view: ComparedView, quantity: Quantity) -> Markup:
    key = quantity.key
    unit = tag("small", f" {quantity.unit}") if quantity.unit else ""
    head = tag("th", quantity.label, unit, scope="row", title=quantity.meaning or None)
    gain = gain_of(view, key)
    if gain is None:
        reason = view.reasons.get(key, "not measured")
        return tag("tr", head, tag("td", reason, colspan="3", class_="reason", title=reason), data_metric=key)
    cells = [
        tag("td", quantity.written(values[key]), data_of=name, data_value=repr(values[key]))
        for name, values in (("raw", view.metrics_raw), ("enhanced", view.metrics_enhanced))
    ]
    shown = tag("td", quantity.gain_written(gain), class_=quantity.verdict(gain), data_of="gain", data_value=repr(gain))
    return tag("tr", head, *cells, shown, data_metric=key)
