"""Temporal smoothing: the network's change of a frame is averaged with that of the frame before.

Axes: h height, w width.
"""

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.align.alignment import LoadedView
from gaussian_enhancer.align.reproject import reproject
from gaussian_enhancer.errors import InputError

TOLERANCE = 0.02
"""Relative depth difference of one standard deviation that still counts as the same surface."""


@dataclass(frozen=True)
class PreviousChange:
    """The change of the frame before.

    Args:
        change: smoothed change that was added to that frame's render.
        target: that frame's render, with camera and depth.
    """

    change: Float[Tensor, "3 h w"]
    target: LoadedView


def smooth_change(
    image: Float[Tensor, "3 h w"], target: LoadedView, previous: PreviousChange | None, share: float
) -> tuple[Float[Tensor, "3 h w"], PreviousChange]:
    """Average a frame's change with that of the frame before, which is warped through the rendered depth.

    change <- change + share v (warped change - change), where v in [0, 1] is the confidence that both frames show the
    same surface. This is an exponential mean along the path: it prevents a jump where a reference comes or goes. The
    render itself is never averaged, so that parallax stays sharp.

    Args:
        image: the enhanced frame, [0, 1].
        target: its render, with camera and depth.
        previous: the change of the frame before; None at the beginning of a path.
        share: weight of that change, in [0, 1).

    Returns:
        The smoothed frame, and its change for the next frame.

    Raises:
        InputError: the frame has no camera or no depth.
    """
    if target.camera is None or target.depth is None:
        missing = "camera" if target.camera is None else "depth"
        raise InputError(target.name, f"has no {missing} to carry changes by", "give it, or temporal_smoothing=0")
    render = target.image.to(image)
    change = image - render
    if previous is not None and previous.target.camera is not None:
        view_options = previous.target.depth, target.alpha, TOLERANCE
        warped = reproject(
            target.camera, target.depth, previous.target.camera, previous.change.to(target.depth), *view_options
        )
        change = change + share * (warped.visibility * (warped.colour - change.to(warped.colour))).to(change)
    return (render + change).clamp(0, 1), PreviousChange(change, target)
