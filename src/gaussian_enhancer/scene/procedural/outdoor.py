"""`outdoor`: a street with facades, parked vehicles, poles, wires and fences, as in Tanks & Temples."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from gaussian_enhancer.scene.procedural import furniture, nature, shapes
from gaussian_enhancer.scene.procedural.daylight import daylight
from gaussian_enhancer.scene.procedural.draft import Draft, SkySpec
from gaussian_enhancer.scene.procedural.mesh import SurfacePart, join_parts
from gaussian_enhancer.scene.procedural.palette import Palette
from gaussian_enhancer.scene.procedural.paths import walk
from gaussian_enhancer.scene.procedural.vector import Vector

_WALL = 5.0  # y of the facades; the street's middle is at y = 0


def draft_outdoor(seed: int) -> Draft:
    """Make the draft of the world that a seed determines."""
    rng = np.random.default_rng([seed, 1000])
    black: Vector = (0.0, 0.0, 0.0)
    camera_y = rng.uniform(-2.6, -1.4)
    draft = Draft(
        rng=rng,
        sky=SkySpec(black, black, black, 0),
        path=walk(seed, (-6.0, camera_y, 1.6), (6.0, camera_y, 1.7), ((-2.5, _WALL, 1.7), (2.5, _WALL, 1.8))),
        field_of_view=66.0,
        ambient_box=((-11.0, -4.0, -0.2), (11.0, 6.0, 6.0)),
        probe=(0.0, 0.5, 1.6),
    )
    daylight(draft, 14.0)
    # The sun is behind the cameras; otherwise all facades would be in shadow.
    sun_direction, sun_light = np.array(draft.sky.sun), draft.lights[0]
    sun_direction[1] = -abs(sun_direction[1]) - 0.15
    draft.sky = replace(draft.sky, sun=tuple(sun_direction))
    sun_position = tuple(sun_direction / np.linalg.norm(sun_direction) * 840)
    draft.lights[0] = replace(sun_light, position=sun_position, side=3072)
    p = Palette(draft)
    _street(p)
    x = -17.0
    while x < 17.0:
        width = rng.uniform(4.5, 8.0)
        if rng.random() < 0.8 or abs(x) < 4:
            height = rng.uniform(4.5, 10.0)
            wall = ["brick", "plaster", "concrete", "brick", "plaster"][int(rng.integers(5))]
            _facade(p, x, width, height, f"{wall} {int(rng.integers(4))}")
        else:
            _garden(p, x, width)
        x += width
    _furnish(p)
    _beyond(p)
    return draft


def _street(p: Palette) -> None:
    rng = p.draft.rng
    xs = np.linspace(-40, 40, 41)
    p.add(
        shapes.terrain(xs, np.linspace(-14, 2.2, 10), lambda x, y: -0.14 + 0 * x),
        rng.choice(["asphalt", "cobble"]),
        casts=False,
    )
    p.add(
        shapes.terrain(xs, np.linspace(2.35, _WALL + 6, 6), lambda x, y: 0 * x),
        rng.choice(["concrete", "tiles 2", "cobble 2"]),
        casts=False,
    )
    for x in np.arange(-20, 20, 1.0):
        p.add(shapes.box((0.98, 0.17, 0.16)).transform((x + 0.5, 2.28, -0.14)), "concrete 3")
    for x in np.arange(-20, 20, 3.0):
        p.add(shapes.quad((x, -2.9, -0.135), (1.5, 0, 0), (0, -0.12, 0)), "plaster 5", casts=False)
    p.add(shapes.lathe(np.array([[0.32, -0.134], [0.0, -0.134]]), 24).transform((rng.uniform(-3, 3), 0.6, 0)), "iron")


def _window(p: Palette, x: float, z: float, w: float, h: float, trim: str) -> None:
    """Sash window: sill, frame, bars and panes, sometimes with shutters or a flower box."""
    rng, y = p.draft.rng, _WALL
    p.add(shapes.quad((x - w / 2, y - 0.012, z + h), (w, 0, 0), (0, 0, -h)), "glass")
    bars = [
        shapes.box((w + 0.24, 0.16, 0.08)).transform((x, y - 0.06, z - 0.08)),
        shapes.box((w + 0.16, 0.12, 0.12)).transform((x, y - 0.05, z + h)),
    ]
    bars += [shapes.box((0.07, 0.1, h)).transform((x + s * w / 2, y - 0.04, z)) for s in (-1, 1)]
    bars += [
        shapes.box((0.03, 0.05, h)).transform((x + s, y - 0.025, z)) for s in ([0.0] if w < 1.1 else [-w / 6, w / 6])
    ]
    bars += [shapes.box((w, 0.05, 0.03)).transform((x, y - 0.025, z + h * s)) for s in (0.33, 0.66)]
    p.add(join_parts(bars), trim)
    if rng.random() < 0.3:
        for s in (-1, 1):
            slats = [
                shapes.box((w / 2, 0.03, 0.045)).transform((x + s * (w * 0.77), y - 0.05, z + k * 0.075), tilt=0.5)
                for k in range(int(h / 0.075))
            ]
            p.add(join_parts(slats), "paint 2")
    elif rng.random() < 0.4:
        p.add(shapes.box((w, 0.2, 0.18)).transform((x, y - 0.2, z - 0.06)), "wood 2")
        for k in range(4):
            furniture.plant(p, (x + (k - 1.5) * w / 4, y - 0.2, z + 0.1), rng.uniform(0.2, 0.35), 18)


def _facade(p: Palette, x: float, width: float, height: float, wall: str) -> None:
    """House front: plinth, door, windows or a shop on the ground floor, windows above, cornice, pipe and posters."""
    rng, y = p.draft.rng, _WALL
    trim = f"plaster {int(rng.integers(6, 9))}"
    p.add(shapes.box((width, 6.0, height)).transform((x + width / 2, y + 3.0, 0)), wall)
    p.add(shapes.box((width, 0.1, 0.55)).transform((x + width / 2, y - 0.05, 0)), "concrete 2")
    p.add(shapes.box((width + 0.1, 0.45, 0.2)).transform((x + width / 2, y - 0.1, height)), trim)
    p.add(shapes.box((width, 0.18, 0.14)).transform((x + width / 2, y - 0.08, 3.1)), trim)
    count = int(width / rng.uniform(1.5, 2.1))
    door = int(rng.integers(count))
    shop = rng.random() < 0.5
    w, h = rng.uniform(0.8, 1.15), rng.uniform(1.35, 1.75)
    for k in range(count):
        u = x + (k + 0.5) * width / count
        for level in range(int((height - 0.6) / 2.9)):
            if level or (k != door and not shop):
                _window(p, u, 0.95 + 3.0 * level, w, h, trim)
    u = x + (door + 0.5) * width / count
    p.add(shapes.box((1.0, 0.1, 2.2)).transform((u, y - 0.02, 0.05)), f"wood {int(rng.integers(1, 4))}")
    p.add(
        join_parts(
            [shapes.box((0.1, 0.2, 2.35)).transform((u + s * 0.55, y - 0.05, 0)) for s in (-1, 1)]
            + [
                shapes.box((1.3, 0.22, 0.14)).transform((u, y - 0.06, 2.3)),
                shapes.box((1.3, 0.5, 0.15)).transform((u, y - 0.25, 0)),
            ]
        ),
        trim,
    )
    p.add(shapes.ellipsoid((0.03, 0.03, 0.03)).transform((u + 0.4, y - 0.11, 1.1)), "chrome")
    if shop:
        _shop(p, x, width, u)
    pipe = x + 0.15
    p.add(shapes.rod((pipe, y - 0.1, 0), (pipe, y - 0.1, height), 0.045, 10), "iron")
    for _ in range(int(rng.integers(0, 3))):
        s = rng.uniform(0.35, 0.6)
        furniture.flat_print(
            p,
            "poster",
            (x + rng.uniform(0.3, width - 0.9), y - 0.056, rng.uniform(1.5, 2.0)),
            (s, 0, 0),
            (0, 0, -s * 1.35),
        )


def _shop(p: Palette, x: float, width: float, door: float) -> None:
    """Shop windows beside a door, with a sign above and sometimes an awning."""
    rng, y = p.draft.rng, _WALL
    furniture.flat_print(
        p,
        "sign",
        (x + 0.4, y - 0.09, 3.06),
        (width - 0.8, 0, 0),
        (0, 0, -0.5),
        (0.0, 0.25 * int(rng.integers(4)), 1.0, 0.25),
    )
    for left, right in ((x + 0.5, door - 0.7), (door + 0.7, x + width - 0.4)):
        if right - left < 0.6:
            continue
        p.add(shapes.quad((left, y - 0.055, 2.4), (right - left, 0, 0), (0, 0, -1.8)), "glass")
        bars = [shapes.box((0.06, 0.08, 1.85)).transform((u, y - 0.07, 0.58)) for u in np.linspace(left, right, 3)]
        bars += [
            shapes.box((right - left, 0.08, 0.06)).transform(((left + right) / 2, y - 0.07, z))
            for z in (0.56, 2.0, 2.4)
        ]
        p.add(join_parts(bars), "wood 3")
        furniture.flat_print(p, "page", (left + 0.1, y - 0.06, 1.5), (0.3, 0, 0), (0, 0, -0.4))
    if rng.random() < 0.75:
        p.add(shapes.quad((x + 0.4, y - 0.1, 2.55), (width - 0.8, 0, 0), (0, -1.1, -0.45)), "cloth")
        p.add(shapes.quad((x + 0.4, y - 1.2, 2.1), (width - 0.8, 0, 0), (0, 0, -0.18)), "cloth")
        for u in (x + 0.45, x + width - 0.45):
            p.add(shapes.rod((u, y - 0.05, 1.7), (u, y - 1.2, 2.1), 0.012), "iron")


def _garden(p: Palette, x: float, width: float) -> None:
    """Garden between houses: a fence, a tree and bushes."""
    rng, y = p.draft.rng, _WALL
    furniture.lattice(p, (x + width / 2, y - 0.1, 0), 0.0, (width, 1.7), 0.16, 0.008)
    nature.tree(p, (x + width / 2, y + 2.5, 0), rng.uniform(5, 8), 380)
    for _ in range(3):
        nature.bush(p, (x + rng.uniform(0.6, width - 0.6), y + rng.uniform(0.7, 1.6), 0), rng.uniform(0.4, 0.8), 130)


def vehicle(p: Palette, at: Vector, yaw: float) -> None:
    """Car or van: a lofted body, windows, wheels, lamps, number plates, mirrors, bumpers."""
    rng = p.draft.rng
    van = rng.random() < 0.4
    length, half, top = (4.4, 0.88, 1.9) if van else (4.1, 0.84, 1.42)
    hood = 0.95 if van else 0.9
    body = _vehicle_body(length, half, hood, top, van=van)
    p.add(body.transform(at, yaw=yaw), f"paint {int(rng.integers(3, 6))}")
    _trimmings(p, at, yaw, length, half, hood, top)


def _vehicle_body(length: float, half: float, hood: float, top: float, *, van: bool) -> SurfacePart:
    """Loft of a smoothed side outline across the width, narrower above the hood and rounded at both sides."""
    outline = np.array(
        [
            [-0.5, 0.35],
            [-0.5, hood - 0.08],
            [-0.36 if not van else -0.42, hood],
            [-0.2 if not van else -0.34, top - 0.03],
            [0.0, top],
            [0.3 if not van else 0.44, top - 0.02],
            [0.45 if not van else 0.49, hood],
            [0.5, hood - 0.1],
            [0.5, 0.35],
        ]
    )
    closed_outline = np.concatenate([outline, outline[:1]])
    steps = np.linspace(0, len(closed_outline) - 1, 120)
    dense = [np.interp(steps, np.arange(len(closed_outline)), closed_outline[:, k]) for k in (0, 1)]
    x, z = (np.convolve(np.concatenate([c[-4:-1], c, c[1:4]]), np.ones(7) / 7, "valid") for c in dense)
    half_widths = half * (1 - 0.17 * np.clip((z - hood) / (top - hood), 0, 1))
    rows = []
    for across in np.sin(np.linspace(-np.pi / 2, np.pi / 2, 17)):
        rounding = 1 - 0.16 * np.abs(across) ** 6
        rows.append(np.stack([x * rounding * length, across * half_widths, 0.7 + (z - 0.7) * rounding], axis=1))
    loft = np.array(rows)
    along = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(loft[8], axis=0), axis=1))])
    uv = np.stack(np.broadcast_arrays(along[None], np.linspace(0, 2 * half, 17)[:, None]), axis=-1)
    return join_parts([shapes.sheet(loft, uv), _cap(loft[0]), _cap(loft[-1])])


def _cap(ring: Float[np.ndarray, "k 3"]) -> SurfacePart:
    """Flat side of a loft: a triangle fan about the centroid of its outline."""
    positions, faces = shapes.fan(ring)
    normals = np.tile([0.0, np.sign(ring[0, 1]), 0.0], (len(positions), 1))
    return SurfacePart(positions, normals, positions[:, [0, 2]] * [1.0, -1.0], faces)


def _trimmings(p: Palette, at: Vector, yaw: float, length: float, half: float, hood: float, top: float) -> None:
    """Windows, mouldings, mirrors, wheels, lamps, bumpers and number plates of a vehicle."""

    def put(part: SurfacePart, material: str) -> None:
        p.add(part.transform(at, yaw=yaw), material)

    for s in (-1, 1):
        edge = half * 1.005
        for left, right in ((-0.28, -0.02), (0.02, 0.3)):
            a, b = left * length, right * length
            put(
                shapes.quad(
                    (a * 0.85, s * edge * 0.93, top - 0.1), (b * 0.9 - a * 0.85, 0, 0), (0, s * 0.1, hood - top + 0.14)
                ),
                "glass",
            )
        put(shapes.box((length * 0.8, 0.03, 0.05)).transform((0, s * edge, 0.62)), "rubber")
        put(shapes.ellipsoid((0.08, 0.09, 0.07)).transform((-length * 0.24, s * (half + 0.12), hood + 0.06)), "rubber")
        for x in (-0.31, 0.31):
            tyre, rim = furniture.wheel(0.32, 12, 0.07)
            put(tyre.transform((x * length, s * (half - 0.06), 0.32)), "rubber")
            put(rim.transform((x * length, s * (half - 0.06), 0.32)), "chrome")
        for x in (-0.495, 0.495):
            put(
                shapes.ellipsoid((0.07, 0.13, 0.08)).transform((x * length, s * half * 0.68, 0.72)),
                "chrome" if x < 0 else "paint 6",
            )
    for x in (-0.5, 0.5):
        put(shapes.box((0.1, 1.7 * half, 0.14)).transform((x * length, 0, 0.4)), "rubber")
        sign = 1.0 if x > 0 else -1.0
        plate = shapes.quad((x * length + sign * 0.055, -0.26, 0.54), (0, 0.52, 0), (0, 0, -0.12))
        put(replace(plate, uvs=plate.uvs / plate.uvs.max(0) * [0.6, 0.25]), "sign")
    slant = shapes.quad(
        (-0.345 * length, -half * 0.72, hood + 0.04), (0, half * 1.44, 0), (0.135 * length, 0, top - hood - 0.12)
    )
    put(slant, "glass")


def _furnish(p: Palette) -> None:
    """Vehicles, poles with wires, plants, bicycles, barrels, and chairs with tables along the street."""
    rng = p.draft.rng
    x = rng.uniform(-9, -6)
    while x < 9:
        if rng.random() < 0.7:
            vehicle(p, (x, 1.2, -0.14), rng.normal() * 0.03 + (np.pi if rng.random() < 0.5 else 0))
        x += rng.uniform(5.2, 8.5)
    posts = np.arange(-18, 19, rng.uniform(5.5, 8.0)) + rng.uniform(-1, 1)
    for k, u in enumerate(posts):
        p.add(shapes.rod((u, 2.7, 0), (u, 2.7, 6.5), 0.08, 12), "wood 4")
        p.add(shapes.box((0.08, 1.3, 0.08)).transform((u, 2.7, 6.0)), "wood 4")
        if k:
            for y in (2.15, 2.5, 2.9, 3.25):
                p.add(shapes.wire((posts[k - 1], y, 6.1), (u, y, 6.1), rng.uniform(0.15, 0.4), 0.012), "rubber")
            p.add(
                shapes.wire((u, 2.7, 5.6), (u + rng.uniform(-3, 3), _WALL, rng.uniform(3.4, 5)), 0.25, 0.01), "rubber"
            )
        if rng.random() < 0.6:
            furniture.flat_print(p, "poster", (u - 0.16, 2.61, 1.8), (0.32, 0, 0), (0, 0, -0.42))
    for u in rng.uniform(-9, 9, 7):
        kind, at = int(rng.integers(4)), (u, rng.uniform(3.4, 4.4), 0.0)
        if kind == 0:
            furniture.potted(p, at, rng.uniform(0.8, 1.4))
        elif kind == 1:
            furniture.bicycle(p, (u, 4.6, 0.0), rng.normal() * 0.1)
        elif kind == 2:
            ribs = np.array(
                [
                    [0.0, 0.0],
                    [0.27, 0.0],
                    [0.3, 0.3],
                    [0.31, 0.3],
                    [0.31, 0.33],
                    [0.29, 0.6],
                    [0.31, 0.6],
                    [0.3, 0.9],
                    [0.0, 0.92],
                ]
            )
            p.add(shapes.lathe(ribs, 28).transform(at), "paint 7")
        else:
            furniture.chair(p, at, rng.uniform(0, 6.3))
            furniture.table(p, (u + 0.7, at[1], 0.0), 0.3, (0.7, 0.7), 0.72, "iron")


def _beyond(p: Palette) -> None:
    """Background: houses behind facades and cameras, houses and trees at the street's ends, ground, and hills."""
    rng = p.draft.rng
    for u in np.arange(-36, 37, 11.0):
        nature.house(
            p,
            (u + rng.uniform(-2, 2), 24 + rng.uniform(0, 8), 0),
            rng.normal() * 0.2,
            (9, 8, rng.uniform(8, 14)),
            f"brick {int(rng.integers(4))}",
        )
        nature.house(
            p,
            (u + rng.uniform(-2, 2), -18 - rng.uniform(0, 5), 0),
            np.pi,
            (10, 8, rng.uniform(5, 10)),
            f"plaster {int(rng.integers(4))}",
        )
    for s in (-1, 1):
        nature.house(p, (s * 45.0, 0, 0), np.pi / 2, (16, 9, 10), "brick 1")
        nature.tree(p, (s * 21.0, 3.0, 0), rng.uniform(6, 9), 260)
        nature.tree(p, (s * 27.0, -3.0, 0), rng.uniform(6, 9), 200, " 3")
    p.add(
        shapes.terrain(np.linspace(-400, 400, 9), np.linspace(-400, 400, 9), lambda x, y: -0.3 + 0 * x),
        "turf",
        casts=False,
    )
    nature.hills(p, 180.0, 14.0, "foliage")
