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
    """One rendered view and, where known, its geometry and its photo. Pixels are read on demand.

    Args:
        name: the render's file name with ending, also used for outputs.
        read: returns the render, shape (3, height, width), [0, 1]; None for a reference without a render.
        camera: camera of the render; None in a folder without cameras.
        read_depth: returns rendered z depth, shape (1, height, width), 0 where nothing was hit.
        read_alpha: returns rendered opacity, shape (1, height, width).
        read_photo: returns the photo of the same view: the ground truth of a target, the pixels of a reference.
        read_fine_photo: returns the photo at 4 times the render's resolution. Any size is allowed for a reference
            without a render.
        fine_size: original height and width of the fine photo, where rounding makes them differ from 4 times the
            render's. Outputs are resized to this size.
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
        references: views with ``read_photo``. Their rendered depth (``read_depth``) allows the occlusion check;
            ``read`` may be None.
        background: colour composited under the renders.
        own_depth: whether the depth is known to fit the renders, since this project's rasteriser made both or the
            depth was validated before.
    """

    name: str
    targets: tuple[RenderedView, ...]
    references: tuple[RenderedView, ...]
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    own_depth: bool = False
