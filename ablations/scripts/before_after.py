"""``gaussian-enhancer before_after``: a strip of raw render, enhanced view and photo, a magnified crop under each.

The run is the folder of a finished job ``enhance``. The view has the median gain of PSNR. The crop is where the
enhancement changes the render most, for better or worse, or where the raw render has the largest error, so neither is
chosen to favour the enhancement. The caption is printed and stored in the file's metadata.

Axes: h height, w width.
"""

import itertools
from dataclasses import dataclass
from pathlib import Path

import torch.nn.functional as F
from jaxtyping import Float
from omegaconf import DictConfig
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor

from ablations.study.methods import name_of
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import atomic_write
from gaussian_enhancer.input_files import read_configuration
from gaussian_enhancer.metrics.image_quality import psnr
from gaussian_enhancer.runs.instantiate import require
from gaussian_enhancer.scene.image_files import to_bytes
from gaussian_enhancer.scene.photos import images_by_stem, read_photo
from gaussian_enhancer.scene.renders import run_steps

PARTS = ("renders", "enhanced", "gt")
CROP = 4
"""Side of the view over that of the crop."""
GAP, BAND = 6, 22
"""Pixels between images, and of the line of text over them."""
DESCRIPTION = 0x010E
"""EXIF tag ImageDescription."""


@dataclass(frozen=True)
class Compared:
    """A held-out view, in 8 bits.

    Args:
        name: the view's file name without its ending.
        step: training step of the fit that was rendered.
        raw: the splat's render.
        enhanced: the enhanced view.
        photo: the held-out photo.
    """

    name: str
    step: int
    raw: Float[Tensor, "3 h w"]
    enhanced: Float[Tensor, "3 h w"]
    photo: Float[Tensor, "3 h w"]

    @property
    def decibels(self) -> tuple[float, float]:
        """PSNR of the raw and of the enhanced view."""
        return psnr(self.raw, self.photo), psnr(self.enhanced, self.photo)

    @property
    def gain(self) -> float:
        """What enhancement adds to PSNR, dB."""
        before, after = self.decibels
        return after - before


def read_views(run: Path) -> list[Compared]:
    """The views of an enhance run, by name.

    Raises:
        InputError: the folder holds no enhanced views with photos.
    """
    steps = run_steps(run)
    if not steps or not (run / f"test/ours_{steps[-1]}/enhanced").is_dir():
        raise InputError(run, "holds no enhanced views", "give the folder of a job enhance without output=")
    step = steps[-1]
    files = [images_by_stem(run / f"test/ours_{step}" / part) for part in PARTS]
    names = sorted(files[PARTS.index("enhanced")])
    for name, part in itertools.product(names, files):
        if name not in part:
            raise InputError(run, f"holds no render or no photo of {name}", "enhance it again, with its photos")
    return [Compared(name, step, *(read_photo(part[name]) for part in files)) for name in names]


