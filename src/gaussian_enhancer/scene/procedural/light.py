"""Lighting: shadow maps and a volume of ambient light, both baked once per world, and the sky.

Axes: m points or directions, s shadow map side, d h w voxels.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from gaussian_enhancer.scene.procedural.atlas import Atlas
from gaussian_enhancer.scene.procedural.draft import LightSpec, SkySpec
from gaussian_enhancer.scene.procedural.mesh import Mesh
from gaussian_enhancer.scene.procedural.raster import (
    KeepSamples,
    SampleGrid,
    barycentric,
    nearest_faces,
    project,
    sample_positions,
)
from gaussian_enhancer.scene.procedural.vector import Vector, dot, interpolate_corners
from gaussian_enhancer.types import Camera

_SH0, _SH1 = 0.28209479, 0.48860251
_FAR = 60.0
"""Distance of the cameras of `bake_ambient` from the volume's centre, in radii of the volume."""
_VOXELS = 56
"""Voxels of ambient light along the longest side of the volume."""
_DIRECTIONS = 40
"""Directions of ambient light, distributed evenly over the sphere."""
_MAP_SIDE = 128
"""Side in pixels of the depth map from each of these directions."""


def look_at(eye: Float[Tensor, " 3"], target: Float[Tensor, " 3"], focal: float, height: int, width: int) -> Camera:
    """Make a camera at `eye` that looks at `target`, with the world's z axis upwards."""
    forward = functional.normalize(target.double() - eye.double(), dim=0)
    up = torch.tensor([0.0, 0.0, 1.0] if abs(float(forward[2])) < 0.999 else [0.0, 1.0, 0.0], dtype=torch.float64)
    right = functional.normalize(torch.linalg.cross(forward, up), dim=0)
    rotation = torch.stack([right, torch.linalg.cross(forward, right), forward])
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3], pose[:3, 3] = rotation, -rotation @ eye.double()
    K = torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
    return Camera(K, pose.float(), height, width)


def inverse_depth(mesh: Mesh, camera: Camera, keep: KeepSamples, *, casting: bool = False) -> Float[Tensor, "h w"]:
    """Render 1/z at pixel centres, 0 where nothing is hit; `casting` leaves out faces that cast no shadow."""
    face_indices = mesh.casts.nonzero()[:, 0] if casting else torch.arange(len(mesh.casts), device=mesh.casts.device)
    projected = project(mesh.corners[face_indices], camera)
    grid = SampleGrid()

    def solid(face: Tensor, x: Tensor, y: Tensor) -> Tensor:
        uv = interpolate_corners(barycentric(projected.edges[face], x, y)[0], mesh.uvs[face_indices[face]])
        return keep(face_indices[face], uv[:, 0], uv[:, 1])

    face = nearest_faces(projected, grid, camera.width, 0, camera.height, mesh.cutout[face_indices], solid)
    x, y = sample_positions(grid, camera.width, 0, camera.height, face.device)
    _, z = barycentric(projected.edges[face.clamp_min(0)], x, y)
    return torch.where(face >= 0, 1 / z, torch.zeros_like(z)).view(camera.height, camera.width)


@dataclass(frozen=True)
class Light:
    """A light with its baked shadow map."""

    spec: LightSpec
    camera: Camera
    shadow: Float[Tensor, "s s"]

    def incident_light(
        self, points: Float[Tensor, "m 3"], normals: Float[Tensor, "m 3"]
    ) -> tuple[Float[Tensor, "m 3"], Float[Tensor, "m 3"], Float[Tensor, " m"]]:
        """Direction to the light, its colour at each point, and the share of it that is not in shadow."""
        position = points.new_tensor(self.spec.position)
        to_light = position - points
        distance = dot(to_light, to_light).sqrt()[:, None]
        to_light = to_light / distance
        colour = points.new_tensor(self.spec.colour).expand_as(points)
        if self.spec.local:
            reference_distance = (position - points.new_tensor(self.spec.target)).norm()
            colour = colour * (reference_distance / distance.clamp_min(0.15)) ** 2
        texel_size = distance / float(self.camera.K[0, 0])
        return to_light, colour, self._lit_share(points + (1.5 * texel_size) * normals)

    def _lit_share(self, points: Tensor) -> Tensor:
        """Lit share of a neighbourhood of 3 x 3 texels: percentage-closer filtering, bilinear, of 4 x 4 comparisons."""
        homogeneous = _homogeneous_pixels(points, self.camera)
        z = homogeneous[:, 2].clamp_min(1e-3)
        position = (homogeneous[:, :2] / z[:, None]).float() - 0.5
        depth_bias = 0.004 * self.spec.radius if not self.spec.local else 0.02
        point_inverse_depth = (1 / (z - depth_bias).clamp_min(1e-3)).float()
        corner = position.floor()
        u, v = (position - corner).unbind(1)
        x, y = corner.long().unbind(1)
        side = self.shadow.shape[0]
        inside = (homogeneous[:, 2] > 1e-3) & (x >= 1) & (y >= 1) & (x < side - 2) & (y < side - 2)
        x, y = x.clamp(1, side - 3), y.clamp(1, side - 3)
        flat_shadow, lit_sum = self.shadow.view(-1), torch.zeros_like(u)
        weights_x, weights_y = (1 - u, 1, 1, u), (1 - v, 1, 1, v)
        for j in range(4):
            for i in range(4):
                unoccluded = flat_shadow[(y + j - 1) * side + x + (i - 1)] <= point_inverse_depth
                lit_sum = lit_sum + unoccluded * (weights_x[i] * weights_y[j] / 9)
        return torch.where(inside, lit_sum, torch.ones_like(lit_sum))


