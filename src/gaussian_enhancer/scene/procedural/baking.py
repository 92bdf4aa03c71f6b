"""From a draft to a finished world: textures in one atlas, light and reflections computed once.

Axes: d steps of blur, h height, w width.
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
    """Turn a draft into a world on a device."""
    noise = draft.texture(speckle(draft.rng))
    holed = {i for i, m in enumerate(draft.materials) if draft.textures[m.texture].opacity.min() < 0.5}
    mesh = draft.builder.build(holed, device)
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
    empty = torch.zeros(1, 12, 1, 1, 1, device=device)
    zero = torch.zeros(3, device=device)
    bare = World(
        mesh, atlas, noise, table, sky, (), Ambient(empty, zero, zero + 1),
        draft.ambient, draft.exposure, draft.haze, draft.background,
    )  # fmt: skip
    lights = tuple(bake_light(spec, mesh, bare.solid) for spec in draft.lights)
    ambient = bake_ambient(mesh, bare.solid, sky, atlas, draft.ambient_box)
    lit = replace(bare, lights=lights, ambient=ambient)
    cube = torch.stack([radiance_grid(lit, camera) for camera in _cube(torch.tensor(draft.probe))])
    return replace(lit, probe=_panorama(cube))


_FACES = ((1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0))


def _cube(centre: Tensor) -> list[Camera]:
    return [
        look_at(centre, centre + torch.tensor(direction), _PROBE_SIDE / 2, _PROBE_SIDE, _PROBE_SIDE)
        for direction in _FACES
    ]


def _panorama(cube: Float[Tensor, "6 3 side side"]) -> Float[Tensor, "1 3 d h w"]:
    """Six square pictures as a latitude-longitude one, in six steps of blur; one column repeats at each side."""
    height, width = 128, 256
    device = cube.device
    polar = (torch.arange(height, device=device) + 0.5) / height * torch.pi
    turn = ((torch.arange(width, device=device) + 0.5) / width * 2 - 1) * torch.pi
    p, t = torch.meshgrid(polar, turn, indexing="ij")
    direction = torch.stack([p.sin() * t.cos(), p.sin() * t.sin(), p.cos()], dim=-1).view(-1, 3)
    picture = torch.zeros(len(direction), 3, device=device)
    best = torch.full((len(direction),), -1.0, device=device)
    for image, camera in zip(cube, _cube(torch.zeros(3)), strict=True):
        local = direction @ camera.rotation.to(device).T
        closer = local[:, 2] > best
        best = torch.where(closer, local[:, 2], best)
        position = (local[:, :2] / local[:, 2:].clamp_min(1e-3)).clamp(-1, 1)
        sampled = functional.grid_sample(
            image[None], position.view(1, 1, -1, 2), align_corners=False, padding_mode="border"
        )
        picture = torch.where(closer[:, None], sampled[0, :, 0].T, picture)
    level = picture.T.view(1, 3, height, width)
    levels = []
    for step in range(6):
        if step:
            radius = 2**step
            level = functional.pad(level, (radius, radius, 0, 0), mode="circular")
            level = functional.pad(level, (0, 0, radius, radius), mode="replicate")
            level = functional.avg_pool2d(level, 2 * radius + 1, stride=1)
        levels.append(functional.pad(level, (1, 1, 0, 0), mode="circular"))
    return torch.stack(levels, dim=2)
