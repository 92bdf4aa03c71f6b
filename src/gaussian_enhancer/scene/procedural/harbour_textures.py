"""Textures of `harbour` scenes: water, hulls, decks, sheet metal, nets, ropes, sails, ashlar, pine needles.

Axes: t texture side.
"""

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from gaussian_enhancer.scene.procedural.atlas import Texture
from gaussian_enhancer.scene.procedural.noise import SIDE, Colour, blend, fractal, random_muted_colour, step
from gaussian_enhancer.scene.procedural.textures import Random, add_grain, coordinates, make_texture


def ripples(rng: Random, colour: Colour) -> Texture:
    """Sheltered water: crossing small waves."""
    waves = 0.5 * fractal(rng, 1.5, (1.0, 2.2)) + 0.3 * fractal(rng, 1.2, (1.6, 1.0)) + 0.2 * fractal(rng, 0.9)
    turbidity = fractal(rng, 1.4)
    rgb = blend(np.array(colour) * 0.75, np.array(colour) * 1.25 + 0.01, turbidity)
    return make_texture(rgb, waves, 1.0)


def hull(rng: Random, colour: Colour, line_colour: Colour, underwater_colour: Colour) -> Texture:
    """Painted hull; v is the depth below the rail, 2 m in a repeat.

    It has a line of another colour near the rail, another paint below the waterline, plank seams, vertical rust streaks
    and scum.
    """
    _, v = coordinates()
    wavy_v = v + 0.004 * (fractal(rng, 1.0) - 0.5)
    rgb = add_grain(rng, np.broadcast_to(colour, (SIDE, SIDE, 3)), 0.07)
    rgb = blend(rgb, np.array(line_colour), step(0.055, 0.06, wavy_v) * step(0.085, 0.08, wavy_v))
    rgb = blend(rgb, add_grain(rng, np.broadcast_to(underwater_colour, rgb.shape), 0.15), step(0.42, 0.44, wavy_v))
    rust_streaks = step(0.62, 0.86, fractal(rng, 0.9, (1.0, 9.0))) * step(0.02, 0.2, v)
    rgb = blend(rgb, np.array([0.36, 0.2, 0.12]), 0.55 * rust_streaks)
    scum = step(0.36, 0.43, v + 0.1 * (fractal(rng, 0.8) - 0.5)) * step(0.55, 0.44, v)
    rgb = blend(rgb, np.array([0.2, 0.24, 0.16]), 0.7 * scum)
    seams = step(0.012, 0.003, np.abs((v * 14) % 1 - 0.5))
    return make_texture(rgb * (1 - 0.25 * seams)[..., None], 0.5 - 0.2 * seams, 0.8 - 0.6 * rust_streaks)


def laid_deck(rng: Random, colour: Colour) -> Texture:
    """Deck of narrow weathered boards with dark caulking between them."""
    u, _ = coordinates()
    count = 10
    value = rng.random(count)[np.floor(u * count).astype(int)]
    fibres = fractal(rng, 0.7, (1.0, 18.0))
    gap = step(0.07, 0.03, np.minimum(u * count % 1, 1 - u * count % 1))
    rgb = np.array(colour) * (0.75 + 0.35 * value + 0.4 * (fibres - 0.5))[..., None]
    return make_texture(add_grain(rng, rgb, 0.06) * (1 - 0.8 * gap)[..., None], 0.7 * (1 - gap) + 0.2 * fibres, 0.3)


def corrugated(rng: Random, colour: Colour) -> Texture:
    """Corrugated sheet metal, faded, with rust mainly along the overlaps of the sheets."""
    u, v = coordinates()
    ribs = 0.5 + 0.5 * np.cos(2 * np.pi * 16 * u)
    laps = step(0.02, 0.0, np.minimum(v * 2 % 1, 1 - v * 2 % 1))
    rust = step(0.55, 0.8, fractal(rng, 0.9, (1.0, 5.0)) + 0.25 * laps)
    rgb = np.array(colour) * (0.8 + 0.25 * ribs)[..., None] * (0.8 + 0.4 * fractal(rng, 1.2))[..., None]
    rgb = blend(rgb, add_grain(rng, np.broadcast_to(np.array([0.4, 0.22, 0.12]), rgb.shape), 0.3), 0.85 * rust)
    return make_texture(rgb * (1 - 0.4 * laps)[..., None], ribs, 0.7 - 0.6 * rust)


def netting(rng: Random, colour: Colour) -> Texture:
    """Fishing net: diamonds of twine, slightly distorted; the rest of the texture is a hole."""
    u, v = coordinates()
    sway = 0.035 * (fractal(rng, 1.6) - 0.5)
    diagonal_1, diagonal_2 = (u + v + sway) * 9 % 1, (u - v + sway) * 9 % 1
    twine = np.maximum(
        step(0.12, 0.08, np.minimum(diagonal_1, 1 - diagonal_1)),
        step(0.12, 0.08, np.minimum(diagonal_2, 1 - diagonal_2)),
    )
    rgb = add_grain(rng, np.broadcast_to(colour, (SIDE, SIDE, 3)), 0.2, 0.5)
    return make_texture(rgb, 0.3 + 0.5 * twine, 0.1, (twine > 0.5).astype(float))


