"""A procedural world with baked lighting, which can be rendered from any camera. `baking` makes it from a draft.

Axes: m samples, f faces, k materials, h height, w width.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from gaussian_enhancer.scene.procedural.atlas import Atlas
from gaussian_enhancer.scene.procedural.light import Ambient, Light, Sky
from gaussian_enhancer.scene.procedural.mesh import Mesh


@dataclass(frozen=True)
class MaterialTable:
    """Properties of all materials, one tensor per property.

    The columns of ``looks`` are reflectance, roughness, relief, detail, dirt, emission and translucency, as in
    `draft.Material`.
    """

    texture: Int[Tensor, " k"]
    repeats: Float[Tensor, "k 2"]
    tint: Float[Tensor, "k 3"]
    looks: Float[Tensor, "k 7"]


@dataclass(frozen=True)
class World:
    """Everything that colour and depth depend on.

    `noise` is the index of the noise texture. `exposure` is one factor for all channels or one factor per channel.
    `probe` is the environment map for reflections: latitude-longitude images at increasing levels of blur.
    """

    mesh: Mesh
    atlas: Atlas
    noise: int
    materials: MaterialTable
    sky: Sky
    lights: tuple[Light, ...]
    ambient: Ambient
    ambient_strength: float
    exposure: float | Float[Tensor, "3"]
    haze: float
    background: tuple[float, float, float] | None
    probe: Float[Tensor, "1 3 d h w"] | None = None

    def solid(self, face: Int[Tensor, " m"], u: Float[Tensor, " m"], v: Float[Tensor, " m"]) -> Bool[Tensor, " m"]:
        """Return whether faces are solid at texture coordinates in metres: their texture's opacity is above 0.5."""
        material = self.mesh.material[face]
        uv = torch.stack([u, v], dim=1) * self.materials.repeats[material]
        texture = self.materials.texture[material]
        return self.atlas.read(texture, uv, torch.zeros_like(u))[:, 3] > 0.5
