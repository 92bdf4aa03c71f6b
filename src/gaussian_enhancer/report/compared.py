"""What a report compares: a render before and after enhancing, its photo, and the numbers measured on both.

Axes: h height, w width; _ an axis that the user may have got wrong, which `check_views` refuses with a clear line.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.errors import InputError


@dataclass(frozen=True)
class ComparedView:
    """One view of a report.

    Args:
        name: the view's file name, unique in the report.
        raw: the render as it came, sRGB in [0, 1].
        enhanced: the render after enhancing, of the same size.
        photo: the truth, of the same size; None where there is none.
        metrics_raw: numbers measured between ``raw`` and ``photo``, by the metric's name.
        metrics_enhanced: the same for ``enhanced``.
        milliseconds: time that enhancing took; None where it was not measured.
        reasons: why a metric has no number, by the metric's name.
    """

    name: str
    raw: Float[Tensor, "3 h w"]
    enhanced: Float[Tensor, "3 _ _"]
    photo: Float[Tensor, "3 _ _"] | None
    metrics_raw: Mapping[str, float]
    metrics_enhanced: Mapping[str, float]
    milliseconds: float | None = None
    reasons: Mapping[str, str] = field(default_factory=dict)


def check_views(views: Sequence[ComparedView]) -> None:
    """Refuse what cannot be laid side by side.

    Raises:
        InputError: no view, a name twice, or images of one view that differ in size.
    """
    if not views:
        raise InputError("report", "has no view to show", "give at least one enhanced view")
    seen: set[str] = set()
    for view in views:
        if view.name in seen:
            raise InputError(f"view {view.name}", "occurs twice in the report", "give every view its own name")
        seen.add(view.name)
        for label, image in (("enhanced", view.enhanced), ("photo", view.photo)):
            if image is not None and image.shape != view.raw.shape:
                received = f"{label} has size {size_of(image)}, the render {size_of(view.raw)}"
                raise InputError(f"view {view.name}", received, "bring both to one size before reporting")


def size_of(image: Float[Tensor, "3 h w"]) -> str:
    """Width and height as people write them, for instance ``640×480``."""
    return f"{image.shape[-1]}×{image.shape[-2]}"
