"""Drawing of splats over views: oriented 2D Gaussians or flat disks, each with its own depth.

Axes: b batch, k splats, h height, w width, r rows of a strip, n selected splats.
"""

import math
from dataclasses import dataclass
from typing import Literal

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int64
from torch import Tensor

from gaussian_enhancer.degrade.artefacts.view import View
from gaussian_enhancer.types import Movable, usable_depth

Profile = Literal["gaussian", "disk"]
"""Opacity as a function of the distance d from the centre in sigmas: exp(-d^2 / 2), or the flat exp(-d^8 / 2)."""

POWERS: dict[Profile, int] = {"gaussian": 2, "disk": 8}
EXTENT = math.sqrt(2 * math.log(255))
"""Distance in sigmas at which a Gaussian is 1/255 and is cut off, as by rasterisers; a disk is cut off at 1/255 too."""

SOFTNESS = 0.02
"""Distance in front of a surface, relative to its depth, from which a splat is drawn with full opacity."""

MIN_WEIGHT = 1e-3
"""Accumulated weight above which a pixel without depth takes the depth of the splats."""

STRIP = 2**18
"""Largest number of values in a temporary tensor: rows are processed in strips, to limit memory."""


@dataclass(frozen=True)
class SplatLayer(Movable):
    """Splats of a batch, equally many per sample; splats of opacity 0 are padding.

    Args:
        centre: x and y in pixels; the first pixel spans 0 to 1.
        log_sigma: natural logarithms of the standard deviations along the two axes, in pixels.
        angle: angle from the x axis (right) to the first axis, towards y (down), in radians.
        opacity: opacity at the centre, in [0, 1].
        colour: sRGB in [0, 1].
        depth: z in scene units, > 0.
    """

    centre: Float[Tensor, "b k 2"]
    log_sigma: Float[Tensor, "b k 2"]
    angle: Float[Tensor, "b k"]
    opacity: Float[Tensor, "b k"]
    colour: Float[Tensor, "b k 3"]
    depth: Float[Tensor, "b k"]

    def select(self, index: Int64[Tensor, "b n"]) -> "SplatLayer":
        """Select splats of each sample by index, in the order of the index."""
        return SplatLayer(
            self.centre.take_along_dim(index[..., None], 1),
            self.log_sigma.take_along_dim(index[..., None], 1),
            self.angle.gather(1, index),
            self.opacity.gather(1, index),
            self.colour.take_along_dim(index[..., None], 1),
            self.depth.gather(1, index),
        )


def falloff(
    splats: SplatLayer, y: Float[Tensor, " r"], x: Float[Tensor, " w"], profile: Profile
) -> Float[Tensor, "b k r w"]:
    """Opacity of each splat relative to its centre, at rows y and columns x in pixels."""
    right = (x - splats.centre[..., :1])[..., None, :]
    down = (y - splats.centre[..., 1:])[..., :, None]
    cosine, sine = (value[..., None, None] for value in (splats.angle.cos(), splats.angle.sin()))
    along, across = (-splats.log_sigma).exp()[..., None, None].unbind(2)
    along_offset = cosine * along * right + sine * along * down
    across_offset = cosine * across * down - sine * across * right
    # The limit gives exp(-20), which is never drawn. It avoids overflow of powers, and slow underflow of exp.
    squared_distance = torch.addcmul(along_offset * along_offset, across_offset, across_offset).clamp(
        max=40 ** (2 / POWERS[profile])
    )
    if profile == "disk":
        squared_distance = squared_distance.square().square()
    return torch.exp(-0.5 * squared_distance)