def rope(rng: Random, colour: Colour) -> Texture:
    """Rope of twisted strands."""
    u, v = coordinates()
    strands = np.abs(np.sin(np.pi * (6 * v + 3 * u)))
    rgb = np.array(colour) * (0.45 + 0.7 * strands)[..., None]
    return make_texture(add_grain(rng, rgb, 0.2, 0.3), strands, 0.1)


def sailcloth(rng: Random, colour: Colour) -> Texture:
    """Sailcloth: creased panels with dark seams."""
    _, v = coordinates()
    seam = step(0.03, 0.01, np.minimum(v * 3 % 1, 1 - v * 3 % 1))
    creases = fractal(rng, 1.3, (3.0, 1.0))
    rgb = np.array(colour) * (0.85 + 0.3 * creases)[..., None] * (1 - 0.3 * seam)[..., None]
    return make_texture(add_grain(rng, rgb, 0.05), 0.5 * creases + 0.3 * seam, 0.2)


def ashlar(rng: Random, colour: Colour) -> Texture:
    """Ashlar: courses of dressed stone blocks of varying length, weathered, with lichen."""
    u, v = coordinates()
    rows = 5
    row = np.floor(v * rows).astype(int)
    counts = rng.integers(2, 5, rows)[row]
    x = u * counts + rng.random(rows)[row]
    value = rng.random((rows, 5))[row, np.floor(x).astype(int) % counts]
    edge = np.minimum(np.minimum(x % 1, 1 - x % 1) * rows / counts, np.minimum(v * rows % 1, 1 - v * rows % 1))
    stone = step(0.02, 0.07, edge + 0.05 * (fractal(rng, 0.8) - 0.5))
    rgb = add_grain(rng, np.array(colour) * (0.7 + 0.5 * value)[..., None], 0.2, 0.6)
    lichen = step(0.66, 0.78, fractal(rng, 0.7)) * 0.7
    rgb = blend(rgb, np.array(random_muted_colour(rng, (0.2, 0.6), (0.55, 0.75), (0.1, 0.17))), lichen)
    return make_texture(rgb * (0.45 + 0.55 * stone)[..., None], 0.7 * stone + 0.3 * fractal(rng, 0.5), 0.2)


def needles(rng: Random, colour: Colour) -> Texture:
    """Pine needles: 21 thin strokes along each of seven twigs; the rest of the texture is a hole."""
    mask_image = Image.new("L", (SIDE, SIDE))
    tone_image = Image.new("L", (SIDE, SIDE))
    mask_draw, tone_draw = ImageDraw.Draw(mask_image), ImageDraw.Draw(tone_image)
    for _ in range(7):
        start = rng.uniform(0.3, 0.7, 2) * SIDE
        direction = rng.normal(size=2)
        direction *= rng.uniform(0.2, 0.38) * SIDE / np.hypot(*direction)
        mask_draw.line((*start, *(start + direction)), fill=255, width=5)
        for t in rng.random(21):
            root = start + t * direction
            angle = np.arctan2(direction[1], direction[0]) + rng.choice([-1, 1]) * rng.uniform(0.3, 1.0)
            tip = root + rng.uniform(0.05, 0.1) * SIDE * np.array([np.cos(angle), np.sin(angle)])
            mask_draw.line((*root, *tip), fill=255, width=3)
            tone_draw.line((*root, *tip), fill=int(rng.integers(70, 255)), width=3)
    brightness = np.asarray(tone_image, dtype=float) / 255
    opacity = (np.asarray(mask_image) > 127).astype(float)
    rgb = np.array(colour) * (0.4 + 1.0 * brightness)[..., None]
    return make_texture(add_grain(rng, rgb, 0.15, 0.4), 0.4 + 0.2 * brightness, 0.3, opacity)


def registration(rng: Random) -> Texture:
    """Painted board with a boat's registration letters and number, and its home port below."""
    background = random_muted_colour(rng, (0.0, 0.5), (0.1, 0.35))
    text_colour = random_muted_colour(rng, (0.0, 0.15), (0.8, 0.95))
    image = Image.new("RGB", (SIDE, SIDE), tuple(round(255 * c) for c in background))
    draw = ImageDraw.Draw(image)
    fill = tuple(round(255 * c) for c in text_colour)
    letters = "".join(rng.choice(list("ABCDEHKLMNOPRSTW"), 2))
    draw.text((24, 40), f"{letters} {int(rng.integers(10, 400))}", fill=fill, font=ImageFont.load_default(150))
    ports = ["SKERRY BAY", "NORTHWICK", "PORT ANVIL", "EASTHAVEN", "GULL POINT"]
    draw.text((36, 280), str(rng.choice(ports)), fill=fill, font=ImageFont.load_default(66))
    draw.rectangle((10, 10, SIDE - 11, SIDE - 11), outline=fill, width=8)
    worn = step(0.6, 0.8, fractal(rng, 0.7))
    rgb = blend(np.asarray(image, dtype=float) / 255, np.array([0.5, 0.5, 0.48]), 0.5 * worn)
    return make_texture(add_grain(rng, rgb, 0.06), np.full_like(worn, 0.5))