def bake_light(spec: LightSpec, mesh: Mesh, keep: KeepSamples) -> Light:
    """Render a light's shadow map."""
    eye, target = torch.tensor(spec.position), torch.tensor(spec.target)
    distance = float((eye - target).norm())
    camera = look_at(eye, target, 0.5 * spec.side * distance / spec.radius, spec.side, spec.side)
    return Light(spec, camera, inverse_depth(mesh, camera, keep, casting=True))


@dataclass(frozen=True)
class Sky:
    """Radiance of the sky, for rays that hit no geometry."""

    spec: SkySpec

    def radiance(
        self, directions: Float[Tensor, "m 3"], atlas: Atlas, footprint: float, *, sharp: bool = True
    ) -> Float[Tensor, "m 3"]:
        """Linear radiance from directions.

        Args:
            directions: unit vectors from the viewer outwards.
            atlas: atlas with the cloud texture.
            footprint: angular size of a sample, radians.
            sharp: whether clouds are included.
        """

        def colour(values: Vector) -> Tensor:
            return directions.new_tensor(values)

        up = directions[:, 2:3]
        result = torch.lerp(colour(self.spec.horizon), colour(self.spec.zenith), up.clamp_min(0) ** 0.55)
        if self.spec.studio:
            # Three soft boxes, which glossy objects reflect.
            angle = torch.atan2(directions[:, 1:2], directions[:, 0:1])
            for centre, half_angle, strength in ((0.6, 0.45, 2.2), (2.9, 0.6, 1.1), (-1.6, 0.3, 1.6)):
                box_profile = (
                    torch.cos(angle - centre) - torch.cos(colour((half_angle, half_angle, half_angle))[:1])
                ).clamp_min(0) * 8
                result = result + strength * box_profile.clamp_max(1) * ((up > 0.15) & (up < 0.75))
        else:
            sun_cosine = (directions * functional.normalize(colour(self.spec.sun), dim=0)).sum(1, keepdim=True)
            glow = 0.35 * sun_cosine.clamp_min(0) ** 24 + 0.2 * sun_cosine.clamp_min(0) ** 4
            result = result * (1 + glow)
            if sharp:
                plane_position = directions[:, :2] / (up.clamp_min(0) + 0.12)
                texture = torch.full((len(directions),), self.spec.cloud_texture, device=directions.device)
                cloud_footprint = footprint / (up.clamp_min(0) + 0.12)[:, 0] ** 1.5 * 0.35
                cloud = atlas.read(texture, plane_position * 0.35, cloud_footprint)
                cloud_cover = cloud[:, 3:4] * (up * 6).clamp(0, 1)
                cloud_colour = cloud[:, :3] * (
                    0.35 * result.mean(1, keepdim=True) + 0.75 * result.amax(1, keepdim=True)
                )
                result = torch.lerp(result, cloud_colour * 1.3, cloud_cover)
        ground_share = (-up * 5).clamp(0, 1)
        return torch.lerp(result, colour(self.spec.ground).expand_as(result), ground_share)


