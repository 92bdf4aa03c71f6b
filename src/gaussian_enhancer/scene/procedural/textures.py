"""Procedural textures: stone, wood, brick, cloth, plants, plaster, metal. Each function makes one seamless texture.

Axes: t texture side.
"""

import numpy as np
from jaxtyping import Float

from gaussian_enhancer.scene.procedural.atlas import Texture
from gaussian_enhancer.scene.procedural.noise import (
    SIDE,
    Colour,
    blend,
    fractal,
    random_muted_colour,
    step,
    worley_noise,
)

Random = np.random.Generator


def make_texture(
    colour: Float[np.ndarray, "t t 3"],
    height: Float[np.ndarray, "t t"],
    gloss: Float[np.ndarray, "t t"] | float = 0.5,
    opacity: Float[np.ndarray, "t t"] | float = 1.0,
) -> Texture:
    """Make a texture of maps, clipped or broadcast as needed."""
    shape = height.shape
    broadcast_maps = [np.broadcast_to(np.asarray(value, dtype=float), shape) for value in (gloss, opacity)]
    return Texture(np.clip(colour, 0.01, 0.97), np.clip(height, 0, 1), *broadcast_maps)


def add_grain(
    rng: Random, colour: Float[np.ndarray, "t t 3"], amount: float, beta: float = 0.6
) -> Float[np.ndarray, "t t 3"]:
    """Modulate a colour map by noise at all scales: mainly its brightness, slightly its hue."""
    shade = 1 + amount * 2.5 * (fractal(rng, beta) - 0.5)
    tint = 1 + amount * 0.3 * np.stack([fractal(rng, 1.2) - 0.5 for _ in range(3)], axis=2)
    return colour * shade[..., None] * tint


def coordinates() -> tuple[np.ndarray, np.ndarray]:
    """Texture coordinates u and v of the texel centres, [0, 1]."""
    axis = (np.arange(SIDE) + 0.5) / SIDE
    v, u = np.meshgrid(axis, axis, indexing="ij")
    return u, v


def plaster(rng: Random, colour: Colour) -> Texture:
    """Painted wall with vertical stains, pores and patches of another paint."""
    stains = step(0.55, 0.9, fractal(rng, 1.0, (1.0, 6.0)))
    patches = step(0.62, 0.66, fractal(rng, 1.5)) * 0.5
    pores = step(0.72, 0.9, fractal(rng, 0.2))
    rgb = add_grain(rng, blend(colour, np.array(colour) * 0.7 + 0.05, 0.3 * stains), 0.04)
    rgb = blend(rgb, random_muted_colour(rng, (0.02, 0.2), (0.5, 0.8)), patches * 0.3) * (1 - 0.2 * pores)[..., None]
    return make_texture(rgb, 0.5 + 0.25 * (fractal(rng, 0.7) - 0.5) - 0.2 * pores, 0.3)


def concrete(rng: Random, colour: Colour) -> Texture:
    """Concrete with cracks, speckle and stains."""
    _, edge, _ = worley_noise(rng, 5)
    crack = 1 - step(0.0, 0.025, edge + 0.05 * (fractal(rng, 0.8) - 0.4))
    speckle = fractal(rng, 0.05)
    rgb = add_grain(rng, np.broadcast_to(colour, (SIDE, SIDE, 3)), 0.16, 0.9) * (0.82 + 0.36 * speckle)[..., None]
    return make_texture(rgb * (1 - 0.45 * crack)[..., None], 0.6 + 0.2 * (speckle - 0.5) - 0.4 * crack, 0.4)


def asphalt(rng: Random, colour: Colour) -> Texture:
    """Asphalt: a dark binder with light grit, varying in brightness."""
    distance, _, value = worley_noise(rng, 72)
    grit = step(0.45, 0.15, distance) * (0.4 + 0.6 * value)
    tone = 0.75 + 0.7 * (fractal(rng, 1.1) - 0.5)
    rgb = add_grain(rng, blend(np.array(colour) * 0.6, np.array(colour) * 1.5 + 0.06, grit), 0.1)
    return make_texture(rgb * tone[..., None], 0.3 + 0.5 * grit, 0.4)


def gravel(rng: Random, colour: Colour) -> Texture:
    """Pebbles of three sizes and several tints over soil."""
    rgb = add_grain(rng, np.broadcast_to(np.array(colour) * 0.45, (SIDE, SIDE, 3)), 0.25)
    height = 0.2 * fractal(rng, 0.8)
    for grid in (60, 34, 18):
        distance, edge, value = worley_noise(rng, grid)
        stone = step(0.02, 0.14, edge) * (value > 0.35)
        second_colour = np.array(random_muted_colour(rng, (0.02, 0.2), (0.45, 0.8)))
        pebbles = blend(np.array(colour), second_colour, (value * 7.3) % 1) * (0.65 + 0.5 * value)[..., None]
        pebbles = pebbles * (1.1 - 0.5 * distance)[..., None]
        rgb = blend(rgb, add_grain(rng, pebbles, 0.12, 0.5), stone)
        height = np.where(stone > 0.3, 0.5 + 0.5 * (1 - distance) * stone, height)
    return make_texture(rgb, height, 0.3)


