"""Display modes of a view: render, enhanced image, both, or a map.

Axes: h height, w width.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.network.pyramid import upsample_bicubic
from gaussian_enhancer.report.figures import absolute_error, apply_colour_map
from gaussian_enhancer.types import usable_depth
from gaussian_enhancer.video.layout import Layout
from gaussian_enhancer.viewer.stage import StageView

MODES = {
    "enhanced": "",
    "render": "",
    "side_by_side": "Render left, enhanced right.",
    "wipe": "Render left of the line, enhanced right of it.",
    "difference": "Change by enhancement: dark: none, light: 0.2 of the colour range or more.",
    "confidence": "Share of the requested references that show a pixel's surface: dark: none, light: all.",
    "depth": "Light: near, dark: far, black: no surface.",
}
"""The modes by name, with the legend of each."""
MAX_DIFFERENCE = 0.2
"""Colour difference that the difference map shows in its lightest colour; larger ones are clamped."""
OUTLIER_SHARE = 0.02
"""Share of the pixels below the depth map's range of inverse depth, and share of those above it."""


@dataclass(frozen=True)
class Mode:
    """A way to show a view.

    Args:
        name: one of `MODES`.
        wipe: for the mode "wipe": share of the width left of the line, in [0, 1].

    Raises:
        InputError: the name is unknown, or the share is out of range.
    """

    name: str = "enhanced"
    wipe: float = 0.5

    def __post_init__(self) -> None:
        if self.name not in MODES:
            raise InputError("show", f"is {self.name!r}", f"choose {', '.join(MODES)}")
        if not 0 <= self.wipe <= 1:
            raise InputError("wipe", f"is {self.wipe}", "give a share of the width from 0 to 1")

    @property
    def legend(self) -> str:
        """Explanation of the picture; empty where none is needed."""
        return MODES[self.name]

    @property
    def enhances(self) -> bool:
        """Whether the network is needed."""
        return self.name not in ("render", "depth")

    @property
    def splits_width(self) -> bool:
        """Whether two views share the picture's width."""
        return self.name == "side_by_side"

    def __call__(self, view: StageView) -> Float[Tensor, "3 _ _"]:
        """Make the picture of a view, in [0, 1].

        Args:
            view: the view, enhanced where the mode needs that.
        """
        if self.name == "depth":
            return apply_colour_map(_nearness(view.depth))
        if self.name == "render" or view.enhanced is None:
            return view.render
        if self.name == "confidence":
            coverage = torch.zeros_like(view.depth) if view.coverage is None else view.coverage
            return apply_colour_map(coverage[0])
        scale = view.enhanced.shape[-1] // view.render.shape[-1]
        render = upsample_bicubic(view.render[None], scale)[0].clamp(0, 1)
        if self.name == "difference":
            return apply_colour_map(absolute_error(view.enhanced, render), MAX_DIFFERENCE)
        return Layout(self.name, self.wipe)(render, view.enhanced, 0.0)


def _nearness(depth: Float[Tensor, "1 h w"]) -> Float[Tensor, "h w"]:
    """Inverse depth scaled to its quantiles, 0.1 (far) to 1 (near); 0 where nothing was hit."""
    has_depth = usable_depth(depth[0])
    if not bool(has_depth.any()):
        return torch.zeros_like(depth[0])
    inverse = torch.where(has_depth, 1 / depth[0].clamp(min=torch.finfo(depth.dtype).tiny), 0.0)
    samples = inverse[has_depth][:: max(1, int(has_depth.sum()) // 20_000)]
    low, high = (float(torch.quantile(samples, share)) for share in (OUTLIER_SHARE, 1 - OUTLIER_SHARE))
    return torch.where(has_depth, 0.1 + 0.9 * (inverse - low) / max(high - low, 1e-12), 0.0)
