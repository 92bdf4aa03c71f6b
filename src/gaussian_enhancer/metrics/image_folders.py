"""Matching of images on disk with their photos, and measurement of their quality as records.

File names and sizes are checked, from the file headers, before any pixels are read.
"""

import hashlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.metrics.lpips import PerceptualDistance
from gaussian_enhancer.metrics.pair import PROTOCOL, measure_pair
from gaussian_enhancer.metrics.records import Record
from gaussian_enhancer.scene.photos import images_by_stem, read_coverage, read_header, read_photo
from gaussian_enhancer.scene.renders import choose_step


@dataclass(frozen=True)
class Label:
    """Description of a set of images, for their records.

    Args:
        run: the run's name.
        scene: the scene's name.
        splat: how the renders were made.
        variant: "raw", "enhanced", or a method's name.
    """

    run: str
    scene: str
    splat: str
    variant: str


@dataclass(frozen=True)
class ImageFiles:
    """An image on disk with the photo that it is compared with.

    Args:
        label: description of the image in the record.
        image: the image to measure.
        photo: the ground truth.
        mask: coverage of the object, from an image's alpha channel or a grey image; None for the whole image.
    """

    label: Label
    image: Path
    photo: Path
    mask: Path | None = None


def pair_folders(
    images: str | Path,
    photos: str | Path,
    label: Label,
    *,
    masks: str | Path | None = None,
    unmatched: str = "refuse",
) -> tuple[ImageFiles, ...]:
    """Match a folder of images with a folder of photos by file name without ending.

    Photos without an image are ignored, because a capture has more photos than the held-out ones.

    Args:
        images: folder of images to measure.
        photos: folder of their photos.
        label: description of the images in the records.
        masks: folder of masks of the object's coverage, with the same file names.
        unmatched: what to do with an image that has no photo: "refuse" or "drop".

    Raises:
        InputError: a folder is empty, an image has no photo or mask, or sizes differ.
    """
    if unmatched not in ("refuse", "drop"):
        raise InputError("unmatched", f"is {unmatched!r}", "use refuse or drop")
    image_files, photo_files = images_by_stem(Path(images)), images_by_stem(Path(photos))
    mask_files = images_by_stem(Path(masks)) if masks is not None else {}
    without_photo = [path for stem, path in image_files.items() if stem not in photo_files]
    if len(without_photo) == len(image_files):
        raise InputError(images, f"shares no file name with {photos}", "name the folder of these images' photos")
    if without_photo and unmatched == "refuse":
        received = f"has no photo in {photos} ({len(without_photo)} of {len(image_files)} images have none)"
        raise InputError(without_photo[0], received, "add the photo, or pass unmatched=drop")
    pairs = []
    for stem in sorted(image_files.keys() & photo_files.keys()):
        if masks is not None and stem not in mask_files:
            raise InputError(masks, f"has no mask for {image_files[stem].name}", "add it or leave masks out")
        _check_sizes(image_files[stem], photo_files[stem], mask_files.get(stem))
        pairs.append(ImageFiles(label, image_files[stem], photo_files[stem], mask_files.get(stem)))
    return tuple(pairs)


def pair_run(
    folder: str | Path, step: int | None = None, *, scene: str = "", splat: str = ""
) -> tuple[ImageFiles, ...]:
    """The held-out images of a run in 3DGS's layout: ``test/ours_<step>/{renders,enhanced}`` against ``gt``.

    Args:
        folder: the run's folder.
        step: training step of the renders; None takes the latest.
        scene: the scene's name in the records; if empty, the folder's name.
        splat: how the renders were made; if empty, ``ours_<step>``.

    Raises:
        InputError: the folder has no such renders or no photos, or `pair_folders` raises it.
    """
    root = Path(folder)
    chosen_step = choose_step(root, step)
    step_folder = root / "test" / f"ours_{chosen_step}"
    if not (step_folder / "gt").is_dir():
        raise InputError(step_folder, "has no gt photos to measure against", "render the run again with its photos")
    name = root.resolve().name
    files: list[ImageFiles] = []
    for subfolder, variant in (("renders", "raw"), ("enhanced", "enhanced")):
        if (step_folder / subfolder).is_dir():
            label = Label(name, scene or name, splat or f"ours_{chosen_step}", variant)
            files += pair_folders(step_folder / subfolder, step_folder / "gt", label)
    return tuple(files)


def measure_files(
    files: Iterable[ImageFiles],
    distances: Sequence[PerceptualDistance] = (),
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Iterator[Record]:
    """Measure images one after the other, and yield a record for each.

    Args:
        files: images and their photos.
        distances: LPIPS distances to measure as well.
        background: colour under transparent images and photos.

    Raises:
        InputError: a file cannot be decoded.
    """
    for entry in files:
        image, photo = read_photo(entry.image, background), read_photo(entry.photo, background)
        mask = read_coverage(entry.mask) if entry.mask is not None else None
        measured = measure_pair(image, photo, distances, mask)
        yield Record(
            kind="quality",
            run=entry.label.run,
            scene=entry.label.scene,
            splat=entry.label.splat,
            view=entry.image.name,
            variant=entry.label.variant,
            metrics=measured.metrics,
            reasons=measured.reasons,
            size=(image.shape[2], image.shape[1]),
            protocol=PROTOCOL,
            photo=image_digest(photo),
        )


def image_digest(image: Tensor) -> str:
    """Digest of an image's 8-bit pixels, so that records tell whether two measurements had the same photo.

    Args:
        image: (3, h, w), values from 0 to 1.

    Returns:
        12 hexadecimal digits of SHA-256.
    """
    pixels = (255 * image).round().to(torch.uint8).contiguous()
    return hashlib.sha256(str(tuple(pixels.shape)).encode() + pixels.numpy().tobytes()).hexdigest()[:12]


def _check_sizes(image: Path, photo: Path, mask: Path | None) -> None:
    expected = read_header(image)
    for path in (photo, mask):
        if path is None:
            continue
        header = read_header(path)
        if (header.height, header.width) != (expected.height, expected.width):
            received = f"is {header.width}x{header.height} where {image} is {expected.width}x{expected.height}"
            raise InputError(path, received, "bring both to one size")
