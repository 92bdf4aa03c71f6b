"""`indoor`: a furnished room, photographed from inside, as in Deep Blending."""

from dataclasses import replace

import numpy as np

from gaussian_enhancer.scene.procedural import furniture, nature, shapes
from gaussian_enhancer.scene.procedural.daylight import daylight
from gaussian_enhancer.scene.procedural.draft import Draft, LightSpec, SkySpec
from gaussian_enhancer.scene.procedural.mesh import join_parts
from gaussian_enhancer.scene.procedural.palette import Palette
from gaussian_enhancer.scene.procedural.paths import room
from gaussian_enhancer.scene.procedural.vector import Vector


def draft_indoor(seed: int) -> Draft:
    """Make the draft of the world that a seed determines."""
    rng = np.random.default_rng([seed, 77])
    black: Vector = (0.0, 0.0, 0.0)
    x, y, h = rng.uniform(4.6, 6.4), rng.uniform(4.0, 5.4), rng.uniform(2.5, 3.0)
    draft = Draft(
        rng=rng,
        sky=SkySpec(black, black, black, 0),
        path=room(seed, (x, y), 0.85, (1.35, 1.75)),
        field_of_view=72.0,
        ambient_box=((-x / 2, -y / 2, 0.0), (x / 2, y / 2, h)),
        ambient=float(rng.uniform(0.5, 0.7)),
        probe=(0.0, 0.0, 1.4),
    )
    daylight(draft, 9.0)
    draft.lights.clear()
    draft.haze = 0.0
    # The ground colour of the sky approximates light that the room's surfaces reflect.
    draft.sky = replace(draft.sky, ground=(0.42, 0.37, 0.31))
    sun_direction = np.array([rng.uniform(-0.4, 0.4), 1.0, rng.uniform(0.45, 0.9)])
    draft.lights.append(
        LightSpec(tuple(sun_direction / np.linalg.norm(sun_direction) * 540), (0, 0, 1.0), 5.0, (2.6, 2.3, 1.9))
    )
    p = Palette(draft)
    _shell(p, x, y, h)
    _lamp(p, h)
    _arrange(p, x, y)
    return draft


def _shell(p: Palette, x: float, y: float, h: float) -> None:
    """Floor, ceiling, walls and skirting boards, windows in the wall at +y, and the view outside."""
    rng, a, b = p.draft.rng, x / 2, y / 2
    floor = shapes.terrain(np.linspace(-a, a, 12), np.linspace(-b, b, 12), lambda u, v: 0 * u)
    p.add(floor, rng.choice(["wood", "tiles", "wood"]), casts=False)
    p.add(
        shapes.terrain(np.linspace(-a, a, 6), np.linspace(-b, b, 6), lambda u, v: h + 0 * u), "plaster 2", casts=False
    )
    walls = p(str(rng.choice(["plaster", "plaster", "cloth 6"])))
    feature_wall = p(str(rng.choice(["brick", "plaster 3", "wood 5"])))
    p.draft.add(shapes.quad((-a, -b, h), (x, 0, 0), (0, 0, -h)), feature_wall, casts=False)
    for s in (-1, 1):
        p.draft.add(shapes.quad((s * a, -b, h), (0, y, 0), (0, 0, -h)), walls, casts=False)
    count = int(rng.integers(1, 4))
    window_width, sill_height, window_top = rng.uniform(0.95, 1.5), rng.uniform(0.5, 0.95), h - rng.uniform(0.25, 0.5)
    centres = (np.arange(count) + 0.5) / count * x - a
    edges = np.concatenate([[-a], *[[c - window_width / 2, c + window_width / 2] for c in centres], [a]])
    for left, right in zip(edges[::2], edges[1::2], strict=True):
        p.draft.add(shapes.quad((left, b, h), (right - left, 0, 0), (0, 0, -h), (left, 0)), walls)
    for c in centres:
        _window(p, c, b, window_width, sill_height, window_top, h, walls)
    skirting = [shapes.box((x, 0.02, 0.1)).transform((0, s * (b - 0.01), 0)) for s in (-1, 1)]
    skirting += [shapes.box((0.02, y, 0.1)).transform((s * (a - 0.01), 0, 0)) for s in (-1, 1)]
    p.add(join_parts(skirting), "plaster 4", casts=False)
    p.add(
        shapes.terrain(np.linspace(-60, 60, 5), np.linspace(b + 0.5, 90, 5), lambda u, v: -1.0 + 0 * u),
        "turf",
        casts=False,
    )
    nature.house(p, (rng.uniform(-8, 8), b + 25, -1), 0.2, (12, 8, 7), "brick 3")
    nature.tree(p, (rng.uniform(-3, 3), b + 8, -1), 6.0, 260)
    nature.hills(p, 150.0, 15.0, "foliage")


