"""Rendering of a world: colour, depth and coverage of a camera's view.

Radiance is the sum of direct light from suns and lamps (Lambert and Blinn-Phong, with shadow maps), ambient light from
a volume, and reflections of an environment map with Schlick's Fresnel term. Haze is added, then the filmic curve
1 - exp(-x) and the display's exponent 1/2.2 are applied. Samples are averaged after the tone curve, as in a larger
image that is downsampled by a box filter.

Axes: m samples, h height, w width.
"""

from collections.abc import Iterator

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional

from gaussian_enhancer.scene.procedural.atlas import SLOPE_RANGE
from gaussian_enhancer.scene.procedural.raster import (
    ProjectedFaces,
    SampleGrid,
    barycentric,
    nearest_faces,
    project,
    sample_positions,
)
from gaussian_enhancer.scene.procedural.vector import dot, interpolate_corners, unit
from gaussian_enhancer.scene.procedural.world import World
from gaussian_enhancer.types import Camera

_BAND = 400_000
PHOTO_GRID = SampleGrid(rows=4, columns=2)


def render_photo(
    world: World, camera: Camera, grid: SampleGrid = PHOTO_GRID
) -> tuple[Float[Tensor, "3 h w"], Float[Tensor, "1 h w"]]:
    """Render an image (sRGB, [0, 1], over the background) and the coverage by geometry, both averaged over a pixel."""
    projected = project(world.mesh.corners, camera)
    pixel = _pixel_angle(camera) / (grid.rows * grid.columns) ** 0.5
    colours, coverages = [], []
    for face, x, y in _bands(world, projected, camera, grid):
        linear = _radiance(world, projected, camera, face, x, y, pixel)
        colour = tone_map(linear * world.exposure)
        if world.background is not None:
            colour[face < 0] = colour.new_tensor(world.background)
        colours.append(colour.view(-1, grid.rows, camera.width, grid.columns, 3).mean((1, 3)))
        coverages.append(_coverage(face, camera, grid))
    return torch.cat(colours).permute(2, 0, 1).contiguous(), torch.cat(coverages)[None]


def render_depth(world: World, camera: Camera) -> Float[Tensor, "1 h w"]:
    """Render exact z at pixel centres, 0 where nothing is hit."""
    projected = project(world.mesh.corners, camera)
    bands = []
    for face, x, y in _bands(world, projected, camera, SampleGrid()):
        _, z = barycentric(projected.edges[face.clamp_min(0)], x, y)
        bands.append(torch.where(face >= 0, z, torch.zeros_like(z)))
    return torch.cat(bands).view(1, camera.height, camera.width)


def render_coverage(world: World, camera: Camera) -> Float[Tensor, "1 h w"]:
    """Render the share of each pixel's samples that geometry covers: the alpha of `render_photo`."""
    projected = project(world.mesh.corners, camera)
    bands = [_coverage(face, camera, PHOTO_GRID) for face, _, _ in _bands(world, projected, camera, PHOTO_GRID)]
    return torch.cat(bands)[None]


def radiance_grid(world: World, camera: Camera) -> Float[Tensor, "3 h w"]:
    """Render linear radiance at pixel centres, for environment maps."""
    projected = project(world.mesh.corners, camera)
    face, x, y = _visible(world, projected, camera, SampleGrid(), 0, camera.height)
    linear = _radiance(world, projected, camera, face, x, y, _pixel_angle(camera))
    return linear.T.reshape(3, camera.height, camera.width)


def tone_map(linear: Float[Tensor, "m 3"]) -> Float[Tensor, "m 3"]:
    """Map linear radiance to sRGB: the curve 1 - exp(-x), which compresses highlights, then the exponent 1/2.2."""
    return (1 - torch.exp(-linear.clamp_min(0))).clamp_min(1e-6) ** (1 / 2.2)


def _coverage(face: Tensor, camera: Camera, grid: SampleGrid) -> Tensor:
    """Share of each pixel's samples that hit a face, for a band of whole pixel rows."""
    return (face >= 0).float().view(-1, grid.rows, camera.width, grid.columns).mean((1, 3))


