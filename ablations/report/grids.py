"""Grids of images as in the paper's figures 5 to 7: one row per scene, one column per method, the photo last.

The paper's figures 5 and 6 show renders of several splats beside the results of GE and GE++ and the photo; figure 7
shows details with artefacts before and after. Here each row shows the whole photo with a frame, and the crop within
the frame in every column.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from PIL import Image, ImageChops, ImageDraw, ImageFont, ImageStat, UnidentifiedImageError

from ablations.study.description import TableDescription
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import atomic_write

PHOTO = "photo"
"""Key of the photo among the images of a scene."""

Box = tuple[float, float, float, float]
"""Left, top, right and bottom, as shares of width and height."""

Picture = Image.Image
SHARE, STEPS = 1 / 3, 9
"""Side of a crop as a share of the image's side, and its tried positions per axis."""
GAP, LINE = 8, 20
PAPER, INK, FRAME, NONE = (255, 255, 255), (30, 30, 30), (220, 30, 30), (225, 225, 225)


def write_grid(
    path: Path,
    table: TableDescription,
    images: Mapping[tuple[str, str], Path],
    height: int = 192,
    boxes: Mapping[str, Box] | None = None,
) -> Path:
    """Write a grid of labelled crops as PNG, atomically.

    The crop of a row is where the baseline differs most from the photo (mean absolute difference), and the same in
    every column, whatever its resolution. It shows the largest artefacts, not average ones. Without baseline or photo
    it is the middle. A scene or method without an image has a grey tile that says so.

    Args:
        path: the PNG.
        table: its methods are the columns, in its order; the scenes of its datasets come first, in their order.
        images: image files by scene and method, the photo under `PHOTO`.
        height: of a crop in the grid, pixels.
        boxes: crops by scene, for scenes that shall not show the largest error.

    Returns:
        The path of the file.

    Raises:
        InputError: an image cannot be read, a key names no method, there is no image at all, or the file cannot be
            written.
    """
    columns = {name: method.title for name, method in table.methods.items()} | {PHOTO: "photo"}
    unknown = sorted({method for _, method in images} - set(columns))
    if unknown or not images:
        received = f"names the method {unknown[0]!r}" if unknown else "has no image"
        raise InputError(path, received, f"give images of {', '.join(columns)}")
    dataset_scenes = [scene for dataset in table.datasets.values() for scene in dataset.scenes]
    scenes = list(dict.fromkeys([*dataset_scenes, *(scene for scene, _ in images)]))
    given_boxes = boxes or {}
    lines = [_line(scene, table.baseline, columns, images, height, given_boxes.get(scene)) for scene in scenes]
    with atomic_write(path) as temporary:
        _assemble_grid(lines, scenes, ["view", *columns.values()]).save(temporary, "PNG")
    return path


def crop_box(render: Picture, photo: Picture) -> Box:
    """The box where a render differs most from its photo, of `STEPS` x `STEPS` evenly spaced boxes.

    Args:
        render: the render.
        photo: the ground truth; resized to the render's size.
    """
    resized_photo = photo if photo.size == render.size else photo.resize(render.size, Image.Resampling.BOX)
    difference = ImageChops.difference(render, resized_photo)
    starts = [(1 - SHARE) * step / (STEPS - 1) for step in range(STEPS)]
    boxes = [(left, top, left + SHARE, top + SHARE) for top in starts for left in starts]
    return max(boxes, key=lambda box: sum(ImageStat.Stat(difference.crop(_pixels(box, render))).mean))


