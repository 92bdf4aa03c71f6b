"""Camera estimation by structure from motion: COLMAP's incremental mapping, run through pycolmap.

Source: Schoenberger and Frahm, Structure-from-Motion Revisited, CVPR 2016.
"""

import itertools
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.image_files import write_image
from gaussian_enhancer.scene.photos import resize
from gaussian_enhancer.scene.undistort import load_pycolmap

MAX_SIDE = 1200
"""Maximum longer side of an image in pixels; larger images are downscaled first. 1200 takes a third of 1600's time."""
PAIRS_PER_CALL = 400
"""Image pairs matched per call. Each call rebuilds the index of its images' features, and cannot be interrupted."""
SEED = 0
MIN_IMAGES = 3
"""Minimum number of images of a model; smaller models are discarded."""
LENSES = {True: "SIMPLE_PINHOLE", False: "SIMPLE_RADIAL"}
"""COLMAP's camera model of images without lens distortion (True) and of other images (False)."""

ProgressCallback = Callable[[str, int, int], None]
"""Progress callback: name of the step, number of finished items, total number of items."""


@dataclass(frozen=True)
class UnposedImage:
    """An image whose camera is to be estimated.

    Args:
        name: unique file name in the model. It ends in .png and has no spaces, which separate the names in COLMAP's
            lists of pairs.
        read: returns the pixels, [0, 1].
        ideal: whether the image has no lens distortion, such as a render or an undistorted photo.
        render: whether the image is a render. Renders are matched with photos only, since features that two renders
            share may be errors of the splat.
    """

    name: str
    read: Callable[[], Float[Tensor, "3 _ _"]]
    ideal: bool
    render: bool


def reconstruct(images: Sequence[UnposedImage], folder: Path, progress: ProgressCallback | None = None) -> bool:
    """Estimate the cameras of images and write them as a COLMAP model; return whether a model was found.

    Images of equal size share one set of intrinsics: the focal length and, unless the images are ``ideal``, one
    coefficient of radial distortion. Ideal images share no intrinsics with others. Intrinsics refer to the images as
    downscaled to `MAX_SIDE`. If mapping yields several models, the largest is kept. Random seeds are fixed.

    Args:
        images: renders and photos.
        folder: output folder of ``cameras.bin``, ``images.bin`` and ``points3D.bin``; images that could not be
            registered are not listed.
        progress: progress callback.

    Raises:
        InputError: an image cannot be read, or the folder cannot be written.
    """
    report = progress or (lambda part, done, total: None)
    pycolmap = load_pycolmap()
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder, prefix=".work-") as name, _quiet_log(pycolmap):
        work = Path(name)
        pycolmap.set_random_seed(SEED)
        try:
            _extract(pycolmap, images, work, report)
            _match(pycolmap, images, work, report)
            model = _map_incrementally(pycolmap, len(images), work, report)
            if model is not None:
                model.write_binary(str(folder))
        except RuntimeError as error:  # the system refused to write COLMAP's files
            reason = f"structure from motion: {str(error).splitlines()[0] if str(error) else type(error).__name__}"
            received = f"cannot be written ({reason})"
            raise InputError(folder, received, "free some space or choose another folder") from error
    return model is not None


def _extract(pycolmap: ModuleType, images: Sequence[UnposedImage], work: Path, report: ProgressCallback) -> None:
    """Write each image and extract its features; images of one size and kind share the camera of the first of them."""
    camera_ids: dict[tuple[tuple[int, ...], bool], int] = {}
    with pycolmap.Database.open(work / "database.db"):
        pass
    for number, image in enumerate(images):
        pixels = image.read()
        scale = min(1.0, MAX_SIDE / max(pixels.shape[-2:]))
        resized = resize(pixels, *(max(1, round(side * scale)) for side in pixels.shape[-2:]))
        write_image(work / image.name, resized)
        group = (tuple(pixels.shape), image.ideal)
        options = pycolmap.ImageReaderOptions(camera_model=LENSES[image.ideal])
        options.existing_camera_id = camera_ids.get(group, -1)
        pycolmap.extract_features(
            work / "database.db",
            work,
            image_names=[image.name],
            camera_mode=pycolmap.CameraMode.SINGLE,
            reader_options=options,
        )
        if group not in camera_ids:
            with pycolmap.Database.open(work / "database.db") as database:
                camera_ids[group] = database.read_image_with_name(image.name).camera_id
        report("features", number + 1, len(images))


def _match(pycolmap: ModuleType, images: Sequence[UnposedImage], work: Path, report: ProgressCallback) -> None:
    """Match each photo with all earlier photos and each render with all photos; verify the pairs' two-view geometry."""
    photos = [image for image in images if not image.render]
    verification_settings = pycolmap.TwoViewGeometryOptions()
    verification_settings.ransac.random_seed = SEED
    pairing_settings = pycolmap.ImportedPairingOptions()
    pairing_settings.match_list_path = work / "pairs.txt"
    pairs = [(first, second) for i, first in enumerate(photos) for second in photos[:i]]
    pairs += [(image, photo) for image in images if image.render for photo in photos]
    for start in range(0, len(pairs), PAIRS_PER_CALL):
        lines = [f"{first.name} {second.name}\n" for first, second in pairs[start : start + PAIRS_PER_CALL]]
        (work / "pairs.txt").write_text("".join(lines), encoding="utf-8")
        pycolmap.match_image_pairs(
            work / "database.db", pairing_options=pairing_settings, verification_options=verification_settings
        )
        report("matches", start + len(lines), len(pairs))


def _map_incrementally(pycolmap: ModuleType, count: int, work: Path, report: ProgressCallback) -> Any:
    """The largest model found by incremental mapping; None if there is none."""
    options = pycolmap.IncrementalPipelineOptions()
    options.min_model_size, options.num_threads, options.random_seed = MIN_IMAGES, 1, SEED
    options.mapper.random_seed = options.triangulation.random_seed = SEED
    options.structure_less_registration_fallback = False  # such poses have no points and are unfit for warping photos
    image_counter = itertools.count(1)
    models = pycolmap.incremental_mapping(
        work / "database.db",
        work,
        work / "sparse",
        options,
        next_image_callback=lambda: report("cameras", min(next(image_counter), count), count),
    )
    return max(models.values(), key=lambda model: model.num_reg_images(), default=None)


@contextmanager
def _quiet_log(pycolmap: ModuleType) -> Iterator[None]:
    """Keep glog from logging every step to standard error."""
    previous_level = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = pycolmap.logging.Level.FATAL.value
    try:
        yield
    finally:
        pycolmap.logging.minloglevel = previous_level
