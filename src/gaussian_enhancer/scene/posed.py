"""Construction of a `Scene` from posed image files.

The loader of each capture format supplies files, lenses and world-to-camera poses. This module validates them,
undistorts the photos to ideal pinholes, downscales them and splits them. Axes: h height, w width.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Literal

from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.photos import (
    ENDINGS,
    composite,
    decode,
    downscaled_size,
    read_coverage,
    read_header,
    refuse_unprintable,
    resize,
)
from gaussian_enhancer.scene.scene import Photo, Points, Scene
from gaussian_enhancer.scene.splits import Split
from gaussian_enhancer.scene.undistort import Lens, ideal_pinhole, undistort
from gaussian_enhancer.types import Camera, orthonormal_pose

FARTHEST_POINT = 1e15
"""Largest coordinate of a sparse point, in scene units. Squared distances overflow single precision beyond 1e19."""


@dataclass(frozen=True)
class PosedFile:
    """A photo on disk with its lens and pose.

    Args:
        listed: the photo's entry in the capture, usually a relative path; the photo's name is derived from it.
        path: the file.
        lens: intrinsics, at any size of the photo's aspect ratio.
        world_to_camera: pose in OpenCV axes, float64.
        side: the split that the capture assigns, where "neither" excludes the photo from both; None where the capture
            assigns none.
    """

    listed: str
    path: Path
    lens: Lens
    world_to_camera: Float[Tensor, "4 4"]
    side: Literal["train", "test", "neither"] | None = None


@dataclass(frozen=True)
class ReadPhoto:
    """Callable that decodes, composites, undistorts and downscales one photo. Picklable for worker processes."""

    path: Path
    height: int
    width: int
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    lens: Lens | None = None

    def __call__(self) -> Float[Tensor, "3 h w"]:
        """Read the photo, shape (3, height, width), [0, 1]."""
        image = composite(decode(self.path), self.background)
        return resize(undistort(image, self.lens) if self.lens else image, self.height, self.width)


@dataclass(frozen=True)
class ReadCoverage:
    """Callable that reads a photo's alpha channel on the pixel grid of `ReadPhoto`."""

    path: Path
    height: int
    width: int
    lens: Lens | None = None

    def __call__(self) -> Float[Tensor, "1 h w"]:
        """Read the coverage, shape (1, height, width), [0, 1]."""
        alpha = read_coverage(self.path)
        return resize(undistort(alpha, self.lens) if self.lens else alpha, self.height, self.width)


def build_scene(
    files: Sequence[PosedFile],
    *,
    source: Path,
    name: str = "",
    downscale: int | float = 1,
    split: Split | None = None,
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    points: Points | None = None,
) -> Scene:
    """Validate posed files and build a scene of them, sorted by name.

    Args:
        files: the capture's photos, in any order.
        source: path of the capture, named in errors.
        name: the scene's name; the capture folder's where empty.
        downscale: factor that divides width and height, after undistortion.
        split: how to divide the photos. Where None, the capture's own split is used or, without one, every 8th photo is
            held out.
        background: colour under transparent photos.
        points: sparse points in the same world coordinates.

    Raises:
        InputError: there are fewer than two photos, a name is used twice, a size does not match its intrinsics, or a
            pose or point is invalid.
    """
    if len(files) < 2:
        raise InputError(source, f"holds {len(files)} usable photo(s)", "give a capture of at least two posed photos")
    names = unique_names([file.listed for file in files], source)
    _check_points(points, source)
    order_by_name = sorted(range(len(files)), key=lambda i: names[i])
    red, green, blue = background
    colour = float(red), float(green), float(blue)
    photos = tuple(_photo(files[i], names[i], downscale, colour) for i in order_by_name)
    sides = [files[i].side for i in order_by_name]
    train, test = (split or Split())(len(photos), _split_of_sides(sides))
    return Scene(name or source.resolve().name, photos, train, test, colour, points)


