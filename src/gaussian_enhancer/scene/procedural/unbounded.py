"""`unbounded`: a subject on open ground with surroundings up to distant hills, as in Mip-NeRF360."""

from dataclasses import replace

import numpy as np

from gaussian_enhancer.scene.procedural import furniture, nature, shapes
from gaussian_enhancer.scene.procedural.daylight import daylight
from gaussian_enhancer.scene.procedural.draft import Draft, SkySpec
from gaussian_enhancer.scene.procedural.palette import Palette
from gaussian_enhancer.scene.procedural.paths import orbit
from gaussian_enhancer.scene.procedural.vector import Vector


def draft_unbounded(seed: int) -> Draft:
    """Make the draft of the world that a seed determines."""
    rng = np.random.default_rng([seed, 360])
    black: Vector = (0.0, 0.0, 0.0)
    radius = rng.uniform(2.6, 3.4)
    draft = Draft(
        rng=rng,
        sky=SkySpec(black, black, black, 0),
        path=orbit(seed, (0.0, 0.0, 0.65), radius, (1.0, 1.9)),
        field_of_view=56.0,
        ambient_box=((-5.0, -5.0, -0.2), (5.0, 5.0, 3.6)),
        probe=(0.0, 0.0, 1.6),
    )
    daylight(draft, 9.0)
    p = Palette(draft)
    _ground(p)
    [_garden_table, _bicycle_bench, _monument, _workbench][int(rng.integers(4))](p)
    _middle(p, radius)
    _far(p)
    return draft


def _ground(p: Palette) -> None:
    """Ground: one surface under the subject, another around it, slightly uneven beyond 9 m, and blades of grass."""
    rng = p.draft.rng
    materials = ["turf", "gravel", "cobble", "concrete", "turf"]
    inner_material, outer_material = str(rng.choice(materials[1:])), str(rng.choice(materials[:3]))
    radius = rng.uniform(1.5, 2.4)
    t = np.linspace(0, 1, 40)
    axis = np.sign(np.linspace(-1, 1, 81)) * np.abs(np.linspace(-1, 1, 81)) ** 2.5 * 420
    waves = rng.normal(size=(6, 2)) * 0.05

    def height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        unevenness = np.clip((np.hypot(x, y) - 9) / 40, 0, 1)
        return -0.012 + unevenness * sum(0.5 * np.sin(x * w[0] * 2 + y * w[1] * 2 + 9 * w[0]) for w in waves)

    p.add(shapes.terrain(axis, axis, height), outer_material, casts=False)
    disk = np.stack([radius * (1 - t), 0.012 + 0 * t], axis=1)
    p.add(shapes.lathe(np.concatenate([[[radius, -0.02]], disk]), 64), "brick 2", casts=False)
    square = shapes.terrain(
        np.linspace(-radius, radius, 20) * 0.97, np.linspace(-radius, radius, 20) * 0.97, lambda x, y: 0.018 + 0 * x
    )
    inside = np.linalg.norm(square.positions[square.faces].mean(1)[:, :2], axis=1) < radius * 0.93
    p.add(replace(square, faces=square.faces[inside]), inner_material, casts=False)
    if outer_material == "turf":
        nature.grass(p, 9000, radius, radius + 3.5, rng.uniform(0.06, 0.16))
    else:
        nature.grass(p, 2500, radius * 0.95, radius + 2.5, rng.uniform(0.05, 0.12))


def _set_table(p: Palette, z: float, reach: float) -> None:
    """Objects on a table top at height `z`, within `reach` of its centre."""
    rng = p.draft.rng
    furniture.vase(p, (0.0, 0.0, z), rng.uniform(0.2, 0.32), flowers=True, material="glaze")
    furniture.vase(p, (-0.5 * reach, 0.3 * reach, z), rng.uniform(0.14, 0.24), flowers=False)
    furniture.flat_print(p, "page", (0.15 * reach, -0.1 * reach, z + 0.003), (0.36, -0.1, 0), (-0.1, -0.36, 0))
    furniture.books(p, (-0.55 * reach, -0.45 * reach, z), rng.uniform(-0.4, 0.4), 0.3, 0.24)
    for _ in range(5):
        x, y = rng.uniform(-0.55, 0.55, 2) * reach
        r = rng.uniform(0.03, 0.05)
        p.add(
            shapes.ellipsoid((r, r, r * 0.92)).transform((x, y, z + r)),
            rng.choice(["glaze 2", "paint", "chrome", "marble"]),
        )


def _garden_table(p: Palette) -> None:
    rng = p.draft.rng
    height = rng.uniform(0.6, 0.75)
    size = rng.uniform(0.9, 1.25)
    furniture.table(p, (0, 0, 0.02), rng.uniform(0, 3), (size, size), height)
    _set_table(p, height + 0.026, size * 0.55)
    for k in range(int(rng.integers(1, 4))):
        a = 2.1 * k + rng.uniform(0, 0.6)
        furniture.chair(p, (1.0 * np.cos(a), 1.0 * np.sin(a), 0.02), a - np.pi / 2)