def turf(rng: Random, colour: Colour, dry: Colour) -> Texture:
    """Short grass and moss from above: strokes in several directions, dry patches, bare soil."""
    strokes = np.maximum.reduce([fractal(rng, 0.35, s) for s in ((1.0, 7.0), (7.0, 1.0), (1.0, 4.0), (3.0, 1.0))])
    strokes = (strokes - strokes.min()) / np.ptp(strokes)
    rgb = blend(np.array(colour) * 0.4, np.array(colour) * 1.35, step(0.2, 0.9, strokes))
    rgb = blend(rgb, np.array(dry) * (0.5 + 0.8 * strokes)[..., None], step(0.45, 0.75, fractal(rng, 1.2)))
    soil = step(0.62, 0.8, fractal(rng, 0.9))
    return make_texture(
        add_grain(rng, blend(rgb, np.array(dry) * 0.4, soil * 0.7), 0.12), strokes * (1 - 0.5 * soil), 0.15
    )


def cobble(rng: Random, colour: Colour) -> Texture:
    """Worn paving stones with moss and sand between them."""
    distance, edge, value = worley_noise(rng, 9, 0.55)
    stone = step(0.03, 0.16, edge + 0.06 * (fractal(rng, 0.5) - 0.5))
    stone_colour = add_grain(rng, np.array(colour) * (0.6 + 0.7 * value)[..., None], 0.18, 0.7)
    gap_colour = random_muted_colour(rng, (0.15, 0.4), (0.2, 0.4), (0.1, 0.25))
    gaps = add_grain(rng, np.broadcast_to(gap_colour, stone_colour.shape), 0.3)
    height = 0.9 * stone * (1 - 0.4 * distance) + 0.1 * fractal(rng, 0.3)
    return make_texture(blend(gaps, stone_colour, stone), height, 0.5 * stone)


def brick(rng: Random, colour: Colour, mortar: Colour, rows: int) -> Texture:
    """Brick wall in running bond: bricks of varying colour with chipped edges and efflorescence."""
    u, v = coordinates()
    columns = 4
    row = np.floor(v * rows).astype(int)
    x = (u * columns + 0.5 * (row % 2)) % columns
    value = rng.random((rows, columns))[row, np.floor(x).astype(int)]
    wobble = 0.05 * (fractal(rng, 0.9) - 0.5)
    edge_distance = np.minimum(0.5 - np.abs(x % 1 - 0.5), (0.5 - np.abs(v * rows % 1 - 0.5)) * columns / rows * 1.6)
    solid = step(0.018, 0.05, edge_distance + wobble)
    dark_colour = np.array(colour) * np.array([0.6, 0.55, 0.6])
    brick_colour = add_grain(rng, blend(np.array(colour) * 1.15, dark_colour, value), 0.2, 0.6)
    efflorescence = step(0.65, 0.9, fractal(rng, 1.0)) * 0.4
    rgb = blend(add_grain(rng, np.broadcast_to(mortar, brick_colour.shape), 0.15, 0.4), brick_colour, solid)
    return make_texture(
        blend(rgb, np.array([0.75, 0.73, 0.7]), efflorescence), 0.75 * solid + 0.25 * fractal(rng, 0.6), 0.25
    )


def tiles(rng: Random, first: Colour, second: Colour, count: int, pattern: str) -> Texture:
    """Glazed or stone tiles with grout, by `pattern`: chequered, plain, or with an ornament."""
    u, v = coordinates()
    i, j = np.floor(u * count).astype(int), np.floor(v * count).astype(int)
    x, y = u * count % 1 - 0.5, v * count % 1 - 0.5
    edge = 0.5 - np.maximum(np.abs(x), np.abs(y))
    pattern_mask = {
        "checks": ((i + j) % 2).astype(float),
        "plain": np.zeros_like(u),
        "ornament": step(-0.02, 0.02, np.cos(4 * np.arctan2(y, x)) * 0.18 + 0.28 - np.hypot(x, y))
        * (1 - step(0.10, 0.13, 0.2 - np.hypot(x, y))),
    }[pattern]
    value = rng.random((count, count))[j, i]
    veins = 1 - step(0.0, 0.05, np.abs(fractal(rng, 1.3) - 0.5))
    rgb = blend(np.array(first), np.array(second), pattern_mask) * (0.85 + 0.25 * value)[..., None]
    rgb = add_grain(rng, rgb, 0.07, 0.8) * (1 - 0.25 * veins)[..., None]
    tile_mask = step(0.012, 0.03, edge)
    dirt = np.broadcast_to(np.array([0.32, 0.3, 0.27]), rgb.shape)
    rgb = blend(dirt, rgb, tile_mask) * (1 - 0.3 * step(0.6, 0.9, fractal(rng, 0.9)))[..., None]
    return make_texture(rgb, 0.5 * tile_mask + 0.02 * fractal(rng, 0.3), 0.2 + 0.8 * tile_mask)