def median_gain(views: list[Compared]) -> Compared:
    """The view with the median gain; the lower of the two middle views if their number is even."""
    return sorted(views, key=lambda view: view.gain)[(len(views) - 1) // 2]


def changed_block(view: Compared) -> tuple[int, int, int, int]:
    """The crop that the enhancement changes most, for better or worse."""
    return _largest(_squared_error(view.enhanced, view.raw))


def worst_block(view: Compared) -> tuple[int, int, int, int]:
    """The crop in which the raw render's mean squared error is largest."""
    return _largest(_squared_error(view.raw, view.photo))


def harmed_block(view: Compared) -> tuple[int, int, int, int]:
    """The crop with the largest increase, or the smallest decrease, of squared error by the enhancement."""
    return _largest(_squared_error(view.enhanced, view.photo) - _squared_error(view.raw, view.photo))


CROPS = {
    "changed": (changed_block, "where enhancement changes the render most"),
    "worst": (worst_block, "where the raw render is worst"),
}
"""What a picture magnifies, with the words of its caption, by the value of the option ``crop``."""


def _squared_error(image: Float[Tensor, "3 h w"], other: Float[Tensor, "3 h w"]) -> Float[Tensor, "h w"]:
    return (image - other).square().mean(dim=0)


def _largest(values: Float[Tensor, "h w"]) -> tuple[int, int, int, int]:
    """Left, top, right and bottom of the crop with the largest mean."""
    height, width = (side // CROP for side in values.shape)
    means = F.avg_pool2d(values[None, None], (height, width), stride=1)[0, 0]
    row, column = divmod(int(means.argmax()), means.shape[1])
    return column, row, column + width, row + height


def caption(views: list[Compared], shown: Compared, splat: str, capture: str, weights: str, crop: str) -> str:
    """Caption of the picture: capture, fit, gain, and how view and crop were chosen."""
    before, after = shown.decibels
    mean = sum(view.gain for view in views) / len(views)
    return (
        f"Held-out view of a real capture ({capture}), {splat} fitted for {shown.step:,} steps, weights {weights}: "
        f"{before:.2f} dB raw, {after:.2f} dB enhanced ({after - before:+.2f} dB; mean of the {len(views)} held-out "
        f"views {mean:+.2f} dB). The view has the median gain; the crop is {CROPS[crop][1]}."
    )


def strip(view: Compared, box: tuple[int, int, int, int]) -> Image.Image:
    """Raw, enhanced and photo side by side; under each a crop, magnified to the view's size.

    Args:
        view: what is shown.
        box: left, top, right and bottom of the crop.
    """
    before, after = view.decibels
    titles = (f"raw render  {before:.2f} dB", f"enhanced  {after:.2f} dB", "photo (held out)")
    pictures = [Image.fromarray(to_bytes(image)) for image in (view.raw, view.enhanced, view.photo)]
    width, height = pictures[0].size
    sheet = Image.new("RGB", (3 * width + 2 * GAP, BAND + 2 * height + GAP), "white")
    draw = ImageDraw.Draw(sheet)
    for column, (title, picture) in enumerate(zip(titles, pictures, strict=True)):
        left = column * (width + GAP)
        draw.text((left + 2, 3), title, fill="black", font=ImageFont.load_default(14))
        sheet.paste(picture, (left, BAND))
        corners = (left + box[0] - 1, BAND + box[1] - 1, left + box[2], BAND + box[3])
        draw.rectangle(corners, outline=(255, 210, 0), width=2)
        crop = picture.crop(box).resize((width, height), Image.Resampling.NEAREST)
        sheet.paste(crop, (left, BAND + height + GAP))
    return sheet


def used_weights(run: Path) -> str:
    """Name of the weights of an enhance run, see `name_of`.

    Raises:
        InputError: its configuration names none.
    """
    values = read_configuration(run / "config.yaml")
    if "weights" not in values:
        raise InputError(run / "config.yaml", "names no weights", "give the folder of a finished job enhance")
    return name_of(str(values["weights"]))


def run(cfg: DictConfig) -> None:
    """Write the picture and print its caption.

    Args:
        cfg: conf/before_after.yaml, composed.

    Raises:
        InputError: the run holds no enhanced views with photos, or the picture cannot be written.
    """
    require(cfg)
    folder = Path(cfg.run)
    views = read_views(folder)
    shown = median_gain(views)
    text = caption(views, shown, cfg.method, cfg.capture or folder.name, used_weights(folder), cfg.crop)
    find_crop, _ = CROPS[cfg.crop]
    write_picture(cfg.output, strip(shown, find_crop(shown)), text, cfg.quality)
    print(text)


def write_picture(path: str | Path, picture: Image.Image, text: str, quality: int = 88) -> None:
    """Write a JPEG that holds its caption as its description.

    Args:
        path: the file.
        picture: what is shown.
        text: the caption.
        quality: of the JPEG, 1 to 95.

    Raises:
        InputError: it cannot be written.
    """
    exif = Image.Exif()
    exif[DESCRIPTION] = text
    with atomic_write(path) as temporary:
        picture.save(temporary, format="JPEG", quality=quality, subsampling=0, optimize=True, exif=exif)