def _bicycle_bench(p: Palette) -> None:
    rng = p.draft.rng
    slats = [shapes.box((1.6, 0.09, 0.03)).transform((0, 0.5 + 0.11 * k, 0.45)) for k in range(4)]
    slats += [
        shapes.box((1.6, 0.03, 0.09)).transform((0, 0.98 + 0.02 * k, 0.55 + 0.13 * k), tilt=-0.15) for k in range(3)
    ]
    for slat in slats:
        p.add(slat, "wood")
    for x in (-0.65, 0.65):
        for start, end in (
            ((x, 0.5, 0), (x, 0.5, 0.45)),
            ((x, 0.9, 0), (x, 1.04, 0.95)),
            ((x, 0.47, 0.43), (x, 0.95, 0.43)),
        ):
            p.add(shapes.rod(start, end, 0.025), "iron")
    furniture.bicycle(p, (rng.uniform(-0.2, 0.2), rng.uniform(-0.1, 0.2), 0.02), rng.uniform(-0.2, 0.2))
    furniture.flat_print(p, "page", (0.2, 0.55, 0.485), (0.3, 0.04, 0), (-0.04, 0.3, 0))
    furniture.potted(p, (-1.15, 0.6, 0.02), rng.uniform(0.6, 1.0))


def _monument(p: Palette) -> None:
    rng = p.draft.rng
    for k in range(3):
        side = 1.3 - 0.32 * k
        p.add(shapes.box((side, side, 0.2)).transform((0, 0, 0.02 + 0.2 * k)), "marble" if k == 2 else "concrete")
    furniture.flat_print(
        p, "sign", (-0.3, -0.336, 0.6), (0.6, 0, 0), (0, 0, -0.17), (0.0, 0.25 * int(rng.integers(4)), 1.0, 0.25)
    )
    if rng.random() < 0.5:
        p.add(furniture.knot(rng, 0.36, 0.055).transform((0, 0, 1.02), tilt=rng.uniform(0, 1.2)), "chrome")
        p.add(shapes.rod((0, 0, 0.6), (0, 0, 0.95), 0.05), "marble")
    else:
        furniture.vase(p, (0, 0, 0.62), 0.7, flowers=True, material="marble 2")
    for a in np.arange(0, 2 * np.pi, np.pi / 4):
        x, y = 1.15 * np.cos(a), 1.15 * np.sin(a)
        post = np.array([[0.045, 0], [0.04, 0.5], [0.055, 0.52], [0.03, 0.6], [0, 0.62]])
        p.add(shapes.lathe(post, 12).transform((x, y, 0.02)), "iron")
        b = a + np.pi / 4
        p.add(shapes.wire((x, y, 0.55), (1.15 * np.cos(b), 1.15 * np.sin(b), 0.55), 0.16, 0.009, 6), "chrome")


def _workbench(p: Palette) -> None:
    rng = p.draft.rng
    for x, y, z in ((0, 0, 0), (0.62, 0.1, 0), (0.25, 0.05, 0.42)):
        p.add(
            shapes.box((0.55, 0.4, 0.4)).transform((x - 0.3, y, z + 0.02), yaw=rng.normal() * 0.1),
            f"wood {int(rng.integers(1, 3))}",
        )
    furniture.flat_print(p, "poster", (-0.5, -0.24, 0.4), (0.36, 0, 0), (0, 0, -0.34))
    furniture.lattice(p, (-0.75, 0.2, 0.02), 1.2, (0.7, 1.0), 0.11, 0.006)
    furniture.potted(p, (-0.05, 0.03, 0.84), rng.uniform(0.5, 0.8))
    furniture.vase(p, (-0.35, -0.02, 0.42), 0.26, flowers=False)
    tyre, rim = furniture.wheel(0.33, 24, 0.02)
    p.add(tyre.transform((0.75, -0.3, 0.36), tilt=0.2, yaw=0.3), "rubber")
    p.add(rim.transform((0.75, -0.3, 0.36), tilt=0.2, yaw=0.3), "chrome")
    for _ in range(4):
        a = rng.uniform(0, 6.3)
        nature.stone(p, (1.1 * np.cos(a), 1.1 * np.sin(a), 0.05), rng.uniform(0.1, 0.22))


def _middle(p: Palette, radius: float) -> None:
    """Trees, bushes, stones, fences and a lamp post outside the ring of cameras."""
    rng = p.draft.rng
    offset = rng.uniform(0, 6.3)
    for k in range(14):
        a, r = offset + k * 0.45 + rng.normal() * 0.12, radius + rng.uniform(1.8, 8.0)
        at = (r * np.cos(a), r * np.sin(a), -0.02)
        kind = rng.integers(5)
        if kind <= 1:
            nature.tree(p, at, rng.uniform(3.5, 7.5), 420, str(rng.choice(["", " 3"])))
        elif kind == 2:
            nature.bush(p, at, rng.uniform(0.5, 1.1), 200)
        elif kind == 3:
            furniture.lattice(p, at, a + np.pi / 2, (rng.uniform(2, 4), 1.2), 0.14, 0.008, "wood 2")
        else:
            nature.stone(p, at, rng.uniform(0.4, 1.0))
    nature.lamp_post(p, (-(radius + 2) * np.cos(offset), -(radius + 2) * np.sin(offset), 0), 3.6)


def _far(p: Palette) -> None:
    """Houses, trees and two rings of hills, at 13 to 630 metres."""
    rng = p.draft.rng
    for k in range(int(rng.integers(3, 7))):
        a, r = rng.uniform(0, 6.3), rng.uniform(18, 60)
        size = (rng.uniform(7, 14), rng.uniform(6, 9), rng.uniform(3, 9))
        nature.house(
            p, (r * np.cos(a), r * np.sin(a), -0.6), a + np.pi / 2, size, ["brick", "plaster", "plaster 2"][k % 3]
        )
    for _ in range(34):
        a, r = rng.uniform(0, 6.3), rng.uniform(13, 55)
        nature.tree(p, (r * np.cos(a), r * np.sin(a), -0.5), rng.uniform(5, 11), 150, str(rng.choice(["", " 3"])))
    nature.hills(p, 160.0, rng.uniform(6, 20), "foliage")
    nature.hills(p, 420.0, rng.uniform(30, 70), "foliage 2")
