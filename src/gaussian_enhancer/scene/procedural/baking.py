"""Baking of a draft to a world: texture atlas, mesh, shadow maps, ambient light and an environment map.

Axes: d levels of blur, h height, w width.
"""

from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from gaussian_enhancer.scene.procedural.atlas import bake
from gaussian_enhancer.scene.procedural.draft import Draft
from gaussian_enhancer.scene.procedural.light import Ambient, Sky, bake_ambient, bake_light, look_at
from gaussian_enhancer.scene.procedural.shade import radiance_grid
from gaussian_enhancer.scene.procedural.textures import speckle
from gaussian_enhancer.scene.procedural.world import MaterialTable, World
from gaussian_enhancer.types import Camera

_PROBE_SIDE = 96


def bake_world(draft: Draft, device: torch.device) -> World:
    """Bake a draft to a world on a device."""
    noise = draft.texture(speckle(draft.rng))
    cutout_materials = {i for i, m in enumerate(draft.materials) if draft.textures[m.texture].opacity.min() < 0.5}
    mesh = draft.builder.build(cutout_materials, device)
    atlas = bake(draft.textures, device)
    sky = Sky(draft.sky)
    table = MaterialTable(
        torch.tensor([m.texture for m in draft.materials], device=device),
        torch.tensor([m.repeats for m in draft.materials], device=device),
        torch.tensor([m.tint for m in draft.materials], device=device),
        torch.tensor(
            [
                (m.reflectance, m.roughness, m.relief, m.detail, m.dirt, m.emission, m.translucency)
                for m in draft.materials
            ],
            device=device,
        ),
    )
    empty_volume = torch.zeros(1, 12, 1, 1, 1, device=device)
    zero = torch.zeros(3, device=device)
    unlit = World(
        mesh, atlas, noise, table, sky, (), Ambient(empty_volume, zero, zero + 1),
        draft.ambient, draft.exposure, draft.haze, draft.background,
    )  # fmt: skip
    lights = tuple(bake_light(spec, mesh, unlit.solid) for spec in draft.lights)
    ambient = bake_ambient(mesh, unlit.solid, sky, atlas, draft.ambient_box)
    lit = replace(unlit, lights=lights, ambient=ambient)
    cube_map = torch.stack([radiance_grid(lit, camera) for camera in _cube(torch.tensor(draft.probe))])
    return replace(lit, probe=_panorama(cube_map))


_FACES = ((1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0))


def _cube(centre: Tensor) -> list[Camera]:
    return [
        look_at(centre, centre + torch.tensor(direction), _PROBE_SIDE / 2, _PROBE_SIDE, _PROBE_SIDE)
        for direction in _FACES
    ]


def _panorama(cube: Float[Tensor, "6 3 side side"]) -> Float[Tensor, "1 3 d h w"]:
    """Resample a cube map to latitude-longitude at six levels of blur, with one column of wrap-around at each side."""
    height, width = 128, 256
    device = cube.device
    polar = (torch.arange(height, device=device) + 0.5) / height * torch.pi
    azimuth = ((torch.arange(width, device=device) + 0.5) / width * 2 - 1) * torch.pi
    polar_grid, azimuth_grid = torch.meshgrid(polar, azimuth, indexing="ij")
    direction = torch.stack(
        [polar_grid.sin() * azimuth_grid.cos(), polar_grid.sin() * azimuth_grid.sin(), polar_grid.cos()], dim=-1
    ).view(-1, 3)
    panorama = torch.zeros(len(direction), 3, device=device)
    largest_z = torch.full((len(direction),), -1.0, device=device)
    for image, camera in zip(cube, _cube(torch.zeros(3)), strict=True):
        camera_directions = direction @ camera.rotation.to(device).T
        closer = camera_directions[:, 2] > largest_z
        largest_z = torch.where(closer, camera_directions[:, 2], largest_z)
        position = (camera_directions[:, :2] / camera_directions[:, 2:].clamp_min(1e-3)).clamp(-1, 1)
        sampled = functional.grid_sample(
            image[None], position.view(1, 1, -1, 2), align_corners=False, padding_mode="border"
        )
        panorama = torch.where(closer[:, None], sampled[0, :, 0].T, panorama)
    level = panorama.T.view(1, 3, height, width)
    levels = []
    for step in range(6):
        if step:
            radius = 2**step
            level = functional.pad(level, (radius, radius, 0, 0), mode="circular")
            level = functional.pad(level, (0, 0, radius, radius), mode="replicate")
            level = functional.avg_pool2d(level, 2 * radius + 1, stride=1)
        levels.append(functional.pad(level, (1, 1, 0, 0), mode="circular"))
    return torch.stack(levels, dim=2)
