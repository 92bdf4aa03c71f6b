"""The residual network of IBGS.

Axes: b batch, m source views, c channels, h height, w width.
"""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor, nn

from ablations.ibgs.sources import CAMERA_FEATURES, Sources
from gaussian_enhancer.types import Movable

DOWN = 4
"""Downscaling of the hourglass's coarsest features."""


@dataclass(frozen=True)
class ResidualInput(Movable):
    """Input of the network for a batch of targets; see `Sources`.

    Args:
        render: base colours.
        colours: of the source photos.
        cameras: camera features of the sources.
        visible: where the sources are used.
        rays: viewing directions of the targets.
    """

    render: Float[Tensor, "b 3 h w"]
    colours: Float[Tensor, "b m 3 h w"]
    cameras: Float[Tensor, "b m 4 h w"]
    visible: Bool[Tensor, "b m 1 h w"]
    rays: Float[Tensor, "b 3 h w"]

    @classmethod
    def of(cls, render: Float[Tensor, "3 h w"], sources: Sources, per_pixel: int) -> "ResidualInput":
        """A batch of one. Each pixel lists the sources that are used there, in their order, padded with empty ones.

        Args:
            render: of the target.
            sources: of the target.
            per_pixel: sources that are used at a pixel at most (`SourceChoice.visible`).
        """
        lacking = max(0, per_pixel - len(sources.names))
        filled = [F.pad(image, (0, 0) * 3 + (0, lacking)) for image in (sources.colours, sources.cameras)]
        visible = F.pad(sources.visible, (0, 0) * 3 + (0, lacking))
        order = visible.to(torch.uint8).argsort(dim=0, descending=True, stable=True)[:per_pixel]
        colours, cameras, counted = (
            image.gather(0, order.expand(-1, image.shape[1], -1, -1))[None] for image in (*filled, visible)
        )
        return cls(render[None], colours, cameras, counted, sources.rays[None])


class IBGSResidual(nn.Module):
    """Residual = hourglass(base colour, ray, pooled MLP(photo - render, camera features)).

    The MLP is applied to each source view of each pixel; its features are pooled over the visible ones by mean,
    variance and maximum. At initialisation, the residual is 0. We chose the sizes such that the network has about the
    published 66,000 parameters.
    """

    def __init__(self) -> None:
        super().__init__()
        features = 32  # of the MLP
        full, half, quarter = 16, 32, 32  # channels of the hourglass by resolution
        self.encode = nn.Sequential(
            nn.Conv2d(3 + CAMERA_FEATURES, features, 1),
            nn.ReLU(),
            nn.Conv2d(features, features, 1),
            nn.ReLU(),
        )
        self.enter = nn.Conv2d(3 * features + 6, full, 3, padding=1)
        self.shrink = nn.ModuleList([nn.Conv2d(full, half, 3, 2, 1), nn.Conv2d(half, quarter, 3, 2, 1)])
        self.middle = nn.Conv2d(quarter, quarter, 3, padding=1)
        self.grow = nn.ModuleList(
            [nn.Conv2d(quarter + half, half, 3, padding=1), nn.Conv2d(half + full, full, 3, padding=1)]
        )
        self.head = nn.Conv2d(full, 3, 3, padding=1)
        nn.init.zeros_(self.head.weight)
        nn.init.zeros_(self.head.bias)  # type: ignore[arg-type]

    def forward(self, inputs: ResidualInput) -> Float[Tensor, "b 3 h w"]:
        """What is added to the render."""
        height, width = inputs.render.shape[-2:]
        render_and_rays = torch.cat([inputs.render - 0.5, inputs.rays], dim=1)
        x = torch.cat([render_and_rays, self.pooled(inputs)], dim=1)
        x = F.pad(x, (0, -width % DOWN, 0, -height % DOWN), mode="replicate")
        skips = [torch.relu(self.enter(x))]
        for shrink in self.shrink:
            skips.append(torch.relu(shrink(skips[-1])))
        x = torch.relu(self.middle(skips.pop()))
        for grow, skip in zip(self.grow, reversed(skips), strict=True):
            x = torch.relu(grow(torch.cat([F.interpolate(x, scale_factor=2.0), skip], dim=1)))
        residual: Tensor = self.head(x)[..., :height, :width]
        return residual.to(inputs.render.dtype)

    def pooled(self, inputs: ResidualInput) -> Float[Tensor, "b c h w"]:
        """Mean, variance and maximum of the visible sources' features; 0 where none is visible."""
        if inputs.colours.shape[1] == 0:
            batch, _, height, width = inputs.render.shape
            return inputs.render.new_zeros(batch, self.enter.in_channels - 6, height, width)
        visible = inputs.visible.to(inputs.render.dtype)
        errors = (inputs.colours - inputs.render[:, None]) * visible
        source_features = torch.cat([errors, inputs.cameras], dim=2)
        features = self.encode(source_features.flatten(0, 1)).unflatten(0, source_features.shape[:2]) * visible
        count = visible.sum(1).clamp_min(1)
        mean = features.sum(1) / count
        variance = ((features - mean[:, None]).square() * visible).sum(1) / count
        return torch.cat([mean, variance, features.amax(1)], dim=1)  # features are at least 0
