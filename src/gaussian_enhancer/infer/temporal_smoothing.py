"""Frames of a path made steadier: what the network changes is carried over from frame to frame.

Axes: h height, w width.
"""

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.align.alignment import Pixels
from gaussian_enhancer.align.reproject import reproject
from gaussian_enhancer.errors import InputError

TOLERANCE = 0.02
"""Relative depth difference of one standard deviation that still counts as the same surface."""


@dataclass(frozen=True)
class PreviousChange:
    """What is handed on from one frame to the next.

    Args:
        change: what was added to the frame's render.
        target: the frame, with camera and depth.
    """

    change: Float[Tensor, "3 h w"]
    target: Pixels


def smoothed_over_time(
    image: Float[Tensor, "3 h w"], target: Pixels, before: PreviousChange | None, share: float
) -> tuple[Float[Tensor, "3 h w"], PreviousChange]:
    """A frame whose change is mixed with that of the frame before, warped onto it through the rendered depth.

    change <- change + share v (warped change - change), where v is how surely both frames show the same surface: an
    exponential mean along the path, which a reference that comes or goes cannot jump through. The render itself, and
    with it all that moves by parallax, is never mixed.

    Args:
        image: the enhanced frame, [0, 1].
        target: its render, with camera and depth.
        before: of the frame before; None at the beginning of a path.
        share: of the change before, in [0, 1).

    Raises:
        InputError: the frame has no camera or no depth.
    """
    if target.camera is None or target.depth is None:
        lacking = "camera" if target.camera is None else "depth"
        raise InputError(target.name, f"has no {lacking} to carry changes by", "give it, or temporal_smoothing=0")
    render = target.image.to(image)
    change = image - render
    if before is not None and before.target.camera is not None:
        how = before.target.depth, target.alpha, TOLERANCE
        old = reproject(target.camera, target.depth, before.target.camera, before.change.to(target.depth), *how)
        change = change + share * (old.visibility * (old.colour - change.to(old.colour))).to(change)
    return (render + change).clamp(0, 1), PreviousChange(change, target)
