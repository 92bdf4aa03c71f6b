"""A compared view: render, enhanced image, photo, and the measurements of the first two.

Axes: h height, w width; _ an axis whose size may be wrong in the user's files, which `ComparedView.read` refuses.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.errors import InputError


@dataclass(frozen=True)
class ViewPixels:
    """The pixels of one view.

    Args:
        raw: the render before enhancement, sRGB in [0, 1].
        enhanced: the render after enhancement.
        photo: the ground truth; None where there is none.
    """

    raw: Float[Tensor, "3 h w"]
    enhanced: Float[Tensor, "3 h w"]
    photo: Float[Tensor, "3 h w"] | None


@dataclass(frozen=True)
class ComparedView:
    """One view of a report. Pixels are read on each request and not cached, which limits the memory of long reports.

    Args:
        name: the view's file name, unique in the report.
        read_raw: returns the render before enhancement, sRGB in [0, 1].
        read_enhanced: returns the render after enhancement, of the same size.
        read_photo: returns the ground truth, of the same size; None if there is none.
        metrics_raw: values measured between render and photo, by the metric's name.
        metrics_enhanced: the same for the enhanced render.
        milliseconds: run time of the enhancement; None if it was not measured.
        reasons: reasons for missing values, by the metric's name.
    """

    name: str
    read_raw: Callable[[], Float[Tensor, "3 _ _"]]
    read_enhanced: Callable[[], Float[Tensor, "3 _ _"]]
    read_photo: Callable[[], Float[Tensor, "3 _ _"]] | None = None
    metrics_raw: Mapping[str, float] = field(default_factory=dict)
    metrics_enhanced: Mapping[str, float] = field(default_factory=dict)
    milliseconds: float | None = None
    reasons: Mapping[str, str] = field(default_factory=dict)

    def read(self) -> ViewPixels:
        """Read the view's pixels.

        Raises:
            InputError: the images differ in size, or one cannot be read.
        """
        raw, enhanced = self.read_raw(), self.read_enhanced()
        photo = None if self.read_photo is None else self.read_photo()
        for label, image in (("enhanced", enhanced), ("photo", photo)):
            if image is not None and image.shape != raw.shape:
                received = f"{label} has size {size_of(image)}, the render {size_of(raw)}"
                raise InputError(f"view {self.name}", received, "bring both to one size before reporting")
        return ViewPixels(raw, enhanced, photo)


def check_names(views: Sequence[ComparedView]) -> None:
    """Refuse a report without views, or with several views of the same name.

    Raises:
        InputError: there is no view, or a name occurs twice.
    """
    if not views:
        raise InputError("report", "has no view to show", "give at least one enhanced view")
    names: set[str] = set()
    for view in views:
        if view.name in names:
            raise InputError(f"view {view.name}", "occurs twice in the report", "give every view its own name")
        names.add(view.name)


def size_of(image: Float[Tensor, "3 h w"]) -> str:
    """Width and height as text, for instance ``640×480``."""
    return f"{image.shape[-1]}×{image.shape[-2]}"