@dataclass(frozen=True)
class Ambient:
    """Incident light of sky and ground with occlusion, as spherical harmonics up to degree 1 in a voxel volume.

    Irradiance is computed as by Ramamoorthi and Hanrahan (SIGGRAPH 2001), truncated after the linear terms.
    """

    volume: Float[Tensor, "1 12 d h w"]
    lower: Float[Tensor, " 3"]
    upper: Float[Tensor, " 3"]

    def irradiance(self, points: Float[Tensor, "m 3"], normals: Float[Tensor, "m 3"]) -> Float[Tensor, "m 3"]:
        """Irradiance, divided by pi, on surfaces with these normals."""
        extent = self.upper - self.lower
        voxel = extent / extent.new_tensor(self.volume.shape[:1:-1])
        position = (points + 0.8 * voxel * normals - self.lower) / extent * 2 - 1
        sampled = functional.grid_sample(
            self.volume, position.view(1, 1, 1, -1, 3), padding_mode="border", align_corners=False
        )
        coefficients = sampled.view(4, 3, -1)
        result = _SH0 * coefficients[0] + (2 / 3) * _SH1 * (normals.T[:, None] * coefficients[1:]).sum(0)
        return result.T.clamp_min(0.005)


def bake_ambient(
    mesh: Mesh,
    keep: KeepSamples,
    sky: Sky,
    atlas: Atlas,
    corners: tuple[Vector, Vector],
) -> Ambient:
    """Bake ambient light: sum the unoccluded light from `_DIRECTIONS` directions in every voxel.

    Args:
        mesh: faces of the world.
        keep: returns whether faces with holes are solid at texture coordinates in metres.
        sky: source of the light.
        atlas: atlas of the world's textures.
        corners: lower and upper corner of the volume, metres.
    """
    device = mesh.corners.device
    lower, upper = (torch.tensor(corner, device=device) for corner in corners)
    extent = upper - lower
    counts = (extent / extent.max() * _VOXELS).ceil().long().clamp_min(8).tolist()
    axes = [
        (torch.arange(n, device=device) + 0.5) / n * float(e) + float(o)
        for n, e, o in zip(counts, extent, lower, strict=True)
    ]
    z, y, x = torch.meshgrid(axes[2], axes[1], axes[0], indexing="ij")
    points = torch.stack([x, y, z], dim=-1).view(-1, 3)
    centre, radius = (lower + upper).cpu() / 2, float(extent.norm()) / 2
    index = torch.arange(_DIRECTIONS, dtype=torch.float64) + 0.5
    heights, azimuths = 1 - 2 * index / _DIRECTIONS, torch.pi * (1 + 5**0.5) * index
    ring_radii = (1 - heights**2).sqrt()
    unit_directions = torch.stack([ring_radii * azimuths.cos(), ring_radii * azimuths.sin(), heights], dim=1).float()
    volume = torch.zeros(len(points), 4, 3, device=device)
    for direction in unit_directions:
        camera = look_at(centre + direction * radius * _FAR, centre, 0.5 * _MAP_SIDE * _FAR, _MAP_SIDE, _MAP_SIDE)
        shadow = inverse_depth(mesh, camera, keep, casting=True)
        lit = _visible(points, camera, shadow, radius * 2.0 / _MAP_SIDE)
        ray = direction.to(device)
        radiance = sky.radiance(ray[None], atlas, 0.1, sharp=False) * (4 * torch.pi / _DIRECTIONS)
        basis = torch.cat([ray.new_tensor([_SH0]), _SH1 * ray])
        volume += lit[:, None, None] * basis[None, :, None] * radiance[:, None, :]
    shape = (counts[2], counts[1], counts[0])
    return Ambient(volume.view(*shape, 12).permute(3, 0, 1, 2)[None].contiguous(), lower, upper)


def _homogeneous_pixels(points: Float[Tensor, "m 3"], camera: Camera) -> Float[Tensor, "m 3"]:
    """Pixel positions times z, and z, in float64."""
    pose, K = camera.world_to_camera.to(points.device).double(), camera.K.to(points.device).double()
    return (points.double() @ pose[:3, :3].T + pose[:3, 3]) @ K.T


def _visible(points: Tensor, camera: Camera, shadow: Tensor, slack: float) -> Tensor:
    """Which points (1 or 0) lie at most `slack` metres behind the nearest surface in a shadow map of 1/z."""
    homogeneous = _homogeneous_pixels(points, camera)
    z = homogeneous[:, 2]
    x, y = (homogeneous[:, :2] / z[:, None]).long().unbind(1)
    map_inverse_depth = shadow[y.clamp(0, camera.height - 1), x.clamp(0, camera.width - 1)]
    return (map_inverse_depth * (z - slack) <= 1).float()
