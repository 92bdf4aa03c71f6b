"""A scene family's output: geometry, textures, materials, lights and a camera path, before light is baked.

Axes: c cameras.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from gaussian_enhancer.scene.procedural.atlas import Texture
from gaussian_enhancer.scene.procedural.mesh import MeshBuilder, SurfacePart

Number = float | int
Vector = tuple[Number, Number, Number]
CameraPath = Callable[[int], tuple[Float[np.ndarray, "c 3"], Float[np.ndarray, "c 3"]]]


@dataclass(frozen=True)
class Material:
    """How a texture is laid on a surface and how the surface answers light.

    Args:
        texture: index of the texture.
        repeats: repeats a metre along u and v.
        tint: factor on the texture's colour.
        reflectance: Fresnel reflectance at normal incidence, [0, 1]; 0.04 is varnish, 0.6 metal.
        roughness: 0 mirrors, 1 spreads.
        relief: how strongly the texture's height turns the normal.
        detail: strength of noise finer than the texture.
        dirt: strength of noise wider than the texture.
        emission: light of its own, in units of white.
        translucency: share of light that comes through from the other side (leaves, cloth).
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
        position: where it stands; a sun stands far away.
        target: what its shadow map looks at.
        radius: radius of the ball around the target that the map covers.
        colour: linear irradiance at the target.
        local: a lamp whose light falls with the squared distance; otherwise a sun.
        side: pixels along the shadow map; fewer make softer shadows.
    """

    position: Vector
    target: Vector
    radius: float
    colour: Vector
    local: bool = False
    side: int = 2048


@dataclass(frozen=True)
class SkySpec:
    """The sky's linear colours and what clouds cover of it; `studio` is soft boxes around an object instead."""

    zenith: Vector
    horizon: Vector
    ground: Vector
    cloud_texture: int
    sun: Vector = (0.0, 0.0, 1.0)
    studio: bool = False


@dataclass
class Draft:
    """A world while it is being written.

    Args:
        rng: the world's source of randomness.
        sky: what lies behind everything.
        lights: what casts shadows.
        path: camera positions and targets for a number of views.
        field_of_view: horizontal, degrees.
        ambient_box: lower and upper corner of the region where ambient occlusion is resolved.
        ambient: factor on the sky's light.
        exposure: factor before tone mapping.
        haze: share of light lost a metre to the air.
        background: colour behind a world that shows no sky; None shows the sky.
        probe: where reflections are taken from.
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
        """Store a texture."""
        self.textures.append(texture)
        return len(self.textures) - 1

    def material(self, texture: int | Texture, size: Number | tuple[Number, Number] = 1.0, **looks: object) -> int:
        """Store a material whose texture repeats every `size` metres (along u and v)."""
        index = texture if isinstance(texture, int) else self.texture(texture)
        u, v = size if isinstance(size, tuple) else (size, size)
        self.materials.append(Material(index, (1 / u, 1 / v), **looks))  # type: ignore[arg-type]
        return len(self.materials) - 1

    def add(self, part: SurfacePart, material: int, *, casts: bool = True) -> None:
        """Put a part into the world."""
        self.builder.add(part, material, casts=casts)

    def pick(self, *choices: object) -> object:
        """One of several."""
        return choices[int(self.rng.integers(len(choices)))]
