"""Pictures for reports: error maps, contact sheets, and images embedded in a page.

Axes: h height, w width, c colours of a map, s samples, _ sizes that may differ from image to image.
"""

import base64
import io
import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from PIL import Image, ImageDraw
from torch import Tensor
from torch.nn.functional import interpolate

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.image_files import to_bytes

STOPS = (  # OKLab lightness, a, b: ink, violet, red, orange, pale yellow; lightness rises evenly
    (0.16, 0.000, -0.020),
    (0.36, 0.065, -0.110),
    (0.56, 0.165, 0.020),
    (0.76, 0.090, 0.115),
    (0.96, -0.010, 0.090),
)
EDGE = 1600
"""Longest edge in pixels of an image embedded in a page."""
SCALE_QUANTILE = 0.99
"""Share of pixels below the end of an error scale, so that single outliers do not darken all other pixels."""
GAP, TEXT_HEIGHT = 8, 18
"""Space between the images of a contact sheet, and height of a line of text, in pixels."""


def colour_map(count: int = 256) -> Float[Tensor, "c 3"]:
    """A sequential colour map of even perceptual lightness from dark to light, as sRGB in [0, 1].

    Colours are interpolated linearly in OKLab (B. Ottosson, "A perceptual color space for image processing", 2020).
    Equal differences of error therefore look equally large, on screens, in grey print and to colour-blind readers.

    Args:
        count: number of colours, at least 2.
    """
    stops = torch.tensor(STOPS, dtype=torch.float64).T[None]
    lab = interpolate(stops, size=count, mode="linear", align_corners=True)[0].T
    to_cone = torch.tensor(
        [[1.0, 0.3963377774, 0.2158037573], [1.0, -0.1055613458, -0.0638541728], [1.0, -0.0894841775, -1.2914855480]]
    ).double()
    to_linear = torch.tensor(
        [
            [4.0767416621, -3.3077115913, 0.2309699292],
            [-1.2684380046, 2.6097574011, -0.3413193965],
            [-0.0041960863, -0.7034186147, 1.7076147010],
        ]
    ).double()
    linear = ((lab @ to_cone.T) ** 3 @ to_linear.T).clamp(0, 1)
    srgb = torch.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear.clamp(min=1e-9) ** (1 / 2.4) - 0.055)
    return srgb.float()


def absolute_error(image: Float[Tensor, "3 h w"], photo: Float[Tensor, "3 h w"]) -> Float[Tensor, "h w"]:
    """Mean absolute difference over the colours, in [0, 1] for images in [0, 1]."""
    return (image.clamp(0, 1) - photo.clamp(0, 1)).abs().mean(0)


def sample_values(errors: Float[Tensor, "h w"], count: int = 20_000) -> Float[Tensor, " s"]:
    """About ``count`` evenly spaced values of a map, enough for estimating a quantile; all values of a smaller map."""
    return errors.flatten()[:: max(1, errors.numel() // count)]


def error_scale(errors: Sequence[Float[Tensor, " _"]]) -> float:
    """The error that maps to the lightest colour: a quantile over all maps that share the scale.

    Args:
        errors: values of each map, in [0, 1].

    Returns:
        The end of the scale, rounded up to a multiple of 0.01 and at least 0.02.
    """
    pooled = torch.cat(list(errors)).sort().values
    end = float(pooled[round(SCALE_QUANTILE * (len(pooled) - 1))])
    return max(0.02, math.ceil(end * 100 - 1e-6) / 100)


def apply_colour_map(values: Float[Tensor, "h w"], scale: float = 1.0) -> Float[Tensor, "3 h w"]:
    """Values as colours from dark to light; those below 0 have the darkest, those above ``scale`` the lightest colour.

    Args:
        values: one value per pixel, such as an error; values that are not finite have the lightest colour.
        scale: value that maps to the lightest colour, positive.
    """
    colours = colour_map().to(values.device)
    share = (values / scale).nan_to_num(nan=1.0, posinf=1.0, neginf=1.0).clamp(0, 1)
    return colours[(share * (len(colours) - 1)).round().long()].permute(2, 0, 1)


def data_uri(image: Float[Tensor, "3 h w"], budget: int = 600_000, edge: int = EDGE) -> str:
    """Encode an image as a ``data:`` URI, lossless if that fits the budget.

    Args:
        image: sRGB in [0, 1].
        budget: maximum bytes of the encoded image. Lossless WebP is tried first, then lower quality, then half size.
            An image whose longest edge is at most 64 pixels may exceed the budget.
        edge: longest edge in pixels; larger images are reduced.
    """
    picture = _picture(image)
    if max(picture.size) > edge:
        picture.thumbnail((edge, edge), Image.Resampling.LANCZOS)
    encoded = _webp(picture, lossless=True)
    while len(encoded) > budget:
        for quality in (95, 88, 80, 70):
            encoded = _webp(picture, quality=quality)
            if len(encoded) <= budget:
                break
        if max(picture.size) <= 64:
            break
        picture = picture.resize((max(1, picture.width // 2), max(1, picture.height // 2)), Image.Resampling.LANCZOS)
    return "data:image/webp;base64," + base64.b64encode(encoded).decode("ascii")


def _picture(image: Float[Tensor, "3 h w"]) -> Image.Image:
    """The image in 8 bits; NaN becomes black."""
    return Image.fromarray(to_bytes(image.detach().cpu().float().nan_to_num(nan=0.0)))


def _webp(picture: Image.Image, lossless: bool = False, quality: int = 50) -> bytes:
    stream = io.BytesIO()
    picture.save(stream, "WEBP", lossless=lossless, quality=quality, method=2)
    return stream.getvalue()


def contact_sheet(
    rows: Sequence[Sequence[Float[Tensor, "3 _ _"]]],
    titles: Sequence[str],
    names: Sequence[str],
    height: int = 240,
) -> Image.Image:
    """Images in rows and columns, with a title over each column and a name under each row.

    Args:
        rows: one row per view; all rows as long as ``titles``.
        titles: column titles.
        names: row names, one per row.
        height: height of an image on the sheet, in pixels.

    Raises:
        InputError: rows differ in length, or there is not one name per row.
    """
    if not rows or len(rows) != len(names) or any(len(row) != len(titles) for row in rows):
        received = f"has rows of {sorted({len(row) for row in rows})} images, {len(titles)} titles, {len(names)} names"
        raise InputError("contact sheet", received, "give every row one image a title, and a name")
    thumbnails = [[_thumbnail(image, height) for image in row] for row in rows]
    widths = [max(row[column].width for row in thumbnails) for column in range(len(titles))]
    lefts = [GAP + sum(widths[:column]) + GAP * column for column in range(len(widths))]
    tops = [2 * GAP + TEXT_HEIGHT + index * (height + TEXT_HEIGHT + GAP) for index in range(len(rows) + 1)]
    sheet = Image.new("RGB", (sum(widths) + GAP * (len(widths) + 1), tops[-1]), (250, 250, 250))
    draw = ImageDraw.Draw(sheet)
    for left, title in zip(lefts, titles, strict=True):
        draw.text((left, GAP), title, fill=(40, 40, 40))
    for top, row, name in zip(tops[:-1], thumbnails, names, strict=True):
        for left, picture in zip(lefts, row, strict=True):
            sheet.paste(picture, (left, top))
        draw.text((lefts[0], top + height + 2), name, fill=(90, 90, 90))
    return sheet


def _thumbnail(image: Float[Tensor, "3 h w"], height: int) -> Image.Image:
    picture = _picture(image)
    width = max(1, round(picture.width * height / picture.height))
    return picture.resize((width, height), Image.Resampling.LANCZOS)
