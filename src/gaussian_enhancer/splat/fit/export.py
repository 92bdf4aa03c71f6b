"""A fit's results on disk in 3DGS's layout: the splat, its cameras, and its renders of all photos.

Axes: h height, w width. ``{train,test}/ours_<step>/{renders,gt,alpha}/<stem>.png`` with 8 bits and
``depth/<stem>.npy`` (z of the surface in scene units, float32, 0 where there is no surface).
"""

from functools import cache
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import atomic_write, save_array
from gaussian_enhancer.scene.cameras import write_scene_cameras
from gaussian_enhancer.scene.image_files import write_image
from gaussian_enhancer.scene.renders import WHITE
from gaussian_enhancer.scene.scene import Photo, Scene
from gaussian_enhancer.splat.io.ply import write_ply
from gaussian_enhancer.splat.methods import Method
from gaussian_enhancer.splat.near import near_plane
from gaussian_enhancer.splat.render import render
from gaussian_enhancer.types import Gaussians, Render


@torch.no_grad()
def export_views(folder: Path, scene: Scene, gaussians: Gaussians, method: Method, step: int) -> None:
    """Write ``cameras.json``, and the render of every training and test view beside its photo.

    Args:
        folder: the run's folder.
        scene: the scene that was fitted.
        gaussians: the splat.
        method: how it is rendered.
        step: step of the fit, part of the folders' names.

    Raises:
        InputError: two training or two test photos have the same name but for the ending, a photo has no camera, or a
            file cannot be written.
    """
    gaussians_on_cpu = cache(lambda: gaussians.to("cpu"))
    write_scene_cameras(folder / "cameras.json", scene)
    near = near_plane(scene.train_cameras)
    for split, photos in (("train", scene.train_photos), ("test", scene.test_photos)):
        stems = [Path(photo.name).stem for photo in photos]
        for stem in stems:
            if stems.count(stem) > 1:
                raise InputError(f"photos named {stem}", "differ in their ending only", "rename one of them")
        for stem, photo in zip(stems, photos, strict=True):
            camera = photo.require_camera()
            view = view_with_median = render(gaussians, camera, method, scene.background, near=near)
            if view.median_depth is None:  # gsplat returns no median depth of ellipsoids
                view_with_median = render(gaussians_on_cpu(), camera.to("cpu"), method, scene.background, near=near)
            _write_view(folder / split / f"ours_{step}", stem, photo, view, view_with_median.surface[0])


def export_splat(folder: Path, scene: Scene, gaussians: Gaussians) -> None:
    """Write ``splat.ply`` and 3DGS's ``cfg_args``, from which viewers read degree and background.

    Args:
        folder: the run's folder.
        scene: the scene that was fitted.
        gaussians: the splat.
    """
    write_ply(folder / "splat.ply", gaussians)
    degree = int(gaussians.sh.shape[1] ** 0.5) - 1
    # 3DGS knows black and white alone; the colour itself stands last, where its programs ignore it.
    background = f"white_background={scene.background == WHITE}, background={scene.background}"
    with atomic_write(folder / "cfg_args") as temporary:
        temporary.write_text(f"Namespace(sh_degree={degree}, {background})\n")


def _write_view(folder: Path, stem: str, photo: Photo, view: Render, surface: Float[Tensor, "h w"]) -> None:
    write_image(folder / "renders" / f"{stem}.png", view.colour)
    write_image(folder / "gt" / f"{stem}.png", photo.read())
    write_image(folder / "alpha" / f"{stem}.png", view.alpha)
    save_array(folder / "depth" / f"{stem}.npy", surface.cpu().numpy().astype(np.float32))
