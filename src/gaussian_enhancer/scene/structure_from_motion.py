"""Cameras of images by structure from motion: COLMAP's incremental mapping, by pycolmap.

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

LONGEST = 1200
"""Pixels of an image's longer side; larger ones are made smaller first, which takes a third of the time of 1600."""
TOGETHER = 400
"""Pairs that one call matches: each call indexes its images' features anew, and cannot be interrupted."""
SEED = 0
FEWEST = 3
"""Images of the smallest model that is kept."""
LENSES = {True: "SIMPLE_PINHOLE", False: "SIMPLE_RADIAL"}
"""COLMAP's camera model of images without lens distortion, and of others."""

Told = Callable[[str, int, int], None]
"""Progress callback: the name of the step, and how many of its parts are done, of how many."""


@dataclass(frozen=True)
class UnposedImage:
    """An image whose camera is looked for.

    Args:
        name: of its file in the model, unique, ending in .png, without spaces, by which COLMAP divides lists of pairs.
        read: returns the pixels, [0, 1].
        ideal: it has no lens distortion, as renders and undistorted photos.
        render: it is a render. Renders are matched with photos alone: what they share with each other may be the
            splat's errors.
    """

    name: str
    read: Callable[[], Float[Tensor, "3 _ _"]]
    ideal: bool
    render: bool


def reconstruct(images: Sequence[UnposedImage], folder: Path, progress: Told | None = None) -> bool:
    """Find the cameras of images and write them as a COLMAP model; whether any were found.

    Images of one size share one set of intrinsics: focal length, and where their lens may distort, one coefficient of
    radial distortion; those that do not share none with those that may. They are of the size that images were brought
    to (`LONGEST`). Of several models the largest is kept. Random choices have a fixed seed.

    Args:
        images: renders and photos.
        folder: takes ``cameras.bin``, ``images.bin``, ``points3D.bin``; images that found no place are not listed.
        progress: told how far the work is.

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
        except RuntimeError as error:  # COLMAP's files are refused by the system
            reason = f"structure from motion: {str(error).splitlines()[0] if str(error) else type(error).__name__}"
            received = f"cannot be written ({reason})"
            raise InputError(folder, received, "free some space or choose another folder") from error
    return model is not None


def _extract(pycolmap: ModuleType, images: Sequence[UnposedImage], work: Path, told: Told) -> None:
    """Write each image and find its features; the first of a size brings the intrinsics that others share."""
    shared: dict[tuple[tuple[int, ...], bool], int] = {}
    with pycolmap.Database.open(work / "database.db"):
        pass
    for number, image in enumerate(images):
        pixels = image.read()
        shrink = min(1.0, LONGEST / max(pixels.shape[-2:]))
        small = resize(pixels, *(max(1, round(side * shrink)) for side in pixels.shape[-2:]))
        write_image(work / image.name, small)
        group = (tuple(pixels.shape), image.ideal)
        options = pycolmap.ImageReaderOptions(camera_model=LENSES[image.ideal])
        options.existing_camera_id = shared.get(group, -1)
        pycolmap.extract_features(
            work / "database.db",
            work,
            image_names=[image.name],
            camera_mode=pycolmap.CameraMode.SINGLE,
            reader_options=options,
        )
        if group not in shared:
            with pycolmap.Database.open(work / "database.db") as database:
                shared[group] = database.read_image_with_name(image.name).camera_id
        told("features", number + 1, len(images))


def _match(pycolmap: ModuleType, images: Sequence[UnposedImage], work: Path, told: Told) -> None:
    """Match each photo with those before it and each render with all photos, and check the pairs' geometry."""
    photos = [image for image in images if not image.render]
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = SEED
    pairing = pycolmap.ImportedPairingOptions()
    pairing.match_list_path = work / "pairs.txt"
    pairs = [(one, other) for i, one in enumerate(photos) for other in photos[:i]]
    pairs += [(image, photo) for image in images if image.render for photo in photos]
    for start in range(0, len(pairs), TOGETHER):
        lines = [f"{one.name} {other.name}\n" for one, other in pairs[start : start + TOGETHER]]
        (work / "pairs.txt").write_text("".join(lines), encoding="utf-8")
        pycolmap.match_image_pairs(work / "database.db", pairing_options=pairing, verification_options=verification)
        told("matches", start + len(lines), len(pairs))


def _map_incrementally(pycolmap: ModuleType, count: int, work: Path, told: Told) -> Any:
    """The largest model of incremental mapping; None if there is none."""
    options = pycolmap.IncrementalPipelineOptions()
    options.min_model_size, options.num_threads, options.random_seed = FEWEST, 1, SEED
    options.mapper.random_seed = options.triangulation.random_seed = SEED
    options.structure_less_registration_fallback = False  # a pose without points is none to warp photos by
    steps = itertools.count(1)
    models = pycolmap.incremental_mapping(
        work / "database.db",
        work,
        work / "sparse",
        options,
        next_image_callback=lambda: told("cameras", min(next(steps), count), count),
    )
    return max(models.values(), key=lambda model: model.num_reg_images(), default=None)


@contextmanager
def _quiet_log(pycolmap: ModuleType) -> Iterator[None]:
    """Keep glog from writing every step to standard error."""
    before = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = pycolmap.logging.Level.FATAL.value
    try:
        yield
    finally:
        pycolmap.logging.minloglevel = before