def _pixel_angle(camera: Camera) -> float:
    return 1.0 / float(camera.K[0, 0])


def _bands(
    world: World, projected: ProjectedFaces, camera: Camera, grid: SampleGrid
) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
    """Iterate over bands of whole pixel rows: each sample's visible face (-1 on the sky), x and y."""
    step = max(1, _BAND // (camera.width * grid.rows * grid.columns)) * grid.rows
    for first_row in range(0, camera.height * grid.rows, step):
        yield _visible(world, projected, camera, grid, first_row, min(first_row + step, camera.height * grid.rows))


def _visible(
    world: World, projected: ProjectedFaces, camera: Camera, grid: SampleGrid, first_row: int, end_row: int
) -> tuple[Tensor, Tensor, Tensor]:
    """Visible face (-1 on the sky), x and y of each sample of a range of sample rows."""

    def keep(face: Tensor, x: Tensor, y: Tensor) -> Tensor:
        weights, _ = barycentric(projected.edges[face], x, y)
        u, v = interpolate_corners(weights, world.mesh.uvs[face]).unbind(1)
        return world.solid(face, u, v)

    face = nearest_faces(projected, grid, camera.width, first_row, end_row, world.mesh.cutout, keep)
    x, y = sample_positions(grid, camera.width, first_row, end_row, face.device)
    return face, x, y


def _radiance(
    world: World, projected: ProjectedFaces, camera: Camera, face: Tensor, x: Tensor, y: Tensor, pixel: float
) -> Float[Tensor, "m 3"]:
    """Return the linear radiance of every sample, including samples of the sky."""
    device = x.device
    K, pose = camera.K.to(device).double(), camera.world_to_camera.to(device).double()
    camera_rays = torch.stack([x, y, torch.ones_like(x)], dim=1) @ torch.linalg.inv(K).T
    rays = (camera_rays @ pose[:3, :3]).float()
    result = torch.empty_like(rays)
    sky_samples = (face < 0).nonzero()[:, 0]
    if len(sky_samples):
        sky_directions = unit(rays[sky_samples])
        result[sky_samples] = world.sky.radiance(sky_directions, world.atlas, pixel)
    surface_samples = (face >= 0).nonzero()[:, 0]
    if len(surface_samples):
        weights, z = barycentric(projected.edges[face[surface_samples]], x[surface_samples], y[surface_samples])
        origin = (-pose[:3, :3].T @ pose[:3, 3]).float()
        result[surface_samples] = _surface(
            world, face[surface_samples], weights, z, rays[surface_samples], origin, pixel
        )
    return result


def _surface(
    world: World, face: Tensor, weights: Tensor, z: Tensor, rays: Tensor, origin: Tensor, pixel: float
) -> Tensor:
    """Return the linear radiance of samples that hit a surface: direct, ambient and reflected light, emission, haze."""
    mesh = world.mesh
    points = origin + z[:, None] * rays
    view_directions = unit(rays)
    material = mesh.material[face]
    tangents = mesh.tangents[face]
    face_normals = unit(torch.linalg.cross(tangents[:, 0], tangents[:, 1]))
    facing = -dot(face_normals, view_directions)
    face_normals = face_normals * torch.where(facing < 0, -1.0, 1.0)[:, None]
    interpolated_normals = unit(interpolate_corners(weights, mesh.normals[face]))
    interpolated_normals = (
        interpolated_normals * torch.where(dot(interpolated_normals, face_normals) < 0, -1.0, 1.0)[:, None]
    )
    uv_metres = interpolate_corners(weights, mesh.uvs[face])
    # A compromise between the footprint's short and long side; a pixel's several samples reduce the remaining aliasing.
    footprint = pixel * z * facing.abs().clamp_min(0.08) ** -0.6
    channels, albedo, emission = _material(world, material, uv_metres, footprint)
    reflectance, roughness, relief, _, _, _, translucency = world.materials.looks[material].unbind(1)
    slopes = (channels[:, 4:6] - 0.5) * (2 * SLOPE_RANGE) * (relief[:, None] * world.materials.repeats[material])
    normals = unit(interpolated_normals - slopes[:, :1] * tangents[:, 0] - slopes[:, 1:] * tangents[:, 1])
    gloss = channels[:, 6]
    diffuse = world.ambient_strength * world.ambient.irradiance(points, normals)
    specular = torch.zeros_like(diffuse)
    exponent = 2 / (roughness**2 * roughness**2 + 1e-4)
    for light in world.lights:
        towards, colour, lit_share = light.incident_light(points, face_normals)
        cosine = dot(normals, towards)
        diffuse_factor = translucency * (-cosine).clamp_min(0) + (1 - translucency) * cosine.clamp_min(0)
        diffuse_factor = torch.where(translucency > 0, diffuse_factor + 0.25 * translucency, diffuse_factor)
        diffuse = diffuse + colour * (lit_share * diffuse_factor)[:, None]
        half_vector = unit(towards - view_directions)
        specular_lobe = dot(normals, half_vector).clamp_min(0) ** exponent * (exponent + 2) / 8
        specular = specular + colour * (lit_share * specular_lobe * cosine.clamp_min(0))[:, None]
    view_cosine = (-dot(normals, view_directions)).clamp(0, 1)
    fresnel = reflectance + (1 - reflectance) * (1 - view_cosine) ** 5 * (1 - roughness) ** 2
    fresnel = (fresnel * gloss)[:, None]
    specular_colour = torch.where(reflectance[:, None] > 0.25, albedo, torch.ones_like(albedo))
    reflected = _mirror_radiance(world, view_directions + 2 * view_cosine[:, None] * normals, roughness)
    result = albedo * diffuse * (1 - fresnel) + fresnel * specular_colour * (reflected + specular) + emission
    if world.haze > 0:
        haze_transmittance = torch.exp(-world.haze * z)[:, None]
        result = torch.lerp(result.new_tensor(world.sky.spec.horizon).expand_as(result), result, haze_transmittance)
    return result


def _material(
    world: World, material: Int[Tensor, " m"], metres: Float[Tensor, "m 2"], footprint: Float[Tensor, " m"]
) -> tuple[Tensor, Tensor, Tensor]:
    """Return texture channels, linear albedo and emission; the colour is modulated by finer and by coarser noise."""
    table = world.materials
    repeats = table.repeats[material]
    per_metre = repeats.amax(1)
    channels = world.atlas.read(table.texture[material], metres * repeats, footprint * per_metre)
    looks = table.looks[material]
    noise = torch.full_like(material, world.noise)
    rotated_metres = torch.stack(
        [metres[:, 0] * 0.8 - metres[:, 1] * 0.6, metres[:, 0] * 0.6 + metres[:, 1] * 0.8], dim=1
    )
    fine_noise = world.atlas.read(noise, rotated_metres * (repeats * 5.3), footprint * per_metre * 5.3)[:, 7]
    coarse_noise = world.atlas.read(noise, rotated_metres * (repeats * 0.137), footprint * per_metre * 0.137)[:, 7]
    brightness = (1 + looks[:, 3] * 1.2 * (fine_noise - 0.5)) * (1 + looks[:, 4] * 1.4 * (coarse_noise - 0.5))
    colour = (channels[:, :3] * table.tint[material] * brightness[:, None]).clamp(0.004, 1.0)
    albedo = colour**2.2
    return channels, albedo, albedo * looks[:, 5:6]


def _mirror_radiance(world: World, directions: Tensor, roughness: Tensor) -> Tensor:
    """Return the environment's radiance from directions, blurred according to the surface's roughness."""
    if world.probe is None:
        return world.sky.radiance(directions, world.atlas, 0.1, sharp=False)
    levels, width = world.probe.shape[2], world.probe.shape[4]
    u = torch.atan2(directions[:, 1], directions[:, 0]) / torch.pi * ((width - 2) / width)
    v = torch.acos(directions[:, 2].clamp(-1, 1)) / torch.pi * 2 - 1
    blur_level = (roughness * levels + 0.5) / levels * 2 - 1
    position = torch.stack([u, v, blur_level], dim=1).view(1, 1, 1, -1, 3)
    sampled = functional.grid_sample(world.probe, position, align_corners=False, padding_mode="border")
    return sampled.view(3, -1).T