def planks(rng: Random, colour: Colour, count: int) -> Texture:
    """Wooden boards along v with growth rings, knots and gaps."""
    u, v = coordinates()
    board = np.floor(u * count).astype(int)
    value = rng.random(count)[board]
    joint = (v * 2 + rng.random(count)[board]) % 1
    grain = fractal(rng, 0.9, (1.0, 14.0))
    knots, _, cell_value = worley_noise(rng, 7)
    knot = step(0.2, 0.02, knots) * (cell_value > 0.8)
    rings = 0.5 + 0.5 * np.sin(90 * (0.4 * grain + 0.25 * knot + value) + 8 * u)
    tone = (0.55 + 0.4 * value + 0.35 * (grain - 0.5)) * (1 - 0.22 * rings) * (1 - 0.5 * knot)
    rgb = np.array(colour) * tone[..., None] * (1 + 0.15 * (value[..., None] - 0.5) * np.array([1.0, 0.0, -1.0])) * 1.35
    gap = step(0.02, 0.005, np.minimum(u * count % 1, 1 - u * count % 1)) + step(
        0.006, 0.002, np.minimum(joint, 1 - joint)
    )
    rgb = add_grain(rng, rgb, 0.08, 0.4) * (1 - 0.75 * np.clip(gap, 0, 1))[..., None]
    return make_texture(rgb, 0.7 + 0.2 * (grain - 0.5) - 0.6 * np.clip(gap, 0, 1), 0.4 + 0.5 * fractal(rng, 1.0))


def cloth(rng: Random, first: Colour, second: Colour, pattern: str, count: int = 6) -> Texture:
    """Woven cloth, by `pattern`: plaid, stripes, dots or plain; brightness varies as by wear."""
    u, v = coordinates()
    bands = rng.random(32)

    def stripe(x: np.ndarray) -> np.ndarray:
        position = x * count % 1 * 8
        return step(0.4, 0.6, bands[(position.astype(int) + 3) % 32])

    dots = step(0.3, 0.26, np.hypot(u * count % 1 - 0.5, v * count % 1 - 0.5))
    pattern_mask = {"plaid": 0.5 * stripe(u) + 0.5 * stripe(v), "stripes": stripe(u), "dots": dots, "plain": 0 * u}[
        pattern
    ]
    threads = 0.25 * (np.sin(2 * np.pi * 96 * u) * np.where(np.sin(2 * np.pi * 48 * v) > 0, 1, -1) + 1) + 0.25 * (
        np.sin(2 * np.pi * 96 * v) + 1
    )
    rgb = (
        add_grain(rng, blend(np.array(first), np.array(second), pattern_mask), 0.12, 0.5)
        * (0.72 + 0.4 * threads)[..., None]
    )
    return make_texture(rgb * (0.8 + 0.4 * fractal(rng, 1.2))[..., None], 0.3 + 0.4 * threads, 0.15)


def marble(rng: Random, colour: Colour) -> Texture:
    """Polished stone with veins of several widths."""
    veins = 1 - step(0.0, 0.03, np.abs(fractal(rng, 1.4) - 0.5))
    fine_veins = 1 - step(0.0, 0.02, np.abs(fractal(rng, 1.1) - 0.52))
    cloud = fractal(rng, 1.3)
    rgb = np.array(colour) * (0.75 + 0.45 * cloud)[..., None]
    rgb = blend(
        rgb, np.array(random_muted_colour(rng, (0.1, 0.4), (0.2, 0.45))), np.clip(0.7 * veins + 0.35 * fine_veins, 0, 1)
    )
    return make_texture(add_grain(rng, rgb, 0.05, 0.4), 0.5 + 0.03 * (cloud - 0.5), 0.9 - 0.3 * veins)