def _line(
    scene: str,
    baseline: str,
    columns: Mapping[str, str],
    images: Mapping[tuple[str, str], Path],
    height: int,
    requested_box: Box | None,
) -> list[Picture]:
    """A scene's tiles: the whole view with a frame, then the crop of every column."""
    pictures = {method: _read(images[scene, method]) for method in columns if (scene, method) in images}
    photo, baseline_image = pictures.get(PHOTO), pictures.get(baseline)
    middle = ((1 - SHARE) / 2, (1 - SHARE) / 2, (1 + SHARE) / 2, (1 + SHARE) / 2)
    default_box = crop_box(baseline_image, photo) if photo is not None and baseline_image is not None else middle
    box = default_box if requested_box is None else requested_box
    overview = photo if photo is not None else next(iter(pictures.values()), None)
    width = height if overview is None else max(1, round(height * overview.width / overview.height))
    tiles = [_missing((width, height)) if overview is None else _framed(overview, box, (width, height))]
    for method in columns:
        picture = pictures.get(method)
        tiles.append(_missing((width, height)) if picture is None else _cropped(picture, box, (width, height)))
    return tiles


def _read(path: Path) -> Picture:
    try:
        with Image.open(path) as picture:
            return picture.convert("RGB")
    except FileNotFoundError:
        raise InputError(path, "does not exist", "make the table again") from None
    except (OSError, UnidentifiedImageError) as error:
        raise InputError(path, f"is no readable image ({error})", "make the table again") from None


def _pixels(box: Box, picture: Picture) -> tuple[int, int, int, int]:
    """A box in pixels, at least one pixel wide and high."""
    left, top = int(box[0] * picture.width), int(box[1] * picture.height)
    right, bottom = round(box[2] * picture.width), round(box[3] * picture.height)
    return left, top, max(left + 1, right), max(top + 1, bottom)


def _cropped(picture: Picture, box: Box, size: tuple[int, int]) -> Picture:
    """A crop resized to a tile: upscaled without smoothing, so that pixels stay visible; downscaled by Lanczos."""
    crop = picture.crop(_pixels(box, picture))
    larger = crop.width > size[0] or crop.height > size[1]
    return crop.resize(size, Image.Resampling.LANCZOS if larger else Image.Resampling.NEAREST)


def _framed(picture: Picture, box: Box, size: tuple[int, int]) -> Picture:
    tile = picture.resize(size, Image.Resampling.LANCZOS)
    left, top, right, bottom = _pixels(box, tile)
    ImageDraw.Draw(tile).rectangle((left, top, right - 1, bottom - 1), outline=FRAME, width=2)
    return tile


def _missing(size: tuple[int, int]) -> Picture:
    tile = Image.new("RGB", size, NONE)
    ImageDraw.Draw(tile).text((size[0] / 2, size[1] / 2), "missing", fill=INK, font=_font(), anchor="mm")
    return tile


def _assemble_grid(lines: Sequence[Sequence[Picture]], names: Sequence[str], titles: Sequence[str]) -> Picture:
    """The grid of tiles, with a title above each column and the scene's name above each row."""
    widths = [max(line[column].width for line in lines) for column in range(len(titles))]
    lefts = [GAP + sum(widths[:column]) + GAP * column for column in range(len(titles))]
    tops = list(_tops(lines))
    grid = Image.new("RGB", (lefts[-1] + widths[-1] + GAP, tops[-1] + lines[-1][0].height + GAP), PAPER)
    draw = ImageDraw.Draw(grid)
    for left, width, title in zip(lefts, widths, titles, strict=True):
        draw.text((left, GAP), _fitting(title, width), fill=INK, font=_font())
    for top, line, name in zip(tops, lines, names, strict=True):
        draw.text((GAP, top - LINE + 2), name, fill=INK, font=_font())
        for left, tile in zip(lefts, line, strict=True):
            grid.paste(tile, (left, top))
    return grid


def _tops(lines: Sequence[Sequence[Picture]]) -> Iterator[int]:
    """The top of each row's tiles, below its name."""
    top = GAP + LINE
    for line in lines:
        top += LINE
        yield top
        top += line[0].height + GAP


def _fitting(title: str, width: int) -> str:
    """A title, shortened to the width of its column."""
    while len(title) > 1 and _font().getlength(title) > width:
        title = title[:-2] + "…"
    return title


def _font() -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(13)
