"""Colour, depth and coverage of a world through a camera.

Light is the sum of suns and lamps (Lambert and Blinn-Phong, shadow-mapped), ambient light from a volume, and the
surroundings mirrored with Schlick's Fresnel term; haze, then a filmic curve 1 - exp(-x)
and the sRGB exponent. Samples are averaged after the curve, as a box-downsampled larger picture would be.

Axes: m samples, h height, w width.
"""

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional

from gaussian_enhancer.scene.procedural.raster import (
    Projected,
    SampleGrid,
    barycentric,
    nearest_faces,
    project,
    sample_positions,
)
from gaussian_enhancer.scene.procedural.vector import dot, unit, weighted
from gaussian_enhancer.scene.procedural.world import World
from gaussian_enhancer.types import Camera

_BAND = 400_000
PHOTO_GRID = SampleGrid(rows=4, columns=2)


def photo(
    world: World, camera: Camera, grid: SampleGrid = PHOTO_GRID
) -> tuple[Float[Tensor, "3 h w"], Float[Tensor, "1 h w"]]:
    """The picture (sRGB, [0, 1], over the background) and the coverage by geometry, both averaged over a pixel."""
    projected = project(world.mesh.corners, camera)
    pixel = _pixel_angle(camera) / (grid.rows * grid.columns) ** 0.5
    colours, covers = [], []
    step = max(1, _BAND // (camera.width * grid.rows * grid.columns)) * grid.rows
    for first in range(0, camera.height * grid.rows, step):
        last = min(first + step, camera.height * grid.rows)
        face, x, y = _visible(world, projected, camera, grid, first, last)
        linear = _radiance(world, projected, camera, face, x, y, pixel)
        colour = tone(linear * world.exposure)
        if world.background is not None:
            colour[face < 0] = colour.new_tensor(world.background)
        shape = ((last - first) // grid.rows, grid.rows, camera.width, grid.columns)
        colours.append(colour.view(*shape, 3).mean((1, 3)))
        covers.append((face >= 0).float().view(shape).mean((1, 3)))
    return torch.cat(colours).permute(2, 0, 1).contiguous(), torch.cat(covers)[None]


def depth(world: World, camera: Camera) -> Float[Tensor, "1 h w"]:
    """Exact z at every pixel's centre, 0 where nothing is hit."""
    projected = project(world.mesh.corners, camera)
    rows = max(1, _BAND // camera.width)
    pieces = []
    for first in range(0, camera.height, rows):
        last = min(first + rows, camera.height)
        face, x, y = _visible(world, projected, camera, SampleGrid(), first, last)
        _, z = barycentric(projected.edges[face.clamp_min(0)], x, y)
        pieces.append(torch.where(face >= 0, z, torch.zeros_like(z)))
    return torch.cat(pieces).view(1, camera.height, camera.width)


def coverage(world: World, camera: Camera, grid: SampleGrid = PHOTO_GRID) -> Float[Tensor, "1 h w"]:
    """The share of each pixel's samples that geometry covers: the very alpha under which `photo` was composited."""
    projected = project(world.mesh.corners, camera)
    step = max(1, _BAND // (camera.width * grid.rows * grid.columns)) * grid.rows
    pieces = []
    for first in range(0, camera.height * grid.rows, step):
        last = min(first + step, camera.height * grid.rows)
        face, _, _ = _visible(world, projected, camera, grid, first, last)
        pieces.append((face >= 0).float().view(-1, grid.rows, camera.width, grid.columns).mean((1, 3)))
    return torch.cat(pieces)[None]


def radiance_grid(world: World, camera: Camera) -> Float[Tensor, "3 h w"]:
    """Linear radiance at pixel centres, for reflections."""
    projected = project(world.mesh.corners, camera)
    face, x, y = _visible(world, projected, camera, SampleGrid(), 0, camera.height)
    linear = _radiance(world, projected, camera, face, x, y, _pixel_angle(camera))
    return linear.T.reshape(3, camera.height, camera.width)


def tone(linear: Float[Tensor, "m 3"]) -> Float[Tensor, "m 3"]:
    """Linear light to sRGB as a camera would: a shoulder for highlights, then the display's exponent."""
    return (1 - torch.exp(-linear.clamp_min(0))).clamp_min(1e-6) ** (1 / 2.2)


def _pixel_angle(camera: Camera) -> float:
    return 1.0 / float(camera.K[0, 0])


def _visible(
    world: World, projected: Projected, camera: Camera, grid: SampleGrid, first: int, last: int
) -> tuple[Tensor, Tensor, Tensor]:
    def keep(face: Tensor, x: Tensor, y: Tensor) -> Tensor:
        weights, _ = barycentric(projected.edges[face], x, y)
        u, v = weighted(weights, world.mesh.uvs[face]).unbind(1)
        return world.solid(face, u, v)

    face = nearest_faces(projected, grid, camera.width, first, last, world.mesh.cutout, keep)
    x, y = sample_positions(grid, camera.width, first, last, face.device)
    return face, x, y


def _radiance(
    world: World, projected: Projected, camera: Camera, face: Tensor, x: Tensor, y: Tensor, pixel: float
) -> Float[Tensor, "m 3"]:
    """Linear radiance of every sample, sky included."""
    device = x.device
    K, pose = camera.K.to(device).double(), camera.world_to_camera.to(device).double()
    local = torch.stack([x, y, torch.ones_like(x)], dim=1) @ torch.linalg.inv(K).T
    rays = (local @ pose[:3, :3]).float()
    result = torch.empty_like(rays)
    missed = (face < 0).nonzero()[:, 0]
    if len(missed):
        away = unit(rays[missed])
        result[missed] = world.sky.radiance(away, world.atlas, pixel)
    hit = (face >= 0).nonzero()[:, 0]
    if len(hit):
        weights, z = barycentric(projected.edges[face[hit]], x[hit], y[hit])
        origin = (-pose[:3, :3].T @ pose[:3, 3]).float()
        result[hit] = _surface(world, face[hit], weights, z, rays[hit], origin, pixel)
    return result


def _surface(
    world: World, face: Tensor, weights: Tensor, z: Tensor, rays: Tensor, origin: Tensor, pixel: float
) -> Tensor:
    mesh = world.mesh
    points = origin + z[:, None] * rays
    away = unit(rays)
    material = mesh.material[face]
    tangents = mesh.tangents[face]
    flat = unit(torch.linalg.cross(tangents[:, 0], tangents[:, 1]))
    facing = -dot(flat, away)
    flat = flat * torch.where(facing < 0, -1.0, 1.0)[:, None]
    smooth = unit(weighted(weights, mesh.normals[face]))
    smooth = smooth * torch.where(dot(smooth, flat) < 0, -1.0, 1.0)[:, None]
    metres = weighted(weights, mesh.uvs[face])
    # Between the footprint's short and long side: the samples of a pixel settle the rest.
    footprint = pixel * z * facing.abs().clamp_min(0.08) ** -0.6
    channels, albedo, emission = _material(world, material, metres, footprint)
    reflectance, roughness, relief, _, _, _, translucency = world.materials.looks[material].unbind(1)
    slopes = (channels[:, 4:6] - 0.5) * 80.0 * (relief[:, None] * world.materials.repeats[material])
    normals = smooth - slopes[:, :1] * tangents[:, 0] - slopes[:, 1:] * tangents[:, 1]
    normals = unit(normals)
    gloss = channels[:, 6]
    diffuse = world.ambient_strength * world.ambient.irradiance(points, normals)
    shine = torch.zeros_like(diffuse)
    power = 2 / (roughness**2 * roughness**2 + 1e-4)
    for light in world.lights:
        towards, colour, lit = light.arriving(points, flat)
        cosine = dot(normals, towards)
        through = translucency * (-cosine).clamp_min(0) + (1 - translucency) * cosine.clamp_min(0)
        through = torch.where(translucency > 0, through + 0.25 * translucency, through)
        diffuse = diffuse + colour * (lit * through)[:, None]
        half = unit(towards - away)
        lobe = dot(normals, half).clamp_min(0) ** power * (power + 2) / 8
        shine = shine + colour * (lit * lobe * cosine.clamp_min(0))[:, None]
    seen = (-dot(normals, away)).clamp(0, 1)
    fresnel = reflectance + (1 - reflectance) * (1 - seen) ** 5 * (1 - roughness) ** 2
    fresnel = (fresnel * gloss)[:, None]
    tinted = torch.where(reflectance[:, None] > 0.25, albedo, torch.ones_like(albedo))
    mirrored = _mirror_radiance(world, away + 2 * seen[:, None] * normals, roughness)
    result = albedo * diffuse * (1 - fresnel) + fresnel * tinted * (mirrored + shine) + emission
    if world.haze > 0:
        clear = torch.exp(-world.haze * z)[:, None]
        result = torch.lerp(result.new_tensor(world.sky.spec.horizon).expand_as(result), result, clear)
    return result


def _material(
    world: World, material: Int[Tensor, " m"], metres: Float[Tensor, "m 2"], footprint: Float[Tensor, " m"]
) -> tuple[Tensor, Tensor, Tensor]:
    """Texture channels, linear albedo and emission, with finer and wider noise laid over the texture."""
    table = world.materials
    repeats = table.repeats[material]
    per_metre = repeats.amax(1)
    channels = world.atlas.read(table.texture[material], metres * repeats, footprint * per_metre)
    looks = table.looks[material]
    noise = torch.full_like(material, world.noise)
    turned = torch.stack([metres[:, 0] * 0.8 - metres[:, 1] * 0.6, metres[:, 0] * 0.6 + metres[:, 1] * 0.8], dim=1)
    fine = world.atlas.read(noise, turned * (repeats * 5.3), footprint * per_metre * 5.3)[:, 7]
    wide = world.atlas.read(noise, turned * (repeats * 0.137), footprint * per_metre * 0.137)[:, 7]
    factor = (1 + looks[:, 3] * 1.2 * (fine - 0.5)) * (1 + looks[:, 4] * 1.4 * (wide - 0.5))
    colour = (channels[:, :3] * table.tint[material] * factor[:, None]).clamp(0.004, 1.0)
    albedo = colour**2.2
    return channels, albedo, albedo * looks[:, 5:6]


def _mirror_radiance(world: World, directions: Tensor, roughness: Tensor) -> Tensor:
    """What a surface of some roughness reflects from a direction."""
    if world.probe is None:
        return world.sky.radiance(directions, world.atlas, 0.1, sharp=False)
    levels, width = world.probe.shape[2], world.probe.shape[4]
    u = torch.atan2(directions[:, 1], directions[:, 0]) / torch.pi * ((width - 2) / width)
    v = torch.acos(directions[:, 2].clamp(-1, 1)) / torch.pi * 2 - 1
    w = (roughness * levels + 0.5) / levels * 2 - 1
    position = torch.stack([u, v, w], dim=1).view(1, 1, 1, -1, 3)
    sampled = functional.grid_sample(world.probe, position, align_corners=False, padding_mode="border")
    return sampled.view(3, -1).T
