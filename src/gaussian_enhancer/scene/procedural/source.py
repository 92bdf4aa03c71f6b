"""The scene source: a procedural world as posed photos with exact depth, rendered when they are asked for.

Axes: h height, w width, p points.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.procedural import shade
from gaussian_enhancer.scene.procedural.baking import bake_world
from gaussian_enhancer.scene.procedural.draft import Draft
from gaussian_enhancer.scene.procedural.harbour import draft_harbour
from gaussian_enhancer.scene.procedural.imperfections import Departure, Imperfections
from gaussian_enhancer.scene.procedural.indoor import draft_indoor
from gaussian_enhancer.scene.procedural.light import look_at
from gaussian_enhancer.scene.procedural.outdoor import draft_outdoor
from gaussian_enhancer.scene.procedural.raster import SampleGrid
from gaussian_enhancer.scene.procedural.recent import Recent
from gaussian_enhancer.scene.procedural.single import draft_object
from gaussian_enhancer.scene.procedural.unbounded import draft_unbounded
from gaussian_enhancer.scene.procedural.world import World
from gaussian_enhancer.scene.scene import Photo, Points, Scene
from gaussian_enhancer.scene.splits import Split
from gaussian_enhancer.types import Camera

_FAMILIES = {
    "unbounded": draft_unbounded,
    "outdoor": draft_outdoor,
    "indoor": draft_indoor,
    "object": draft_object,
    "harbour": draft_harbour,
}
FAMILIES = tuple(_FAMILIES)

_PHOTOS = Recent(capacity=2**28)


@lru_cache(maxsize=2)
def _baked(family: str, seed: int, device: str) -> tuple[World, Draft]:
    draft = _FAMILIES[family](seed)
    with torch.no_grad():
        world = bake_world(draft, torch.device(device))
    draft.textures.clear()
    draft.builder.parts.clear()
    return world, draft


@dataclass(frozen=True)
class ProceduralView:
    """One view of a world; small enough to be sent to another process, which bakes the world for itself."""

    family: str
    seed: int
    camera: Camera
    device: str
    departure: Departure | None = None

    def world(self) -> World:
        """The baked world, as this view sees it."""
        world = _baked(self.family, self.seed, self.device)[0]
        return world if self.departure is None else self.departure.of(world)

    @torch.no_grad()
    def photo(self) -> Float[Tensor, "3 h w"]:
        """The anti-aliased picture, on the CPU."""
        camera = self.camera
        pose = tuple(camera.world_to_camera.flatten().tolist())
        key = (
            self.family,
            self.seed,
            self.device,
            self.departure,
            camera.height,
            camera.width,
            *camera.K.flatten().tolist(),
            *pose,
        )
        return _PHOTOS.get(key, self._photo)

    def _photo(self) -> Float[Tensor, "3 h w"]:
        return shade.photo(self.world(), self.camera)[0].cpu()

    @torch.no_grad()
    def alpha(self) -> Float[Tensor, "1 h w"]:
        """The share of each pixel that geometry covers, on the CPU."""
        return shade.coverage(self.world(), self.camera).cpu()

    @torch.no_grad()
    def depth(self) -> Float[Tensor, "1 h w"]:
        """Exact z at pixel centres, 0 on the sky, on the CPU."""
        return shade.depth(self.world(), self.camera).cpu()


def procedural_scene(
    family: str,
    seed: int,
    *,
    height: int = 192,
    width: int = 256,
    views: int = 48,
    split: Split | None = None,
    points: int = 3000,
    device: str = "cpu",
    imperfections: Imperfections | None = None,
) -> Scene:
    """Build the procedural scene that a family and a seed determine.

    The world and the cameras do not depend on the size, so the same scene at four times the size is the truth for
    super-resolution. Depth is exact; `object` has exact coverage (`read_alpha`) over white, the others fill the view.

    Args:
        family: `unbounded`, `outdoor`, `indoor`, `object`, or `harbour`, which is kept for tests.
        seed: which world of the family, at least 0.
        height: photo height in pixels.
        width: photo width in pixels.
        views: number of photos along the camera path.
        split: how to divide the photos; every 8th is held out where None.
        points: number of surface points to sample from training views, slightly off as from structure from motion.
        device: where photos are rendered; they are returned on the CPU.
        imperfections: what differs from photo to photo, as in a real capture; nothing where None. Depth and coverage
            are those of the true camera.

    Raises:
        InputError: unknown family, or a number out of range.
    """
    if family not in _FAMILIES:
        raise InputError("procedural family", f"is {family!r}", f"choose one of {', '.join(FAMILIES)}")
    for name, value, least in (
        ("seed", seed, 0),
        ("height", height, 1),
        ("width", width, 1),
        ("views", views, 1),
        ("points", points, 0),
    ):
        if value < least:
            raise InputError(f"procedural {name}", f"is {value}", f"give at least {least}")
    train, test = (split or Split())(views)
    _, draft = _baked(family, seed, device)
    focal = 0.5 * width / float(np.tan(np.deg2rad(draft.field_of_view) / 2))
    eyes, targets = (torch.from_numpy(places) for places in draft.path(views))
    photos = []
    for k in range(views):
        camera = stated = look_at(eyes[k], targets[k], focal, height, width)
        departure = None
        if imperfections is not None:
            generator = torch.Generator().manual_seed(seed * 1_000_003 + k)
            departure = imperfections.departure(generator)
            stated = imperfections.stated(camera, float((targets[k] - eyes[k]).norm()), generator)
        view = ProceduralView(family, seed, camera, device, departure)
        alpha = view.alpha if family == "object" else None
        photos.append(Photo(f"{k:04d}.png", stated, view.photo, view.depth, alpha))
    scene = Scene(f"{family}_{seed}", tuple(photos), train, test, draft.background or (0.0, 0.0, 0.0))
    cloud = _points(scene, _baked(family, seed, device)[0], points, seed) if points else None
    return Scene(scene.name, scene.photos, train, test, scene.background, cloud)


@torch.no_grad()
def _points(scene: Scene, world: World, count: int, seed: int) -> Points:
    """Surface points that training views see, off by about half a pixel of a view 256 pixels wide."""
    generator = torch.Generator().manual_seed(seed)
    chosen = scene.train_photos[:: max(1, len(scene.train) // 16)]
    positions, colours = [], []
    for photo in chosen:
        assert photo.camera is not None
        camera = photo.camera.resized(72, 96)
        z = shade.depth(world, camera).cpu()[0]
        picture = shade.photo(world, camera, SampleGrid())[0].cpu()
        seen = ((z > 0) & (z < 500)).flatten().nonzero()[:, 0]
        picked = seen[torch.randperm(len(seen), generator=generator)[: -(-count // len(chosen))]]
        y, x, depth = picked // 96, picked % 96, z.flatten()[picked]
        pixels = torch.stack([x + 0.5, y + 0.5, torch.ones(len(picked))], dim=1)
        local = pixels @ torch.linalg.inv(camera.K).T * depth[:, None]
        local = local + 0.002 * depth[:, None] * torch.randn(local.shape, generator=generator)
        positions.append((local - camera.world_to_camera[:3, 3]) @ camera.rotation)
        colours.append(picture.flatten(1).T[picked])
    return Points(torch.cat(positions)[:count], torch.cat(colours)[:count])
