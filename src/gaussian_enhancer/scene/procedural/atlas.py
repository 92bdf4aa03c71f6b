"""Texture atlas: all mip levels of all textures in one flat table, sampled with trilinear filtering.

Channels: red, green, blue (sRGB), opacity, slope along u, slope along v, gloss, height.
Axes: t texture side, m samples, n texels, k textures, l mip levels.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from torch import Tensor

from gaussian_enhancer.types import Movable

CHANNELS = 8
SLOPE_RANGE = 40.0


@dataclass(frozen=True)
class Texture:
    """A square, seamlessly repeating texture; its side is a power of two.

    Args:
        colour: sRGB in [0, 1].
        height: height map in [0, 1]; larger is higher.
        gloss: factor on the material's Fresnel reflectance, [0, 1].
        opacity: opacity in [0, 1]; 0 is a hole.
    """

    colour: Float[np.ndarray, "t t 3"]
    height: Float[np.ndarray, "t t"]
    gloss: Float[np.ndarray, "t t"]
    opacity: Float[np.ndarray, "t t"]


@dataclass(frozen=True)
class Atlas(Movable):
    """All textures of a world with their mip levels.

    Args:
        texels: 8-bit channels of every texel of every mip level.
        starts: index of the first texel of each (texture, mip level).
        sides: side of each texture at full size, in texels.
    """

    texels: UInt8[Tensor, "n 8"]
    starts: Int[Tensor, "k l"]
    sides: Int[Tensor, " k"]

    def read(
        self, texture: Int[Tensor, " m"], uv: Float[Tensor, "m 2"], footprint: Float[Tensor, " m"]
    ) -> Float[Tensor, "m 8"]:
        """Sample the channels at texture coordinates (1 is one repeat), averaged over about `footprint` of a repeat."""
        side = self.sides[texture]
        level = torch.log2((footprint * side).clamp_min(1e-6)).clamp_min(0.0)
        level = torch.minimum(level, torch.log2(side.float()))
        lower = level.floor()
        blend = (level - lower)[:, None]
        lower = lower.long()
        upper = torch.minimum(lower + 1, torch.log2(side.float()).long())
        lower_value = self._bilinear(texture, uv, lower, side)
        return lower_value + blend * (self._bilinear(texture, uv, upper, side) - lower_value)

    def _bilinear(self, texture: Tensor, uv: Tensor, level: Tensor, side: Tensor) -> Tensor:
        size = side >> level
        start = self.starts.view(-1)[texture * self.starts.shape[1] + level]
        position = (uv - uv.floor()) * size[:, None] - 0.5
        corner = position.floor()
        u, v = (position - corner).unbind(1)
        mask = size - 1
        x0, y0 = corner.long().unbind(1)
        x0, x1, y0, y1 = x0 & mask, (x0 + 1) & mask, (y0 & mask) * size, ((y0 + 1) & mask) * size
        result = torch.zeros(len(uv), CHANNELS, device=uv.device)
        for offset, weight in (
            (y0 + x0, (1 - u) * (1 - v)),
            (y0 + x1, u * (1 - v)),
            (y1 + x0, (1 - u) * v),
            (y1 + x1, u * v),
        ):
            texel = self.texels.index_select(0, start + offset)
            result.addcmul_(texel.float(), (weight * (1 / 255.0))[:, None])
        return result


def bake(textures: list[Texture], device: torch.device) -> Atlas:
    """Build the atlas: quantise textures, compute mip levels down to one texel, and concatenate all in one table."""
    levels = max(int(np.log2(len(texture.height))) for texture in textures) + 1
    starts = torch.zeros(len(textures), levels, dtype=torch.int64)
    pieces: list[np.ndarray] = []
    start = 0
    for k, texture in enumerate(textures):
        image = _channels(texture)
        for level in range(int(np.log2(len(texture.height))) + 1):
            starts[k, level] = start
            pieces.append(np.round(image * 255).astype(np.uint8).reshape(-1, CHANNELS))
            start += len(pieces[-1])
            if len(image) > 1:
                image = 0.25 * (image[::2, ::2] + image[1::2, ::2] + image[::2, 1::2] + image[1::2, 1::2])
    sides = torch.tensor([len(texture.height) for texture in textures])
    texels = torch.from_numpy(np.concatenate(pieces))
    return Atlas(texels.to(device), starts.to(device), sides.to(device))


def _channels(texture: Texture) -> np.ndarray:
    """The texture's eight channels in [0, 1]; slopes are clipped to +-`SLOPE_RANGE` and mapped to [0, 1]."""
    height = texture.height
    side = len(height)
    slopes = [(np.roll(height, -1, axis) - np.roll(height, 1, axis)) * side / 2 for axis in (1, 0)]
    encoded = [np.clip(slope / SLOPE_RANGE, -1, 1) * 0.5 + 0.5 for slope in slopes]
    layers = [*np.moveaxis(texture.colour, 2, 0), texture.opacity, *encoded, texture.gloss, height]
    return np.clip(np.stack(layers, axis=2), 0, 1).astype(np.float32)
