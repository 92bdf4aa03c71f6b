"""Textures with text: posters, signs, newspapers and book spines, in Pillow's scalable default font.

Axes: t texture side.
"""

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from gaussian_enhancer.scene.procedural.atlas import Texture
from gaussian_enhancer.scene.procedural.noise import Colour, fractal, random_muted_colour

PRINT_SIDE = 1024
_TEXT = (
    "the of light and field in points view scale from with ray open surface colour time depth over edge house "
    "near far sum street market coffee north station paper garden river stone letter window bread music hotel "
    "number volume sharp quiet signal harbour copper orange theory motion summer archive"
)
_WORDS = _TEXT.split()


def _rgb(colour: Colour) -> tuple[int, int, int]:
    red, green, blue = (round(255 * value) for value in colour)
    return red, green, blue


def _words(rng: np.random.Generator, count: int) -> str:
    return " ".join(rng.choice(_WORDS, count))


def _age(rng: np.random.Generator, image: Image.Image, gloss: float) -> Texture:
    """Make a texture of a printed image: yellowed, faded and stained."""
    colour = np.asarray(image, dtype=float) / 255
    stains = fractal(rng, 1.2, side=len(colour))
    fibres = fractal(rng, 0.2, side=len(colour))
    colour = 0.06 + 0.86 * colour * (0.82 + 0.3 * stains[..., None]) * (0.96 + 0.08 * fibres[..., None])
    colour = colour * np.array([1.0, 0.985, 0.95])
    ones = np.ones(colour.shape[:2])
    return Texture(np.clip(colour, 0, 1), 0.5 + 0.02 * fibres, gloss * ones, ones)


def _paragraph(
    draw: ImageDraw.ImageDraw, rng: np.random.Generator, box: tuple[int, int, int, int], size: int, ink: Colour
) -> None:
    """Fill a box (left, top, right, bottom) with lines of random words."""
    font = ImageFont.load_default(size)
    for y in range(box[1], box[3] - size, round(size * 1.3)):
        line = _words(rng, 24)
        while draw.textlength(line, font=font) > box[2] - box[0]:
            line = line.rsplit(" ", 1)[0] if " " in line else line[:-1]
        draw.text((box[0], y), line, fill=_rgb(ink), font=font)


def page(rng: np.random.Generator) -> Texture:
    """Newspaper page: a title and three columns, each with a headline, small print and a grey picture."""
    paper = random_muted_colour(rng, (0.02, 0.12), (0.8, 0.92), (0.08, 0.16))
    ink = random_muted_colour(rng, (0.0, 0.2), (0.08, 0.2))
    image = Image.new("RGB", (PRINT_SIDE, PRINT_SIDE), _rgb(paper))
    draw = ImageDraw.Draw(image)
    draw.text((40, 24), _words(rng, 2).upper(), fill=_rgb(ink), font=ImageFont.load_default(90))
    draw.line((40, 140, 984, 140), fill=_rgb(ink), width=4)
    for column in range(3):
        left, top = 40 + 320 * column, 160
        draw.text((left, top), _words(rng, 2).title(), fill=_rgb(ink), font=ImageFont.load_default(34))
        middle = int(rng.integers(360, 640))
        _paragraph(draw, rng, (left, top + 54, left + 295, middle), int(rng.integers(15, 23)), ink)
        picture = np.clip(fractal(rng, 1.1, side=256) * 1.6 - 0.3, 0, 1) * 255
        image.paste(Image.fromarray(picture.astype(np.uint8)).resize((295, 190)).convert("RGB"), (left, middle + 8))
        _paragraph(draw, rng, (left, middle + 206, left + 295, 1000), int(rng.integers(14, 20)), ink)
    return _age(rng, image, 0.3)


def poster(rng: np.random.Generator) -> Texture:
    """Poster: shapes on a plain background, three large words, and small print below."""
    background = random_muted_colour(rng)
    line_colour = random_muted_colour(rng, value=(0.4, 0.85))
    ink = random_muted_colour(rng, (0.05, 0.3), (0.08, 0.9))
    image = Image.new("RGB", (PRINT_SIDE, PRINT_SIDE), _rgb(background))
    draw = ImageDraw.Draw(image)
    for _ in range(int(rng.integers(4, 12))):
        x, y, r = (int(value) for value in rng.uniform((0, 100, 40), (1024, 900, 320)))
        kind = rng.integers(3)
        if kind == 0:
            draw.ellipse(
                (x - r, y - r, x + r, y + r), fill=_rgb(random_muted_colour(rng)), outline=_rgb(line_colour), width=8
            )
        elif kind == 1:
            draw.rectangle((x - r, y - r // 2, x + r, y + r // 2), fill=_rgb(random_muted_colour(rng)))
        else:
            for k in range(0, r, 26):
                draw.line((x - r, y - k, x + r, y - k + 40), fill=_rgb(line_colour), width=9)
    for k, size in enumerate(rng.choice([190, 150, 120, 90], 3, replace=False)):
        draw.text((50, 60 + 230 * k), _words(rng, 1).upper(), fill=_rgb(ink), font=ImageFont.load_default(int(size)))
    _paragraph(draw, rng, (50, 800, 974, 1000), 28, ink)
    return _age(rng, image, 0.7)


def sign(rng: np.random.Generator) -> Texture:
    """Four shop signs one below the other, each with two large words, a frame and a line of small print."""
    image = Image.new("RGB", (PRINT_SIDE, PRINT_SIDE))
    draw = ImageDraw.Draw(image)
    for k in range(4):
        background = random_muted_colour(rng, (0.2, 0.6), (0.15, 0.6))
        ink = random_muted_colour(rng, (0.02, 0.25), (0.75, 0.92))
        top = 256 * k
        draw.rectangle((0, top, 1024, top + 256), fill=_rgb(background))
        draw.rectangle((12, top + 12, 1011, top + 243), outline=_rgb(ink), width=6)
        draw.text((60, top + 30), _words(rng, 2).upper(), fill=_rgb(ink), font=ImageFont.load_default(120))
        draw.text((60, top + 180), _words(rng, 7), fill=_rgb(ink), font=ImageFont.load_default(44))
    return _age(rng, image, 0.6)


def spines(rng: np.random.Generator) -> Texture:
    """Row of 32 book spines, each with a title along it."""
    image = Image.new("RGB", (PRINT_SIDE, PRINT_SIDE))
    width = PRINT_SIDE // 32
    for k in range(32):
        spine = Image.new("RGB", (PRINT_SIDE, width), _rgb(random_muted_colour(rng, (0.1, 0.6), (0.15, 0.75))))
        draw = ImageDraw.Draw(spine)
        ink = _rgb(random_muted_colour(rng, (0.05, 0.4), (0.7, 0.92) if rng.random() < 0.7 else (0.05, 0.2)))
        draw.text((90, 2), _words(rng, 3).title(), fill=ink, font=ImageFont.load_default(22))
        for x in (40, 60, 960):
            draw.line((x, 0, x, width), fill=ink, width=int(rng.integers(2, 10)))
        image.paste(spine.transpose(Image.Transpose.ROTATE_270), (k * width, 0))
    return _age(rng, image, 0.5)