def composite(view: View, splats: SplatLayer, profile: Profile = "gaussian") -> View:
    """Draw splats over a view, front to back.

    alpha_k = opacity_k g_k s_k, with g_k the `falloff` and s_k = clamp((1 - depth_k / depth) / SOFTNESS, 0, 1) the
    share of the splat that lies in front of the view's surface; s_k = 1 where the view has no depth. With weights
    w_k = alpha_k prod_{l nearer} (1 - alpha_l), their sum W, and T = prod (1 - alpha_k):
    image' = sum w_k colour_k + T image; alpha' = alpha + (1 - alpha) W; depth' is the expected depth, in which a splat
    has the weight w_k and the surface T alpha. A pixel without depth takes the splats' depth where W > `MIN_WEIGHT`.
    Splats of opacity 0 change no value.

    Args:
        view: the view to draw over.
        splats: the splats, in any order.
        profile: opacity profile of all splats.
    """
    height, width = view.image.shape[-2:]
    splats = splats.select(splats.depth.argsort(dim=1, stable=True))
    rows = max(1, STRIP // (len(view) * max(1, splats.depth.shape[1]) * width))
    strips = [_composite_rows(view, splats, top, min(top + rows, height), profile) for top in range(0, height, rows)]

    def join(name: Literal["image", "depth", "alpha"]) -> Tensor:
        return torch.cat([getattr(strip, name) for strip in strips], dim=2)

    return View(
        join("image"),
        None if view.depth is None else join("depth"),
        None if view.alpha is None else join("alpha"),
    )


def _composite_rows(view: View, splats: SplatLayer, top: int, bottom: int, profile: Profile) -> View:
    """Draw sorted splats over the rows of a view from ``top`` to ``bottom``, the latter excluded."""
    depth, alpha = (None if plane is None else plane[:, :, top:bottom] for plane in (view.depth, view.alpha))
    strip = View(view.image[:, :, top:bottom], depth, alpha)
    splats = splats.select(_overlapping(splats, top, bottom, EXTENT ** (2 / POWERS[profile])))
    if splats.depth.shape[1] == 0:
        return strip
    image = view.image
    y = torch.arange(top, bottom, device=image.device, dtype=image.dtype) + 0.5
    x = torch.arange(image.shape[3], device=image.device, dtype=image.dtype) + 0.5
    profiles = F.threshold(falloff(splats, y, x, profile), math.exp(-0.5 * EXTENT**2), 0.0)
    alphas = splats.opacity[..., None, None] * profiles
    if depth is not None:
        inverse = 1 / torch.where(usable_depth(depth), depth, torch.inf)
        alphas = alphas * ((1 - splats.depth[..., None, None] * inverse) / SOFTNESS).clamp(0, 1)
    return _composite(strip, splats, alphas)


def _overlapping(splats: SplatLayer, top: int, bottom: int, reach: float) -> Int64[Tensor, "b n"]:
    """Indices of the splats that overlap rows, in their order; padded by other splats to equal numbers per sample."""
    along, across = splats.log_sigma.exp().unbind(2)
    half_height = reach * torch.hypot(along * splats.angle.sin(), across * splats.angle.cos())
    y = splats.centre[..., 1]
    # Splats of opacity 0 are kept if the opacity requires a gradient.
    present = (splats.opacity > 0) | splats.opacity.requires_grad
    touches = (y + half_height >= top) & (y - half_height <= bottom) & present
    largest_count = int(touches.sum(dim=1).max()) if touches.shape[1] else 0
    selected = touches.logical_not().to(torch.uint8).argsort(dim=1, stable=True)[:, :largest_count]
    return selected.sort(dim=1).values


def _composite(view: View, splats: SplatLayer, alphas: Float[Tensor, "b k h w"]) -> View:
    """Composite sorted splats over a view, given their alpha at every pixel."""
    transmittance = torch.ones_like(alphas[:, 0])
    weights = []
    for layer in alphas.unbind(1):
        weights.append(layer * transmittance)
        transmittance = transmittance - weights[-1]
    values = torch.cat([splats.colour, splats.depth[..., None], torch.ones_like(splats.colour[..., :1])], dim=2)
    with torch.autocast(alphas.device.type, enabled=False):
        sums = values.transpose(1, 2) @ torch.stack(weights, dim=1).flatten(2)
    colour, weighted_depth, weight = sums.unflatten(2, alphas.shape[2:]).split((3, 1, 1), dim=1)
    transmittance = transmittance[:, None]
    image = transmittance * view.image + colour
    alpha = None if view.alpha is None else view.alpha + (1 - view.alpha) * weight
    return View(image, _expected_depth(view, weighted_depth, weight, transmittance), alpha)


def _expected_depth(
    view: View,
    weighted_depth: Float[Tensor, "b 1 h w"],
    weight: Float[Tensor, "b 1 h w"],
    transmittance: Float[Tensor, "b 1 h w"],
) -> Float[Tensor, "b 1 h w"] | None:
    """Expected depth, computed as a change of the view's depth, so that it is exactly unchanged for zero weight.

    Args:
        view: the view under the splats.
        weighted_depth: sum of the splats' depths, weighted by w_k of `composite`.
        weight: sum W of these weights.
        transmittance: T of `composite`.
    """
    if view.depth is None:
        return None
    known_depth = usable_depth(view.depth)
    surface_depth = torch.where(known_depth, view.depth, 0)
    surface_alpha = known_depth.to(surface_depth.dtype) if view.alpha is None else view.alpha * known_depth
    total = (weight + transmittance * surface_alpha).clamp_min(1e-12)
    mean_depth = surface_depth + (weighted_depth - surface_depth * weight) / total
    return torch.where(known_depth | (weight > MIN_WEIGHT), mean_depth, view.depth)


def depth_quantile(view: View, share: float = 0.5) -> Float[Tensor, "b 1"]:
    """Quantile of each view's known depths, estimated from at most 64 x 64 pixels; 1 without any."""
    if view.depth is None:
        return view.image.new_ones(len(view), 1)
    height, width = view.depth.shape[-2:]
    sampled_depth = view.depth.detach()[..., :: math.ceil(height / 64), :: math.ceil(width / 64)].flatten(1)
    level = torch.where(usable_depth(sampled_depth), sampled_depth, torch.nan).nanquantile(share, dim=1, keepdim=True)
    return torch.nan_to_num(level, nan=1.0)


def colour_at(view: View, centre: Float[Tensor, "b k 2"]) -> Float[Tensor, "b k 3"]:
    """Colours of the pixels that contain points given in pixels; points outside take the nearest pixel."""
    pixels = _pixel(view, centre)[:, None].expand(-1, 3, -1)
    return view.image.flatten(2).gather(2, pixels).transpose(1, 2)


def depth_at(view: View, centre: Float[Tensor, "b k 2"]) -> Float[Tensor, "b k"]:
    """Depths of the pixels that contain points given in pixels; the view's median where depth is unknown."""
    median = depth_quantile(view)
    if view.depth is None:
        return median.expand(centre.shape[:2])
    depths = view.depth.flatten(1).gather(1, _pixel(view, centre))
    return torch.where(usable_depth(depths), depths, median)


def _pixel(view: View, centre: Float[Tensor, "b k 2"]) -> Int64[Tensor, "b k"]:
    height, width = view.image.shape[-2:]
    x, y = centre.detach().floor().long().unbind(2)
    return y.clamp(0, height - 1) * width + x.clamp(0, width - 1)


def covered_colour(view: View, splats: SplatLayer, profile: Profile) -> Float[Tensor, "b k 3"]:
    """Mean colour that each splat covers, from at most 16 x 16 cells; the image's mean if it covers nearly nothing."""
    height, width = view.image.shape[-2:]
    coarse = F.adaptive_avg_pool2d(view.image, (min(height, 16), min(width, 16)))
    rows, columns = coarse.shape[-2:]
    y = (torch.arange(rows, device=coarse.device, dtype=coarse.dtype) + 0.5) * (height / rows)
    x = (torch.arange(columns, device=coarse.device, dtype=coarse.dtype) + 0.5) * (width / columns)
    weights = falloff(splats, y, x, profile).flatten(2) + 1e-4
    means = coarse.flatten(2) @ (weights / weights.sum(dim=2, keepdim=True)).transpose(1, 2)
    return means.transpose(1, 2)