def _window(p: Palette, c: float, b: float, wide: float, low: float, high: float, h: float, walls: int) -> None:
    """Window opening with frame, glazing bars, sill and curtains, and a radiator below."""
    rng = p.draft.rng
    p.draft.add(shapes.quad((c - wide / 2, b, low), (wide, 0, 0), (0, 0, -low), (c - wide / 2, h - low)), walls)
    p.draft.add(shapes.quad((c - wide / 2, b, h), (wide, 0, 0), (0, 0, high - h), (c - wide / 2, 0)), walls)
    frame = [shapes.box((0.06, 0.12, high - low)).transform((c + s * wide / 2, b, low)) for s in (-1, 1)]
    frame += [shapes.box((wide + 0.06, 0.12, 0.06)).transform((c, b, z)) for z in (low, high - 0.06)]
    frame += [shapes.box((0.03, 0.04, high - low)).transform((c + t * wide, b, low)) for t in (-0.17, 0.17)]
    frame += [shapes.box((wide, 0.04, 0.025)).transform((c, b, low + t * (high - low))) for t in (0.33, 0.66)]
    p.add(join_parts(frame), "plaster 4")
    p.add(shapes.box((wide + 0.2, 0.24, 0.03)).transform((c, b - 0.1, low - 0.03)), "marble")
    cloth = p("cloth 2")
    for s in (-1, 1):
        width = wide * rng.uniform(0.22, 0.4)
        left = c - wide / 2 - 0.12 if s < 0 else c + wide / 2 + 0.12 - width
        p.draft.add(
            shapes.curtain(width, high + 0.05, int(rng.integers(4, 8)), 0.045).transform((left, b - 0.16, 0.03)), cloth
        )
    p.add(
        shapes.rod((c - wide / 2 - 0.25, b - 0.16, high + 0.09), (c + wide / 2 + 0.25, b - 0.16, high + 0.09), 0.012),
        "chrome",
    )
    ribs = [
        shapes.rod((c + u, b - 0.08, 0.12), (c + u, b - 0.08, max(0.3, low - 0.1)), 0.018, 8)
        for u in np.arange(-wide * 0.4, wide * 0.4, 0.05)
    ]
    p.add(join_parts(ribs), "paint 2")
    if rng.random() < 0.6:
        furniture.potted(p, (c + rng.uniform(-0.3, 0.3), b - 0.1, low), rng.uniform(0.3, 0.45))


def _lamp(p: Palette, h: float) -> None:
    """Lamp on a cord; it is the second light of the scene."""
    rng = p.draft.rng
    x, y, z = rng.uniform(-0.5, 0.5), rng.uniform(-0.5, 0.5), h - rng.uniform(0.55, 0.8)
    p.add(shapes.rod((x, y, z + 0.1), (x, y, h), 0.006), "rubber", casts=False)
    shade = np.array([[rng.uniform(0.2, 0.28), 0.0], [rng.uniform(0.08, 0.2), 0.24]])
    p.add(shapes.lathe(shade, 36).transform((x, y, z - 0.1)), "lamp", casts=False)
    strength = rng.uniform(0.6, 1.0)
    colour = (1.0 * strength, 0.83 * strength, 0.6 * strength)
    p.draft.lights.append(LightSpec((x, y, z), (x, y, 0.0), z * 2.6, colour, local=True, side=1024))


