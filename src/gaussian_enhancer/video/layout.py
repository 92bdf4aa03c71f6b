"""Layout of a video's frames: enhanced view, render, both side by side, or both divided by a line.

Axes: h height, w width.
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.typed import Share, check_fields

LAYOUTS = ("enhanced", "render", "side_by_side", "wipe")
SWEEPS = 2
"""Number of times that the line of a wipe moves from side to side and back in a video."""


@dataclass(frozen=True)
class Layout:
    """How render and enhanced view share a frame.

    Args:
        kind: "enhanced", "render", "side_by_side" (the render on the left) or "wipe" (the render left of a line).
        wipe: share of the width left of the line; None lets the line sweep from side to side.

    Raises:
        InputError: the layout is unknown or the share out of range.
    """

    kind: str = "enhanced"
    wipe: Share | None = 0.5

    def __post_init__(self) -> None:
        if self.kind not in LAYOUTS:
            raise InputError("layout", f"is {self.kind!r}", f"choose {', '.join(LAYOUTS)}")
        check_fields(self, "")

    @property
    def needs_render(self) -> bool:
        """Whether frames show the render."""
        return self.kind != "enhanced"

    def size(self, height: int, width: int) -> tuple[int, int]:
        """Height and width of a frame.

        Args:
            height: height of the enhanced view.
            width: width of the enhanced view.
        """
        return height, 2 * width if self.kind == "side_by_side" else width

    def __call__(
        self, render: Float[Tensor, "3 h w"] | None, enhanced: Float[Tensor, "3 h w"], moment: float
    ) -> Float[Tensor, "3 h _"]:
        """Compose a frame.

        Args:
            render: the render, of the enhanced view's size; None where the layout does not show it.
            enhanced: the enhanced view.
            moment: time of the frame as a share of the duration, in [0, 1).

        Raises:
            InputError: there is no render where the layout shows it.
        """
        if not self.needs_render:
            return enhanced
        if render is None:
            raise InputError(f"layout={self.kind}", "shows the render, which was not made", "render every frame")
        if self.kind == "render":
            return render
        if self.kind == "side_by_side":
            return torch.cat([render, enhanced], dim=-1)
        wipe_share = 0.5 - 0.5 * math.cos(2 * math.pi * SWEEPS * moment) if self.wipe is None else self.wipe
        return _wipe(render, enhanced, round(wipe_share * enhanced.shape[-1]))


def _wipe(render: Float[Tensor, "3 h w"], enhanced: Float[Tensor, "3 h w"], column: int) -> Float[Tensor, "3 h w"]:
    """The render left of a column, the enhanced view right of it, and a white line between them."""
    frame = enhanced.clone()
    frame[..., :column] = render[..., :column]
    half_width = max(1, enhanced.shape[-1] // 640)
    if 0 < column < enhanced.shape[-1]:
        frame[..., max(0, column - half_width) : column + half_width] = 1.0
    return frame
