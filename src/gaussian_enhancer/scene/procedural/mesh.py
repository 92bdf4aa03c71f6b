"""Triangle meshes: parts of surfaces, which are placed and collected into the mesh of a world.

Axes: v vertices, f faces. World axes: x and y along the ground, z up, in metres.
Texture coordinates are in metres on the surface, so that a texture has the same scale on every shape.
"""

from dataclasses import dataclass, field

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from gaussian_enhancer.scene.procedural.vector import Vector
from gaussian_enhancer.types import Movable


@dataclass(frozen=True)
class SurfacePart:
    """A triangle mesh in its own coordinates."""

    positions: Float[np.ndarray, "v 3"]
    normals: Float[np.ndarray, "v 3"]
    uvs: Float[np.ndarray, "v 2"]
    faces: Int[np.ndarray, "f 3"]

    def transform(
        self,
        at: Vector | Float[np.ndarray, " 3"] = (0.0, 0.0, 0.0),
        *,
        yaw: float = 0.0,
        tilt: float = 0.0,
        scale: float = 1.0,
    ) -> "SurfacePart":
        """Return the part scaled, rotated about x by `tilt` and about z by `yaw` (radians), and translated by `at`."""
        c, s, ct, st = np.cos(yaw), np.sin(yaw), np.cos(tilt), np.sin(tilt)
        rotation = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]) @ np.array([[1.0, 0, 0], [0, ct, -st], [0, st, ct]])
        transformed = self.positions * scale @ rotation.T + np.asarray(at, dtype=float)
        return SurfacePart(transformed, self.normals @ rotation.T, self.uvs * scale, self.faces)


def join_parts(parts: list[SurfacePart]) -> SurfacePart:
    """Concatenate several parts to one."""
    starts = np.cumsum([0] + [len(part.positions) for part in parts])
    return SurfacePart(
        np.concatenate([part.positions for part in parts]),
        np.concatenate([part.normals for part in parts]),
        np.concatenate([part.uvs for part in parts]),
        np.concatenate([part.faces + start for part, start in zip(parts, starts[:-1], strict=True)]),
    )


@dataclass(frozen=True)
class Mesh(Movable):
    """All faces of a world as tensors, for the rasteriser and the shader.

    Args:
        corners: world positions of each face's three vertices.
        normals: unit normals of each face's three vertices.
        uvs: texture coordinates of each face's three vertices, metres.
        tangents: unit directions in which u and v increase.
        material: row of each face's material in the material table.
        casts: whether the face casts shadows and occludes ambient light.
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
    """Collects placed parts and their materials."""

    parts: list[SurfacePart] = field(default_factory=list)
    materials: list[int] = field(default_factory=list)
    casts: list[bool] = field(default_factory=list)

    def add(self, part: SurfacePart, material: int, *, casts: bool = True) -> None:
        """Add a placed part."""
        self.parts.append(part)
        self.materials.append(material)
        self.casts.append(casts)

    def build(self, cutout_materials: set[int], device: torch.device) -> Mesh:
        """Build the mesh on a device, without faces of zero area."""
        merged = join_parts(self.parts)
        counts = [len(part.faces) for part in self.parts]
        material = np.repeat(np.array(self.materials), counts)
        casts = np.repeat(np.array(self.casts), counts)
        corners = merged.positions[merged.faces]
        edges = corners[:, 1:] - corners[:, :1]
        has_area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1) > 1e-10
        uvs = merged.uvs[merged.faces]
        tangents = _tangents(edges, uvs[:, 1:] - uvs[:, :1])
        cutout = np.isin(material, sorted(cutout_materials))

        def floats(values: np.ndarray) -> Tensor:
            return torch.from_numpy(np.ascontiguousarray(values[has_area], dtype=np.float32)).to(device)

        return Mesh(
            floats(corners),
            floats(merged.normals[merged.faces]),
            floats(uvs),
            floats(tangents),
            torch.from_numpy(material[has_area]).to(device),
            torch.from_numpy(casts[has_area]).to(device),
            torch.from_numpy(cutout[has_area]).to(device),
        )


def _tangents(edges: np.ndarray, duv: np.ndarray) -> np.ndarray:
    """Normalised dP/du and dP/dv of each face, from two of its edges in space and in texture coordinates."""
    det = duv[:, 0, 0] * duv[:, 1, 1] - duv[:, 0, 1] * duv[:, 1, 0]
    det = np.where(np.abs(det) < 1e-14, 1e-14, det)[:, None]
    along_u = (edges[:, 0] * duv[:, 1, 1:] - edges[:, 1] * duv[:, 0, 1:]) / det
    along_v = (edges[:, 1] * duv[:, 0, :1] - edges[:, 0] * duv[:, 1, :1]) / det
    tangents = np.stack([along_u, along_v], axis=1)
    return tangents / np.maximum(np.linalg.norm(tangents, axis=2, keepdims=True), 1e-12)
