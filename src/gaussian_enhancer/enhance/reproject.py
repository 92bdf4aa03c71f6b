"""Bringing a photo of one camera onto the pixel grid of another through rendered depth.

Axes: h height, w width of the target; p height, q width of a reference; m hypotheses of depth.
Coordinates are in pixels with the first pixel's centre at (0.5, 0.5).
"""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.types import Camera

FAINTEST = 1 / 255
IN_FRONT = 1e-6
"""Least z before a reference, as a share of the depth in the target: scenes have no common unit."""


@dataclass(frozen=True)
class Warped:
    """A reference on the target's grid.

    Args:
        colour: the photo's colours, 0 where nothing is visible.
        visibility: how surely the reference shows the target's surface, in [0, 1].
        render: the splat's own render of the reference's view, warped alike; None where unknown.
    """

    colour: Float[Tensor, "3 h w"]
    visibility: Float[Tensor, "1 h w"]
    render: Float[Tensor, "3 h w"] | None = None


def projection(
    target: Camera, reference: Camera, dtype: torch.dtype
) -> tuple[Float[Tensor, "3 h w"], Float[Tensor, "3 1 1"]]:
    """The affine map from a target pixel's depth to homogeneous pixels of the reference.

    A point at depth z on the ray of pixel x lands at K' (z R' R^T K^-1 x + t'), that is at z A(x) + b.

    Args:
        target: camera whose pixels are asked for.
        reference: camera that they are looked up in.
        dtype: of the result; single or double precision, since half cannot address pixels.

    Returns:
        A per pixel, and b.
    """
    K, pose = target.K.to(dtype), target.world_to_camera.to(dtype)
    K_reference, pose_reference = reference.K.to(dtype), reference.world_to_camera.to(dtype)
    y, x = torch.meshgrid(
        torch.arange(target.height, dtype=dtype, device=K.device) + 0.5,
        torch.arange(target.width, dtype=dtype, device=K.device) + 0.5,
        indexing="ij",
    )
    rotation = pose_reference[:3, :3] @ pose[:3, :3].T
    translation = pose_reference[:3, 3] - rotation @ pose[:3, 3]
    rays = torch.stack([x, y, torch.ones_like(x)]).flatten(1)
    slopes = K_reference @ rotation @ torch.linalg.inv(K) @ rays
    return slopes.view(3, target.height, target.width), (K_reference @ translation).view(3, 1, 1)


def fill_depth(depth: Float[Tensor, "1 h w"]) -> Float[Tensor, "1 h w"]:
    """Close the holes of a depth map: each takes the nearest scale's average of its valid neighbours.

    Push and pull over a pyramid (Gortler et al., SIGGRAPH 1996) on inverse depth, so that a hole at the border of
    near and far leans to neither by scale. A map without any valid depth becomes 1 everywhere.

    Args:
        depth: z in scene units; 0, negative and non-finite values are holes.
    """
    valid = torch.isfinite(depth) & (depth > 0)
    if bool(valid.all()):
        return depth
    inverse = torch.where(valid, 1.0 / torch.where(valid, depth, torch.ones_like(depth)), torch.zeros_like(depth))
    levels = [(inverse[None], valid[None].to(depth.dtype))]
    while max(levels[-1][0].shape[-2:]) > 1:
        value, weight = levels[-1]
        total = F.avg_pool2d(weight, 2, ceil_mode=True, count_include_pad=False)
        mean = F.avg_pool2d(value * weight, 2, ceil_mode=True, count_include_pad=False)
        known = total > 0
        levels.append((torch.where(known, mean / total.clamp_min(1e-12), mean), known.to(depth.dtype)))
    filled = torch.where(levels[-1][1] > 0, levels[-1][0], torch.ones_like(levels[-1][0]))
    for value, weight in reversed(levels[:-1]):
        coarse = F.interpolate(filled, size=value.shape[-2:], mode="bilinear", align_corners=False)
        filled = torch.where(weight > 0, value, coarse)
    return torch.where(valid, depth, 1.0 / filled[0])


def look_up(
    image: Float[Tensor, "c p q"], x: Float[Tensor, "m h w"], y: Float[Tensor, "m h w"], mode: str = "bilinear"
) -> Float[Tensor, "m c h w"]:
    """Read an image at pixel positions; outside, the border's colours.

    Args:
        image: what is read.
        x: columns in pixels of the image.
        y: rows in pixels of the image.
        mode: "bilinear" or "nearest".
    """
    count, height, width = x.shape
    rows, columns = image.shape[-2:]
    grid = torch.stack([2 * x / columns - 1, 2 * y / rows - 1], dim=-1).view(1, count * height, width, 2)
    read = F.grid_sample(image[None].to(grid.dtype), grid, mode=mode, padding_mode="border", align_corners=False)
    return read.view(-1, count, height, width).transpose(0, 1)


