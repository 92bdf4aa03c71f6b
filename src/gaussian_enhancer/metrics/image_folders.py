"""Matching of images on disk with their photos, and measuring them as records.

Everything that can be known from names and file headers is checked before the first pixel is read.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.metrics.lpips import PerceptualDistance
from gaussian_enhancer.metrics.pair import PROTOCOL, measure_pair
from gaussian_enhancer.metrics.records import Record
from gaussian_enhancer.scene.photos import list_images, read_coverage, read_header, read_photo
from gaussian_enhancer.scene.renders import run_steps


@dataclass(frozen=True)
class Label:
    """A record's description of the images that it measures.

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
        label: what the record says of it.
        image: what is judged.
        photo: the truth.
        mask: coverage of the object: the alpha channel of an image, or a grey image; None for the whole image.
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

    Photos without an image are left alone: a capture holds more photos than those that were held out.

    Args:
        images: folder of images to judge.
        photos: folder of their photos.
        label: what the records say.
        masks: folder of the object's coverage, by the same names.
        unmatched: what to do with an image that has no photo: "refuse" or "drop".

    Raises:
        InputError: a folder is empty, an image has no photo or mask, or sizes differ.
    """
    if unmatched not in ("refuse", "drop"):
        raise InputError("unmatched", f"is {unmatched!r}", "use refuse or drop")
    files, truths = _by_stem(images), _by_stem(photos)
    coverage = _by_stem(masks) if masks is not None else {}
    lonely = [path for stem, path in files.items() if stem not in truths]
    if len(lonely) == len(files):
        raise InputError(images, f"shares no file name with {photos}", "name the folder of these images' photos")
    if lonely and unmatched == "refuse":
        received = f"has no photo in {photos} ({len(lonely)} of {len(files)} images have none)"
        raise InputError(lonely[0], received, "add the photo, or pass unmatched=drop")
    found = []
    for stem in sorted(files.keys() & truths.keys()):
        if masks is not None and stem not in coverage:
            raise InputError(masks, f"has no mask for {files[stem].name}", "add it or leave masks out")
        _check_sizes(files[stem], truths[stem], coverage.get(stem))
        found.append(ImageFiles(label, files[stem], truths[stem], coverage.get(stem)))
    return tuple(found)


def pair_run(
    folder: str | Path, step: int | None = None, *, scene: str = "", splat: str = ""
) -> tuple[ImageFiles, ...]:
    """The held-out images of a run in 3DGS's layout: ``test/ours_<step>/{renders,enhanced}`` against ``gt``.

    Args:
        folder: the run's folder.
        step: training step of the renders; the latest where None.
        scene: the scene's name in the records; the folder's name where empty.
        splat: how the renders were made; ``ours_<step>`` where empty.

    Raises:
        InputError: the folder has no such renders or no photos, or what `pair_folders` raises.
    """
    root = Path(folder)
    if not root.is_dir():
        raise InputError(root, "is no folder", "name a run's folder")
    steps = run_steps(root)
    if not steps:
        raise InputError(root, "holds no test/ours_<step>/renders", "name a run's folder with held-out renders")
    if step is not None and step not in steps:
        raise InputError(root, f"has no renders of step {step}", f"choose one of {', '.join(map(str, steps))}")
    chosen = steps[-1] if step is None else step
    side = root / "test" / f"ours_{chosen}"
    if not (side / "gt").is_dir():
        raise InputError(side, "has no gt photos to measure against", "render the run again with its photos")
    name = root.resolve().name
    found: list[ImageFiles] = []
    for part, variant in (("renders", "raw"), ("enhanced", "enhanced")):
        if (side / part).is_dir():
            label = Label(name, scene or name, splat or f"ours_{chosen}", variant)
            found += pair_folders(side / part, side / "gt", label)
    return tuple(found)


def measure_files(
    files: Iterable[ImageFiles],
    distances: Sequence[PerceptualDistance] = (),
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Iterator[Record]:
    """Measure images one after the other, a record each.

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
        )


def _by_stem(folder: str | Path) -> dict[str, Path]:
    """A folder's images by name without ending, which must be unique."""
    found: dict[str, Path] = {}
    for path in list_images(Path(folder)):
        if path.stem in found:
            raise InputError(path, f"has the name of {found[path.stem].name}", "keep one image of each name")
        found[path.stem] = path
    return found


def _check_sizes(image: Path, photo: Path, mask: Path | None) -> None:
    expected = read_header(image)
    for other in (photo, mask):
        if other is None:
            continue
        header = read_header(other)
        if (header.height, header.width) != (expected.height, expected.width):
            received = f"is {header.width}x{header.height} where {image} is {expected.width}x{expected.height}"
            raise InputError(other, received, "bring both to one size")