def _arrange(p: Palette, x: float, y: float) -> None:
    """Furniture along the walls, and a table in the middle."""
    rng, a, b = p.draft.rng, x / 2, y / 2
    p.add(
        shapes.terrain(np.linspace(-1.3, 1.3, 8), np.linspace(-0.95, 0.95, 8), lambda u, v: 0.008 + 0 * u).transform(
            (0, 0, 0), yaw=rng.normal() * 0.15
        ),
        "cloth",
        casts=False,
    )
    is_dining_table = rng.random() < 0.5
    height = rng.uniform(0.7, 0.76) if is_dining_table else rng.uniform(0.38, 0.46)
    size = (rng.uniform(0.9, 1.3), rng.uniform(0.6, 0.85))
    furniture.table(p, (0, 0, 0.01), rng.uniform(-0.3, 0.3), size, height, "wood 2")
    furniture.vase(p, (0.1, 0.05, height + 0.015), rng.uniform(0.18, 0.28), flowers=True)
    furniture.flat_print(p, "page", (-0.36, 0.12, height + 0.016), (0.28, 0.08, 0), (0.08, -0.3, 0))
    furniture.books(p, (0.22, -0.15, height + 0.012), 0.3, 0.14, 0.22)
    if is_dining_table:
        for k in range(4):
            t = k * np.pi / 2 + rng.normal() * 0.15
            furniture.chair(p, (0.85 * np.cos(t), 0.7 * np.sin(t), 0.0), t - np.pi / 2)
    furniture.sofa(p, (rng.uniform(-0.3, 0.3), -b + 0.55, 0), np.pi, rng.uniform(1.5, 2.1))
    furniture.shelf(
        p, (-a + 0.16, rng.uniform(-0.5, 0.3), 0), np.pi / 2, rng.uniform(1.4, 2.2), int(rng.integers(4, 7))
    )
    furniture.shelf(p, (a - 0.16, rng.uniform(0.1, 0.7), 0), -np.pi / 2, rng.uniform(1.0, 1.6), int(rng.integers(2, 4)))
    furniture.potted(p, (-a + 0.4, -b + 0.4, 0), rng.uniform(1.1, 1.6))
    furniture.potted(p, (a - 0.4, b - 0.5, 0), rng.uniform(0.7, 1.2))
    furniture.chair(p, (a - 0.8, -b + 0.8, 0), 2.2)
    _pictures(p, x, y)
    furniture.lattice(p, (a - 0.05, -b + 1.3, 0.9), np.pi / 2, (0.8, 0.9), 0.1, 0.005, "chrome")
    for k in range(3):
        at = rng.uniform((-a + 0.9, -b + 1.2), (a - 0.9, b - 0.9))
        p.add(
            shapes.wire((*at, 0.01), (at[0] + rng.normal(), at[1] + rng.normal() * 0.5, 0.01), -0.01 * k, 0.006),
            "rubber",
        )


def _pictures(p: Palette, x: float, y: float) -> None:
    """Framed prints on the wall at -y."""
    rng, a, b = p.draft.rng, x / 2, y / 2
    for k in range(int(rng.integers(2, 5))):
        w, t, z = rng.uniform(0.4, 0.7), rng.uniform(-a + 0.6, a - 0.9), rng.uniform(1.95, 2.2)
        name = "poster" if rng.random() < 0.7 else "page"
        h = w * rng.uniform(0.8, 1.2)
        frame = [
            shapes.beam(s, e, 0.03, 0.03)
            for s, e in (
                ((t, -b + 0.02, z), (t + w, -b + 0.02, z)),
                ((t, -b + 0.02, z - h), (t + w, -b + 0.02, z - h)),
                ((t, -b + 0.02, z - h), (t, -b + 0.02, z)),
                ((t + w, -b + 0.02, z - h), (t + w, -b + 0.02, z)),
            )
        ]
        p.add(join_parts(frame), "wood 4" if k % 2 else "chrome")
        furniture.flat_print(p, f"{name} {k}", (t, -b + 0.008, z), (w, 0, 0), (0, 0, -h))