def reproject(
    target: Camera,
    depth: Float[Tensor, "1 h w"],
    reference: Camera,
    photo: Float[Tensor, "3 p q"],
    reference_depth: Float[Tensor, "1 _ _"] | None = None,
    alpha: Float[Tensor, "1 h w"] | None = None,
    tolerance: float = 0.05,
    rendered_depth: Float[Tensor, "1 h w"] | None = None,
    render: Float[Tensor, "3 _ _"] | None = None,
) -> Warped:
    """Warp a photo backwards into the target view through the target's depth.

    visibility = inside the photo x in front of it x alpha x exp(-((z - z') / (tolerance z))^2 / 2), where z is the
    point's depth in the reference and z' the depth that the reference itself renders there. The photo is first shrunk
    with antialiasing where it is finer than the target.

    Args:
        target: camera of the grid to fill.
        depth: rendered z of the target, scene units; holes are filled from their neighbours for the warp.
        reference: camera of the photo; scaled to the photo's size where the two differ.
        photo: reference colours at any resolution, [0, 1].
        reference_depth: rendered z of the reference at any resolution; None leaves occlusion unchecked.
        alpha: rendered opacity of the target; None counts holes of the depth as invisible.
        tolerance: relative depth difference of one standard deviation, > 0.
        rendered_depth: the target's depth before it was refined, which alone compares with what the reference
            renders; None means ``depth``.
        render: the splat's own render of the reference's view, at any resolution, to be warped alike.
    """
    dtype = depth.dtype if depth.dtype in (torch.float32, torch.float64) else torch.float32
    depth = depth.to(dtype)
    reference = reference.resized(*photo.shape[-2:])
    slopes, offset = projection(target, reference, dtype)
    x, y, _, inside = _landing(slopes, offset, fill_depth(depth), reference)
    visibility = inside.to(dtype)
    if alpha is None:
        visibility = visibility * (torch.isfinite(depth) & (depth > 0))
    else:
        visibility = visibility * alpha.to(dtype).clamp(0, 1)
    if reference_depth is not None:
        checked = fill_depth(depth if rendered_depth is None else rendered_depth.to(dtype))
        u, v, z, _ = _landing(slopes, offset, checked, reference)
        rows, columns = reference_depth.shape[-2:]
        scale = columns / reference.width, rows / reference.height
        seen = look_up(reference_depth, u * scale[0], v * scale[1], "nearest")[:, 0]
        difference = (z - seen) / (tolerance * z.clamp_min(torch.finfo(dtype).tiny))
        visibility = visibility * torch.where(seen > 0, torch.exp(-0.5 * difference**2), 1.0)
    # What 8 bits cannot tell from nothing is nothing; left in, numbers near zero compute tens of times slower.
    visibility = torch.where(visibility < FAINTEST, 0.0, visibility)
    images = []
    for image in (photo,) if render is None else (photo, render):
        scale = image.shape[-1] / reference.width, image.shape[-2] / reference.height
        small, shrink = _shrunk(image.to(dtype), x * scale[0], y * scale[1], inside)
        read = look_up(small, x * scale[0] * shrink[0], y * scale[1] * shrink[1])[0]
        images.append(read * (visibility > 0))
    return Warped(images[0], visibility, images[1] if render is not None else None)


def _landing(
    slopes: Float[Tensor, "3 h w"], offset: Float[Tensor, "3 1 1"], depth: Float[Tensor, "1 h w"], reference: Camera
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Where pixels at a depth land in the reference: columns, rows, z there, and whether inside and in front."""
    homogeneous = depth * slopes + offset
    z = homogeneous[2:]
    in_front = z > IN_FRONT * depth
    x, y = (homogeneous[:2] / torch.where(in_front, z, torch.ones_like(z))).unsqueeze(1)
    inside = (x >= 0) & (x <= reference.width) & (y >= 0) & (y <= reference.height) & in_front
    return x, y, z, inside


def _shrunk(
    photo: Float[Tensor, "3 p q"], x: Float[Tensor, "1 h w"], y: Float[Tensor, "1 h w"], inside: Tensor
) -> tuple[Tensor, tuple[float, float]]:
    """The photo at the resolution at which it is read, and the factors that positions shrink by."""
    if min(x.shape[-2:]) < 2 or not bool(inside.any()):
        return photo, (1.0, 1.0)
    dx = torch.stack([x[..., :-1, 1:] - x[..., :-1, :-1], y[..., :-1, 1:] - y[..., :-1, :-1]])
    dy = torch.stack([x[..., 1:, :-1] - x[..., :-1, :-1], y[..., 1:, :-1] - y[..., :-1, :-1]])
    area = (dx[0] * dy[1] - dx[1] * dy[0]).abs()[inside[..., :-1, :-1]]
    footprint = float(area.median().sqrt()) if area.numel() else 1.0
    if footprint < 1.2:
        return photo, (1.0, 1.0)
    rows, columns = photo.shape[-2:]
    size = (max(1, round(rows / footprint)), max(1, round(columns / footprint)))
    small = F.interpolate(photo[None], size=size, mode="bilinear", antialias=True, align_corners=False)[0]
    return small, (size[1] / columns, size[0] / rows)
