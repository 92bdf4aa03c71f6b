"""Triangle meshes: parts that are shaped, placed and gathered into one world.

Axes: v vertices, f faces. World axes: x and y along the ground, z up, in metres.
Texture coordinates are metres on the surface too, so that a texture keeps its scale on every shape.
"""

from dataclasses import dataclass, field

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from gaussian_enhancer.types import Movable

Vector = tuple[float | int, float | int, float | int]


@dataclass(frozen=True)
class SurfacePart:
    """A piece of surface, before it is placed."""

    positions: Float[np.ndarray, "v 3"]
    normals: Float[np.ndarray, "v 3"]
    uvs: Float[np.ndarray, "v 2"]
    faces: Int[np.ndarray, "f 3"]

    def placed(
        self,
        at: Vector | Float[np.ndarray, " 3"] = (0.0, 0.0, 0.0),
        *,
        yaw: float = 0.0,
        tilt: float = 0.0,
        scale: float = 1.0,
    ) -> "SurfacePart":
        """The part scaled, tilted about x, turned about z (radians) and moved."""
        c, s, ct, st = np.cos(yaw), np.sin(yaw), np.cos(tilt), np.sin(tilt)
        turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]) @ np.array([[1.0, 0, 0], [0, ct, -st], [0, st, ct]])
        transformed = self.positions * scale @ turn.T + np.asarray(at, dtype=float)
        return SurfacePart(transformed, self.normals @ turn.T, self.uvs * scale, self.faces)


def joined(parts: list[SurfacePart]) -> SurfacePart:
    """Several parts as one."""
    starts = np.cumsum([0] + [len(part.positions) for part in parts])
    return SurfacePart(
        np.concatenate([part.positions for part in parts]),
        np.concatenate([part.normals for part in parts]),
        np.concatenate([part.uvs for part in parts]),
        np.concatenate([part.faces + start for part, start in zip(parts, starts[:-1], strict=True)]),
    )


@dataclass(frozen=True)
class Mesh(Movable):
    """All faces of a world, as the rasteriser and the shader read them.

    Args:
        corners: world positions of each face's three vertices.
        normals: unit normals of each face's three vertices.
        uvs: texture coordinates of each face's three vertices, metres.
        tangents: unit directions in which u and v grow.
        material: row of the material table.
        casts: whether the face throws shadows and occludes ambient light.
        cutout: whether the material's texture has holes.
    """

    corners: Float[Tensor, "f 3 3"]
    normals: Float[Tensor, "f 3 3"]
    uvs: Float[Tensor, "f 3 2"]
    tangents: Float[Tensor, "f 2 3"]
    material: Int[Tensor, " f"]
    casts: Bool[Tensor, " f"]
    cutout: Bool[Tensor, " f"]


@dataclass
class MeshBuilder:
    """Collects placed parts with their materials."""

    parts: list[SurfacePart] = field(default_factory=list)
    materials: list[int] = field(default_factory=list)
    casts: list[bool] = field(default_factory=list)

    def add(self, part: SurfacePart, material: int, *, casts: bool = True) -> None:
        """Put a part into the world."""
        self.parts.append(part)
        self.materials.append(material)
        self.casts.append(casts)

    def build(self, cutout_materials: set[int], device: torch.device) -> Mesh:
        """The mesh on a device, without faces that have no area."""
        whole = joined(self.parts)
        counts = [len(part.faces) for part in self.parts]
        material = np.repeat(np.array(self.materials), counts)
        casts = np.repeat(np.array(self.casts), counts)
        corners = whole.positions[whole.faces]
        edges = corners[:, 1:] - corners[:, :1]
        solid = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1) > 1e-10
        uvs = whole.uvs[whole.faces]
        tangents = _tangents(edges, uvs[:, 1:] - uvs[:, :1])
        cutout = np.isin(material, sorted(cutout_materials))

        def floats(values: np.ndarray) -> Tensor:
            return torch.from_numpy(np.ascontiguousarray(values[solid], dtype=np.float32)).to(device)

        return Mesh(
            floats(corners),
            floats(whole.normals[whole.faces]),
            floats(uvs),
            floats(tangents),
            torch.from_numpy(material[solid]).to(device),
            torch.from_numpy(casts[solid]).to(device),
            torch.from_numpy(cutout[solid]).to(device),
        )


def _tangents(edges: np.ndarray, duv: np.ndarray) -> np.ndarray:
    """Unit dP/du and dP/dv of each face, from its two edges in space and in texture."""
    det = duv[:, 0, 0] * duv[:, 1, 1] - duv[:, 0, 1] * duv[:, 1, 0]
    det = np.where(np.abs(det) < 1e-14, 1e-14, det)[:, None]
    along_u = (edges[:, 0] * duv[:, 1, 1:] - edges[:, 1] * duv[:, 0, 1:]) / det
    along_v = (edges[:, 1] * duv[:, 0, :1] - edges[:, 0] * duv[:, 1, :1]) / det
    both = np.stack([along_u, along_v], axis=1)
    return both / np.maximum(np.linalg.norm(both, axis=2, keepdims=True), 1e-12)
