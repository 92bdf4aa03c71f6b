"""Finished renders with their geometry and photos: the interface between splats, enhancement and metrics.

Axes: h height, w width.
"""

from collections.abc import Callable
from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.types import Camera


@dataclass(frozen=True)
class RenderedView:
    """One rendered view and, where they are known, its geometry and its photo. Pixels are read when asked for.

    Args:
        name: the render's file name with ending; outputs keep it.
        read: returns the render, shape (3, height, width), [0, 1].
        camera: where it was rendered from; None in a folder without cameras.
        read_depth: returns rendered z depth, shape (1, height, width), 0 where nothing was hit.
        read_alpha: returns rendered opacity, shape (1, height, width).
        read_photo: returns the photo of the same view: the truth of a target, the pixels of a reference.
        read_fine_photo: returns that photo 4 times as fine as the render; a reference's without a render of its own
            may have any size.
        fine_size: height and width of the finer photo itself, where rounding makes it miss 4 times the render's; what
            is written is brought to it.
    """

    name: str
    read: Callable[[], Float[Tensor, "3 h w"]] | None
    camera: Camera | None = None
    read_depth: Callable[[], Float[Tensor, "1 h w"]] | None = None
    read_alpha: Callable[[], Float[Tensor, "1 h w"]] | None = None
    read_photo: Callable[[], Float[Tensor, "3 h w"]] | None = None
    read_fine_photo: Callable[[], Float[Tensor, "3 _ _"]] | None = None
    fine_size: tuple[int, int] | None = None


@dataclass(frozen=True)
class RenderedSet:
    """The renders of one splat: targets to enhance, and the training views whose photos serve as references.

    Args:
        name: short name, used in records and folders.
        targets: renders to enhance; ``read`` is never None.
        references: views with ``read_photo``; ``read_depth`` (rendered) allows the occlusion check, ``read`` may
            be None.
        background: colour composited under the renders.
        own_depth: depth is known to fit the renders: this project's own rasteriser made both, or it was checked before.
    """

    name: str
    targets: tuple[RenderedView, ...]
    references: tuple[RenderedView, ...]
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    own_depth: bool = False