def unique_names(listed: Sequence[str], source: Path) -> list[str]:
    """File names for photos: the last component of each path or, if those repeat, all components joined by ``_``.

    Raises:
        InputError: a name is not UTF-8 text, or two photos would get the same name or names that differ only in their
            ending, so that their outputs would overwrite each other.
    """
    paths = [PurePosixPath(text.replace("\\", "/")) for text in listed]
    for text in listed:
        refuse_unprintable(text, source)
    names = [path.name for path in paths]
    if len({PurePosixPath(n).stem for n in names}) < len(names):
        names = ["_".join(part for part in path.parts if part not in (".", "..", "/")) for path in paths]
    repeated = [stem for stem, count in Counter(PurePosixPath(n).stem for n in names).items() if count > 1]
    if repeated:
        raise InputError(source, f"lists {repeated[0]!r} more than once", "give every photo a unique name")
    return names


def path_without_ending(listed: str) -> str:
    """A listed path in normal form, without the ending of a known image format, by which entries are compared."""
    path = PurePosixPath(listed.replace("\\", "/"))
    return str(path.with_suffix("") if path.suffix.lower() in ENDINGS else path)


def _check_points(points: Points | None, source: Path) -> None:
    if points is None:
        return
    is_valid = points.positions.abs().le(FARTHEST_POINT).all(1) & points.colours.isfinite().all(1)
    if not bool(is_valid.all()):
        count, first_index = int((~is_valid).sum()), int((~is_valid).nonzero()[0])
        received = f"has {count} of {len(is_valid)} points that are not finite or too far away (first: {first_index})"
        raise InputError(source, received, "remove those points or reconstruct again")


def refuse_or_drop(names: Sequence[str], description: str, source: object, missing: str) -> None:
    """Raise an error for incomplete entries unless ``missing`` is "drop".

    Args:
        names: names of the incomplete entries.
        description: the kind of the entries, for the error.
        source: the capture, named in the error.
        missing: "error" or "drop".

    Raises:
        InputError: there are such entries and ``missing`` is "error" (the message gives their number and the first
            few), or ``missing`` has another value.
    """
    if missing not in ("error", "drop"):
        raise InputError("missing", f"is {missing!r}", 'give "error" or "drop"')
    if names and missing == "error":
        examples = ", ".join(sorted(names)[:4]) + (", ..." if len(names) > 4 else "")
        remedy = "complete the capture or pass missing=drop (on the command line scene.missing=drop)"
        raise InputError(source, f"has {len(names)} {description}: {examples}", remedy)


def lens_at_size(lens: Lens, height: int, width: int, path: Path) -> Lens:
    """The lens at the size of the photo, which may be a downscaled copy of the calibrated photo.

    Raises:
        InputError: the aspect ratios differ by more than rounding can explain.
    """
    if (lens.height, lens.width) == (height, width):
        return lens
    if not evenly_resized((height, width), (lens.height, lens.width)):
        received = f"is {width}x{height} but its camera is {lens.width}x{lens.height} ({lens.source})"
        raise InputError(path, received, "use the photos that were calibrated, whole or evenly resized")
    return lens.resized(height, width)


def evenly_resized(size: tuple[int, int], calibrated: tuple[int, int]) -> bool:
    """Whether one scale explains two sizes (height, width), with the sides of the smaller one rounded alike.

    Both sides may be rounded up, both down, or both to the nearest pixel, of a size that was rounded itself.
    """
    sides = list(zip(*sorted((size, calibrated)), strict=True))
    for down, up in ((0.0, 1.0), (1.0, 0.0), (0.75, 0.75)):
        if max((side - down) / whole for side, whole in sides) <= min((side + up) / whole for side, whole in sides):
            return True
    return False


def _split_of_sides(sides: Sequence[str | None]) -> tuple[tuple[int, ...], tuple[int, ...]] | None:
    if all(side is None for side in sides):
        return None
    train, test = (tuple(i for i, side in enumerate(sides) if side == split) for split in ("train", "test"))
    return train, test


def _photo(file: PosedFile, name: str, downscale: int | float, background: tuple[float, float, float]) -> Photo:
    header = read_header(file.path)
    lens = lens_at_size(file.lens, header.height, header.width, file.path)
    K, height, width = ideal_pinhole(lens)
    pose = orthonormal_pose(file.world_to_camera, file.listed)
    size = downscaled_size(height, width, downscale)
    camera = Camera(K.float(), pose.float(), height, width).resized(*size)
    distorted_lens = lens if lens.distorted else None
    coverage = ReadCoverage(file.path, *size, distorted_lens) if header.has_alpha else None
    return Photo(name, camera, ReadPhoto(file.path, *size, background, distorted_lens), read_alpha=coverage)
