"""Reading image files into float tensors, and resizing them with antialiasing.

EXIF orientation is not applied, since structure from motion calibrates the pixels as stored. Axes: c channels (3, or 4
with alpha), h height, w width, H and W the same after resizing.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Integer
from PIL import ExifTags, Image
from PIL.Image import Transpose
from torch import Tensor
from torch.nn import functional

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.input_files import convert_decoder_errors, reader, refuse_larger, regular_file
from gaussian_enhancer.typed import check_value

ENDINGS = (".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff", ".bmp")
FORMATS = ("PNG", "JPEG", "WEBP", "TIFF", "BMP")
"""Formats that Pillow may detect, whatever the ending; other formats call programs (EPS) or are rarely tested."""
PIXEL_BYTES = 48
"""Memory per pixel during decoding: four channels as stored, as float32 and transposed; the composited pixel."""
UNDO_ORIENTATION = {
    2: Transpose.FLIP_LEFT_RIGHT,
    3: Transpose.ROTATE_180,
    4: Transpose.FLIP_TOP_BOTTOM,
    5: Transpose.TRANSPOSE,
    6: Transpose.ROTATE_90,
    7: Transpose.TRANSVERSE,
    8: Transpose.ROTATE_270,
}
"""For each EXIF orientation the transposition that undoes Pillow's."""
REPLACE = "replace the file by an intact copy"


@dataclass(frozen=True)
class ImageHeader:
    """Size and alpha flag of an image file, read without decoding its pixels."""

    height: int
    width: int
    has_alpha: bool

    @property
    def size(self) -> tuple[int, int]:
        """Height and width."""
        return self.height, self.width


@reader
def list_images(folder: Path) -> list[Path]:
    """The image files in a folder, without subfolders, sorted by name.

    Raises:
        InputError: the folder does not exist or holds no image.
    """
    if not folder.is_dir():
        raise InputError(folder, "is no folder", "name an existing folder of images")
    files = sorted(p for p in folder.iterdir() if p.suffix.lower() in ENDINGS and not p.name.startswith("."))
    if not files:
        raise InputError(folder, "holds no image", f"name a folder with files ending in {', '.join(ENDINGS)}")
    for file in files:
        refuse_unprintable(file.name, folder)
    return files


def images_by_stem(folder: Path) -> dict[str, Path]:
    """The image files in a folder by name without ending.

    Raises:
        InputError: the folder does not exist or holds no image, or two images differ only in their ending.
    """
    images: dict[str, Path] = {}
    for path in list_images(folder):
        if path.stem in images:
            raise InputError(path, f"has the name of {images[path.stem].name}", "keep one image of each name")
        images[path.stem] = path
    return images


def refuse_unprintable(name: str, source: object) -> None:
    """Refuse a file name that is not valid UTF-8, which records and pages could not show.

    Raises:
        InputError: the name is not valid UTF-8.
    """
    if any("\ud800" <= letter <= "\udfff" for letter in name):
        raise InputError(source, f"names {name!r}, which is no UTF-8", "rename the file")


def read_header(path: Path) -> ImageHeader:
    """Read an image's size and whether it has alpha, without decoding it.

    Raises:
        InputError: the file is missing, empty, not an image, or larger than the limit.
    """
    with open_image(path) as image, convert_decoder_errors(path, REPLACE):
        width, height = image.size if _tiff_orientation(image) < 5 else image.size[::-1]
        return ImageHeader(height, width, _has_alpha(image))


def decode(path: Path) -> Float[Tensor, "c h w"]:
    """Decode an image file to [0, 1]: three channels (grey is repeated), or four if the file has alpha.

    8-bit values are divided by 255, 16-bit values by 65535. Of a TIFF with colour in 16 bits the upper 8 bits
    alone are read, since Pillow keeps no more; 16-bit PNGs and grey TIFFs are read in full.

    Raises:
        InputError: the file is missing, empty, truncated, not an image or larger than the limit, or its pixel format
            does not define the value of white.
    """
    with open_image(path) as image, convert_decoder_errors(path, REPLACE):
        is_16_bit_png = image.format == "PNG" and _is_16_bit(path)
        return _read_16_bit_png(path) if is_16_bit_png else _convert_to_float(path, image)


def composite(image: Float[Tensor, "c h w"], background: tuple[float, float, float]) -> Float[Tensor, "3 h w"]:
    """Composite an image with straight alpha over a constant colour, in sRGB as in NeRF-Synthetic's evaluation."""
    if image.shape[0] == 3:
        return image
    colour, alpha = image[:3], image[3:]
    return colour * alpha + image.new_tensor(background)[:, None, None] * (1 - alpha)


def background_colour(values: Sequence[object]) -> tuple[float, float, float]:
    """Validate a background colour for transparent images and return it as a tuple.

    Raises:
        InputError: the values are not three numbers from 0 to 1.
    """
    given = values if isinstance(values, Sequence) else ()
    numbers = [float(value) for value in given if isinstance(value, int | float) and 0 <= value <= 1]
    if len(given) != 3 or len(numbers) != 3:
        raise InputError("background", f"is {values}", "give three numbers from 0 to 1")
    return numbers[0], numbers[1], numbers[2]


