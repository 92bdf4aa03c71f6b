"""Procedural scenes: posed photos of a procedural world with exact depth, rendered on demand.

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
from gaussian_enhancer.scene.procedural.imperfections import Imperfections, PhotoDeviation
from gaussian_enhancer.scene.procedural.indoor import draft_indoor
from gaussian_enhancer.scene.procedural.light import look_at
from gaussian_enhancer.scene.procedural.outdoor import draft_outdoor
from gaussian_enhancer.scene.procedural.raster import SampleGrid
from gaussian_enhancer.scene.procedural.recent import TensorCache
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

_PHOTOS = TensorCache(capacity=2**28)


@lru_cache(maxsize=2)
def _bake_cached(family: str, seed: int, device: str) -> tuple[World, Draft]:
    draft = _FAMILIES[family](seed)
    with torch.no_grad():
        world = bake_world(draft, torch.device(device))
    draft.textures.clear()
    draft.builder.parts.clear()
    return world, draft


@dataclass(frozen=True)
class ProceduralView:
    """One view of a world.

    The world is given by family and seed, so a view is small enough to be sent to another process. That process bakes
    the world itself.
    """

    family: str
    seed: int
    camera: Camera
    device: str
    deviation: PhotoDeviation | None = None

    def world(self) -> World:
        """Return the baked world with the deviation of this view, if any."""
        world = _bake_cached(self.family, self.seed, self.device)[0]
        return world if self.deviation is None else self.deviation.apply_to(world)

    @torch.no_grad()
    def photo(self) -> Float[Tensor, "3 h w"]:
        """Return the anti-aliased image, on the CPU."""
        camera = self.camera
        pose = tuple(camera.world_to_camera.flatten().tolist())
        key = (
            self.family,
            self.seed,
            self.device,
            self.deviation,
            camera.height,
            camera.width,
            *camera.K.flatten().tolist(),
            *pose,
        )
        return _PHOTOS.get(key, self._photo)

    def _photo(self) -> Float[Tensor, "3 h w"]:
        return shade.render_photo(self.world(), self.camera)[0].cpu()

    @torch.no_grad()
    def alpha(self) -> Float[Tensor, "1 h w"]:
        """Return the share of each pixel that geometry covers, on the CPU."""
        return shade.render_coverage(self.world(), self.camera).cpu()

    @torch.no_grad()
    def depth(self) -> Float[Tensor, "1 h w"]:
        """Return exact z at pixel centres, 0 on the sky, on the CPU."""
        return shade.render_depth(self.world(), self.camera).cpu()


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

    The world and the cameras do not depend on the size, so the same scene at four times the size is the ground truth
    for super-resolution. Depth is exact. `object` has a white background and exact coverage (`read_alpha`); the other
    families fill the view.

    Args:
        family: `unbounded`, `outdoor`, `indoor`, `object`, or `harbour`, which is kept for tests.
        seed: determines the world of the family, at least 0.
        height: photo height in pixels.
        width: photo width in pixels.
        views: number of photos along the camera path.
        split: division into training and test photos; None holds out every 8th.
        points: number of surface points sampled from training views, with noise as in structure from motion.
        device: device on which photos are rendered; they are returned on the CPU.
        imperfections: variation of exposure, white balance, pose and wind from photo to photo, as in a real capture;
            None for none. Depth and coverage are those of the true camera.

    Raises:
        InputError: the family is unknown, or a number is out of range.
    """
    if family not in _FAMILIES:
        raise InputError("procedural family", f"is {family!r}", f"choose one of {', '.join(FAMILIES)}")
    for name, value, minimum in (
        ("seed", seed, 0),
        ("height", height, 1),
        ("width", width, 1),
        ("views", views, 1),
        ("points", points, 0),
    ):
        if value < minimum:
            raise InputError(f"procedural {name}", f"is {value}", f"give at least {minimum}")
    train, test = (split or Split())(views)
    _, draft = _bake_cached(family, seed, device)
    focal = 0.5 * width / float(np.tan(np.deg2rad(draft.field_of_view) / 2))
    eyes, targets = (torch.from_numpy(positions) for positions in draft.path(views))
    photos = []
    for k in range(views):
        camera = stated_camera = look_at(eyes[k], targets[k], focal, height, width)
        deviation = None
        if imperfections is not None:
            generator = torch.Generator().manual_seed(seed * 1_000_003 + k)
            deviation = imperfections.draw_deviation(generator)
            stated_camera = imperfections.with_pose_error(camera, float((targets[k] - eyes[k]).norm()), generator)
        view = ProceduralView(family, seed, camera, device, deviation)
        alpha = view.alpha if family == "object" else None
        photos.append(Photo(f"{k:04d}.png", stated_camera, view.photo, view.depth, alpha))
    scene = Scene(f"{family}_{seed}", tuple(photos), train, test, draft.background or (0.0, 0.0, 0.0))
    point_cloud = _points(scene, _bake_cached(family, seed, device)[0], points, seed) if points else None
    return Scene(scene.name, scene.photos, train, test, scene.background, point_cloud)


@torch.no_grad()
def _points(scene: Scene, world: World, count: int, seed: int) -> Points:
    """Sample surface points visible in training views, with noise of about half a pixel of a view 256 pixels wide."""
    generator = torch.Generator().manual_seed(seed)
    sampled_photos = scene.train_photos[:: max(1, len(scene.train) // 16)]
    positions, colours = [], []
    for photo in sampled_photos:
        assert photo.camera is not None
        camera = photo.camera.resized(72, 96)
        z = shade.render_depth(world, camera).cpu()[0]
        image = shade.render_photo(world, camera, SampleGrid())[0].cpu()
        valid_pixels = ((z > 0) & (z < 500)).flatten().nonzero()[:, 0]
        sampled_pixels = valid_pixels[
            torch.randperm(len(valid_pixels), generator=generator)[: -(-count // len(sampled_photos))]
        ]
        y, x, depth = sampled_pixels // 96, sampled_pixels % 96, z.flatten()[sampled_pixels]
        pixel_positions = torch.stack([x + 0.5, y + 0.5, torch.ones(len(sampled_pixels))], dim=1)
        camera_points = pixel_positions @ torch.linalg.inv(camera.K).T * depth[:, None]
        camera_points = camera_points + 0.002 * depth[:, None] * torch.randn(camera_points.shape, generator=generator)
        positions.append((camera_points - camera.world_to_camera[:3, 3]) @ camera.rotation)
        colours.append(image.flatten(1).T[sampled_pixels])
    return Points(torch.cat(positions)[:count], torch.cat(colours)[:count])