def metal(rng: Random, colour: Colour, rust: float = 0.3) -> Texture:
    """Painted or bare brushed metal with patches of rust."""
    brushed = fractal(rng, 0.3, (1.0, 20.0))
    rust_noise = fractal(rng, 1.0)
    rust_mask = step(0.78 - 0.4 * rust, 0.86 - 0.4 * rust, rust_noise)
    rust_colour = add_grain(rng, np.broadcast_to(np.array([0.36, 0.2, 0.11]), (SIDE, SIDE, 3)), 0.35, 0.6)
    rgb = blend(np.array(colour) * (0.85 + 0.3 * brushed)[..., None], rust_colour, rust_mask)
    return make_texture(
        add_grain(rng, rgb, 0.06),
        0.5 + 0.1 * (brushed - 0.5) + 0.2 * rust_mask * fractal(rng, 0.4),
        0.9 - 0.8 * rust_mask,
    )


def bark(rng: Random, colour: Colour) -> Texture:
    """Bark with furrows along v and lichen."""
    ridges = np.abs(fractal(rng, 0.9, (1.0, 5.0)) - 0.5) * 2
    lichen = step(0.65, 0.75, fractal(rng, 1.0)) * 0.6
    rgb = add_grain(rng, np.array(colour) * (0.35 + 1.3 * step(0.0, 0.6, ridges))[..., None], 0.2, 0.4)
    return make_texture(
        blend(rgb, np.array(random_muted_colour(rng, (0.1, 0.3), (0.45, 0.65), (0.15, 0.3))), lichen), ridges, 0.1
    )


def foliage(rng: Random, colour: Colour) -> Texture:
    """Dense foliage from a distance, for hills and hedges."""
    rgb = np.zeros((SIDE, SIDE, 3))
    height = np.zeros((SIDE, SIDE))
    for grid in (16, 34, 70):
        distance, _, value = worley_noise(rng, grid)
        lobe = np.clip(1 - distance, 0, 1)
        height += lobe * value / 3
        rgb += np.array(colour) * (0.3 + 1.1 * lobe * value)[..., None] / 3
    varied_rgb = blend(rgb, rgb * np.array([1.35, 1.05, 0.6]), step(0.4, 0.8, fractal(rng, 1.0)))
    return make_texture(add_grain(rng, varied_rgb * 1.2, 0.2, 0.4), height, 0.1)


def leaves(rng: Random, colour: Colour, count: int, slender: float) -> Texture:
    """Single leaves with veins, `slender` times as wide as long; the texture is a hole between them."""
    u, v = coordinates()
    rgb = np.broadcast_to(np.array(colour) * 0.7, (SIDE, SIDE, 3)).copy()
    opacity, height = np.zeros((SIDE, SIDE)), np.zeros((SIDE, SIDE))
    for _ in range(count):
        length, angle = rng.uniform(0.09, 0.16), rng.uniform(0, 2 * np.pi)
        cu, cv = rng.uniform(0.17, 0.83, 2)
        window = tuple(slice(int((c - length) * SIDE), int((c + length) * SIDE) + 1) for c in (cv, cu))
        du, dv = u[window] - cu, v[window] - cv
        along, across = du * np.cos(angle) + dv * np.sin(angle), dv * np.cos(angle) - du * np.sin(angle)
        t = np.clip(0.5 + along / (2 * length), 0, 1)
        leaf_mask = (np.abs(across) < slender * length * np.sin(np.pi * t**0.8)) & (np.abs(along) < length)
        vein = np.maximum(
            step(0.006, 0.001, np.abs(across)), 0.6 * step(0.75, 0.95, np.cos(150 * (along - np.abs(across))))
        )
        tint = np.array(colour) * rng.uniform(0.6, 1.4) * np.array([rng.uniform(0.8, 1.4), 1.0, rng.uniform(0.6, 1.0)])
        leaf_colour = tint * (0.75 + 0.35 * t + 0.25 * vein)[..., None]
        rgb[window] = np.where(leaf_mask[..., None], leaf_colour, rgb[window])
        height[window] = np.where(leaf_mask, 0.6 - 0.2 * vein, height[window])
        opacity[window] = np.where(leaf_mask, 1.0, opacity[window])
    return make_texture(add_grain(rng, rgb, 0.1, 0.5), height, 0.5, opacity)


def clouds(rng: Random) -> Texture:
    """Clouds: opacity is their cover, colour their shading."""
    cover = step(rng.uniform(0.3, 0.5), rng.uniform(0.65, 0.9), fractal(rng, 1.35))
    shade = 0.78 + 0.3 * fractal(rng, 1.2) - 0.2 * cover
    return make_texture(np.repeat(shade[..., None], 3, axis=2), cover, 0.0, cover)


def speckle(rng: Random) -> Texture:
    """Noise at all scales, for detail finer than a texture's resolution and for dirt coarser than its repeat."""
    noise = fractal(rng, 0.55)
    return make_texture(np.repeat(noise[..., None], 3, axis=2), noise, noise)