def read_photo(path: Path, background: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Float[Tensor, "3 h w"]:
    """Read an image file as RGB in [0, 1], composited over ``background``.

    Raises:
        InputError: see `decode`.
    """
    return composite(decode(path), background)


def read_coverage(path: Path) -> Float[Tensor, "1 h w"]:
    """Read the alpha channel of an image file or, if it has none, its first channel (a grey mask).

    Raises:
        InputError: see `decode`.
    """
    image = decode(path)
    return image[3:] if image.shape[0] == 4 else image[:1]


def resize(image: Float[Tensor, "c h w"], height: int, width: int) -> Float[Tensor, "c H W"]:
    """Resize by bicubic resampling with antialiasing (PIL's filter without rounding to 8 bits), clamped to [0, 1]."""
    if image.shape[1:] == (height, width):
        return image
    resized = functional.interpolate(image[None], size=(height, width), mode="bicubic", antialias=True)
    return resized[0].clamp(0, 1)


def downscaled_size(height: int, width: int, downscale: int | float) -> tuple[int, int]:
    """Height and width after dividing by ``downscale`` and rounding, as 3DGS does.

    Raises:
        InputError: the factor is below 1, not finite, or leaves no pixel.
    """
    check_value(downscale, float, "downscale")
    if not downscale >= 1:
        raise InputError("downscale", f"is {downscale}", "give a factor of at least 1 (2 halves width and height)")
    size = round(height / downscale), round(width / downscale)
    if min(size) < 1:
        raise InputError("downscale", f"is {downscale} for photos of {width}x{height}", "give a smaller factor")
    return size


def open_image(path: Path) -> Image.Image:
    """Open an image file and read its header; use the result in a ``with`` block.

    Raises:
        InputError: the file is missing, empty, not an image, or larger than the limit.
    """
    file_size = regular_file(path)
    if file_size == 0:
        raise InputError(path, "is empty (0 bytes)", REPLACE)
    try:
        with convert_decoder_errors(path, REPLACE):
            image = Image.open(path, formats=FORMATS)
    except InputError as error:
        if isinstance(error.__cause__, Image.UnidentifiedImageError):
            raise InputError(path, f"is no image ({file_size} bytes)", f"{REPLACE}: {', '.join(FORMATS)}") from error
        raise
    refuse_larger(path, image.width * image.height * PIXEL_BYTES, f"is an image of {image.width}x{image.height} pixels")
    return image


def _as_stored(image: Image.Image) -> Image.Image:
    """The pixels as the file stores them. Pillow turns a TIFF by its EXIF orientation; this turns it back.

    Args:
        image: an image of `open_image`. Its pixels must not have been read, since that removes the orientation.
    """
    undo = UNDO_ORIENTATION.get(_tiff_orientation(image))
    return image if undo is None else image.transpose(undo)


def _tiff_orientation(image: Image.Image) -> int:
    """The EXIF orientation by which Pillow turns the pixels: 1 (none) to 8; from 5 on, height and width are swapped."""
    orientation = image.getexif().get(ExifTags.Base.Orientation) if image.format == "TIFF" else 1
    return orientation if orientation in UNDO_ORIENTATION else 1


def _has_alpha(image: Image.Image) -> bool:
    return "A" in image.getbands() or "transparency" in image.info


def _is_16_bit(path: Path) -> bool:
    """Whether a PNG has 16 bits per channel and colour or alpha, which PIL silently reduces to 8 bits."""
    with path.open("rb") as file:
        header = file.read(26)
    return header[24] == 16 and header[25] != 0


def _read_16_bit_png(path: Path) -> Float[Tensor, "c h w"]:
    from torchvision.io import ImageReadMode, decode_image

    data = torch.frombuffer(bytearray(path.read_bytes()), dtype=torch.uint8)
    values = decode_image(data, ImageReadMode.UNCHANGED).to(torch.int32).permute(1, 2, 0).numpy()
    if values.shape[2] == 2:
        values = values[:, :, (0, 0, 0, 1)]
    return normalise(values, 65535)


def _convert_to_float(path: Path, image: Image.Image) -> Float[Tensor, "c h w"]:
    image = _as_stored(image)
    if image.mode.startswith("I"):
        values = np.asarray(image).astype(np.int64)
        if values.min() < 0 or values.max() > 65535:
            received = f"has values {values.min()} to {values.max()}"
            raise InputError(path, received, "save it with 8 or 16 bits a channel")
        return torch.from_numpy((values / 65535).astype(np.float32)).repeat(3, 1, 1)
    if image.mode == "F":
        raise InputError(path, "has floating-point pixels, whose white is unknown", "save it as 8- or 16-bit PNG")
    mode = "RGBA" if _has_alpha(image) else "RGB"
    return normalise(np.asarray(image if image.mode == mode else image.convert(mode)), 255)


def normalise(pixels: Integer[np.ndarray, "h w c"], white: int) -> Float[Tensor, "c h w"]:
    """Divide integer pixels by the value of white, channel by channel, without an intermediate image of floats."""
    result = np.empty((pixels.shape[2], *pixels.shape[:2]), dtype=np.float32)
    for channel, plane in enumerate(result):
        np.divide(pixels[:, :, channel], np.float32(white), out=plane, dtype=np.float32)
    return torch.from_numpy(result)
