"""Images on a grid 4 times as fine as a fit's renders: photos, bicubic enlargements, the splat rendered anew.

Each folder is a content-addressed run of its own, made once for all methods that need it.
"""

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from jaxtyping import Float
from omegaconf import DictConfig, OmegaConf
from torch import Tensor

from gaussian_enhancer.network.pyramid import upsampled
from gaussian_enhancer.runs import status
from gaussian_enhancer.runs.high_resolution import HighResolutionPhotos, high_resolution_config
from gaussian_enhancer.runs.inputs import render_capture
from gaussian_enhancer.runs.instantiate import build
from gaussian_enhancer.runs.output import read_own_size
from gaussian_enhancer.runs.run import find_run, open_run
from gaussian_enhancer.runs.runtime import start
from gaussian_enhancer.scene.high_resolution import UPSCALE
from gaussian_enhancer.scene.image_files import write_image
from gaussian_enhancer.scene.photos import list_images, read_header, read_photo, resize
from gaussian_enhancer.scene.renders import read_run

Named = Iterable[tuple[str, Float[Tensor, "3 _ _"]]]
"""File names with images."""


def fine_photos(cfg: DictConfig, fit: Path) -> Path:
    """The folder of a fit's held-out photos, 4 times as fine.

    Args:
        cfg: the calling job's configuration: ``runs`` and ``runtime``.
        fit: the fit's folder.

    Raises:
        InputError: the scene has no photos that fine.
    """

    def photos() -> Named:
        for view in HighResolutionPhotos(Path(cfg.runs) / "photos")(fit, read_run(fit)).targets:
            yield view.name, read_own_size(view)

    return _kept(cfg, "fine_photos", fit.name, {"fit": str(fit)}, photos)


def bicubic(cfg: DictConfig, folder: Path, label: str, photos: Path) -> Path:
    """The folder of a folder's images, enlarged bicubically.

    Args:
        cfg: the calling job's configuration: ``runs`` and ``runtime``.
        folder: images at the render's size.
        label: a readable part of the new folder's name.
        photos: folder of the photos that they are held against, to whose size they are brought.
    """

    def images() -> Named:
        sizes = {path.stem: read_header(path) for path in list_images(photos)}
        for path in list_images(folder):
            enlarged = upsampled(read_photo(path)[None], UPSCALE)[0].clamp(0, 1)
            size = sizes.get(path.stem)
            yield path.name, enlarged if size is None else resize(enlarged, size.height, size.width)

    return _kept(cfg, "bicubic", label, {"images": str(folder)}, images)


def rendered_finer(cfg: DictConfig, fit: Path, scene: DictConfig) -> Path:
    """The folder of a fit's held-out views, rendered from its splat by 4 times as many pixels each way.

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
    return _kept(cfg, "render_finer", fit.name, values, images)


def _kept(cfg: DictConfig, job: str, label: str, values: Mapping[str, Any], images: Callable[[], Named]) -> Path:
    """The folder of a run that holds images, made where it was not made before."""
    own = OmegaConf.create({"runs": cfg.runs, **values})
    found = find_run(own, job)
    if found is None or not found.done:
        with status.attempt():
            found = open_run(own, job, label)
            for name, image in images():
                write_image(found.folder / "images" / name, image)
            found.finish()
    return found.folder / "images"
