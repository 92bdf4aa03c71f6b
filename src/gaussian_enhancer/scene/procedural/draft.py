"""Draft of a procedural world: geometry, textures, materials, lights and a camera path, before lighting is baked.

Axes: c cameras.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
from jaxtyping import Float

from gaussian_enhancer.scene.procedural.atlas import Texture
from gaussian_enhancer.scene.procedural.mesh import MeshBuilder, SurfacePart
from gaussian_enhancer.scene.procedural.vector import Number, Vector

CameraPath = Callable[[int], tuple[Float[np.ndarray, "c 3"], Float[np.ndarray, "c 3"]]]
"""Returns camera positions and the points that they look at, for a number of cameras."""

T = TypeVar("T")


@dataclass(frozen=True)
class Material:
    """Texture mapping and reflection properties of a surface.

    Args:
        texture: index of the texture.
        repeats: repeats of the texture per metre along u and v.
        tint: factor per channel on the texture's colour.
        reflectance: Fresnel reflectance at normal incidence, [0, 1]; 0.04 is varnish, 0.6 metal.
        roughness: 0 is a mirror, 1 is diffuse.
        relief: strength of bump mapping by the texture's height.
        detail: strength of brightness noise finer than the texture.
        dirt: strength of brightness noise coarser than the texture.
        emission: emitted radiance, as a factor on the albedo.
        translucency: share of light transmitted from the other side (leaves, cloth).
    """

    texture: int
    repeats: tuple[float, float] = (1.0, 1.0)
    tint: Vector = (1.0, 1.0, 1.0)
    reflectance: float = 0.03
    roughness: float = 0.6
    relief: float = 0.02
    detail: float = 0.35
    dirt: float = 0.5
    emission: float = 0.0
    translucency: float = 0.0


@dataclass(frozen=True)
class LightSpec:
    """A light with a shadow map.

    Args:
        position: position of the light, metres; far away for a sun.
        target: point at the centre of its shadow map.
        radius: radius in metres of the ball around the target that the shadow map covers.
        colour: linear irradiance at the target.
        local: True for a lamp, whose light decreases with the squared distance; False for a sun.
        side: side of the shadow map in pixels; fewer pixels make softer shadows.
    """

    position: Vector
    target: Vector
    radius: float
    colour: Vector
    local: bool = False
    side: int = 2048


@dataclass(frozen=True)
class SkySpec:
    """Linear colours of sky and ground, the cloud texture and the sun's direction; `studio` has soft boxes instead."""

    zenith: Vector
    horizon: Vector
    ground: Vector
    cloud_texture: int
    sun: Vector = (0.0, 0.0, 1.0)
    studio: bool = False


@dataclass
class Draft:
    """A world under construction.

    Args:
        rng: the world's random number generator.
        sky: sky, visible where no geometry is hit.
        lights: lights with shadow maps.
        path: returns camera positions and targets for a number of views.
        field_of_view: horizontal field of view, degrees.
        ambient_box: lower and upper corner of the region in which ambient occlusion is computed, metres.
        ambient: factor on ambient light.
        exposure: factor on radiance before tone mapping.
        haze: extinction coefficient of the air, per metre.
        background: sRGB colour of the background; None shows the sky.
        probe: position of the environment map for reflections.
        builder: collects the geometry.
        textures: textures in the order of their indices.
        materials: materials in the order of their indices.
    """

    rng: np.random.Generator
    sky: SkySpec
    path: CameraPath
    field_of_view: float
    ambient_box: tuple[Vector, Vector]
    lights: list[LightSpec] = field(default_factory=list)
    ambient: float = 1.0
    exposure: float = 1.0
    haze: float = 0.0
    background: Vector | None = None
    probe: Vector = (0.0, 0.0, 1.5)
    builder: MeshBuilder = field(default_factory=MeshBuilder)
    textures: list[Texture] = field(default_factory=list)
    materials: list[Material] = field(default_factory=list)

    def texture(self, texture: Texture) -> int:
        """Add a texture and return its index."""
        self.textures.append(texture)
        return len(self.textures) - 1

    def material(self, texture: int | Texture, size: Number | tuple[Number, Number] = 1.0, **looks: object) -> int:
        """Add a material whose texture repeats every `size` metres (along u and v), and return its index."""
        index = texture if isinstance(texture, int) else self.texture(texture)
        u, v = size if isinstance(size, tuple) else (size, size)
        self.materials.append(Material(index, (1 / u, 1 / v), **looks))  # type: ignore[arg-type]
        return len(self.materials) - 1

    def add(self, part: SurfacePart, material: int, *, casts: bool = True) -> None:
        """Add a placed part with a material."""
        self.builder.add(part, material, casts=casts)

    def pick(self, *choices: T) -> T:
        """Choose one of several values at random."""
        return choices[int(self.rng.integers(len(choices)))]
