"""Images of 4 times the resolution of a fit's renders: photos, bicubic upsampling, new renders of the splat.

Each folder is a content-addressed run, made once for all methods that need it.
"""

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from jaxtyping import Float
from omegaconf import DictConfig, OmegaConf
from torch import Tensor

from gaussian_enhancer.network.pyramid import upsample_bicubic
from gaussian_enhancer.runs import status
from gaussian_enhancer.runs.high_resolution import HighResolutionPhotos, high_resolution_config
from gaussian_enhancer.runs.instantiate import build
from gaussian_enhancer.runs.output import read_original_size
from gaussian_enhancer.runs.rendered_capture import render_capture
from gaussian_enhancer.runs.run import find_run, open_run
from gaussian_enhancer.runs.runtime import start
from gaussian_enhancer.scene.high_resolution import UPSCALE
from gaussian_enhancer.scene.image_files import write_image
from gaussian_enhancer.scene.photos import list_images, read_header, read_photo, resize
from gaussian_enhancer.scene.renders import read_run

Named = Iterable[tuple[str, Float[Tensor, "3 _ _"]]]
"""File names with images."""


def fine_photos(cfg: DictConfig, fit: Path) -> Path:
    """The folder of a fit's held-out photos at 4 times the renders' resolution.

    Args:
        cfg: the calling job's configuration: ``runs`` and ``runtime``.
        fit: the fit's folder.

    Raises:
        InputError: the scene has no photos of that resolution.
    """

    def photos() -> Named:
        for view in HighResolutionPhotos(Path(cfg.runs) / "photos")(fit, read_run(fit)).targets:
            yield view.name, read_original_size(view)

    return _cached_images(cfg, "fine_photos", fit.name, {"fit": str(fit)}, photos)


def bicubic(cfg: DictConfig, folder: Path, label: str, photos: Path) -> Path:
    """The folder of images upsampled bicubically.

    Args:
        cfg: the calling job's configuration: ``runs`` and ``runtime``.
        folder: images at the render's size.
        label: a readable part of the new folder's name.
        photos: folder of the photos that they are compared with; the upsampled images are resized to them.
    """

    def images() -> Named:
        sizes = {path.stem: read_header(path) for path in list_images(photos)}
        for path in list_images(folder):
            enlarged = upsample_bicubic(read_photo(path)[None], UPSCALE)[0].clamp(0, 1)
            size = sizes.get(path.stem)
            yield path.name, enlarged if size is None else resize(enlarged, size.height, size.width)

    return _cached_images(cfg, "bicubic", label, {"images": str(folder)}, images)


def high_resolution_renders(cfg: DictConfig, fit: Path, scene: DictConfig) -> Path:
    """The folder of a fit's held-out views, rendered from its splat at 4 times the width and height.

    Args:
        cfg: the calling job's configuration: ``runs`` and ``runtime``.
        fit: the fit's folder.
        scene: configuration of the scene that was fitted.
    """
    finer = high_resolution_config(scene)

    def images() -> Named:
        device = start(cfg.runtime)
        for view in render_capture(str(fit / "splat.ply"), build(finer), "auto", "test", device.type).targets:
            if view.read is not None:
                yield view.name, view.read()

    values = {"fit": str(fit), "scene": OmegaConf.to_container(finer, resolve=True)}
    return _cached_images(cfg, "render_finer", fit.name, values, images)


def _cached_images(
    cfg: DictConfig, job: str, label: str, values: Mapping[str, Any], images: Callable[[], Named]
) -> Path:
    """The folder of images of a content-addressed run; the images are made and written unless the run exists."""
    run_cfg = OmegaConf.create({"runs": cfg.runs, **values})
    run = find_run(run_cfg, job)
    if run is None or not run.done:
        with status.track_runs():
            run = open_run(run_cfg, job, label)
            for name, image in images():
                write_image(run.folder / "images" / name, image)
            run.finish()
    return run.folder / "images"
