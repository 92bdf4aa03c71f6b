"""`object`: one detailed object on a white background with exact coverage, as in NeRF-Synthetic."""

import numpy as np

from gaussian_enhancer.scene.procedural import furniture, shapes
from gaussian_enhancer.scene.procedural.draft import Draft, LightSpec, SkySpec
from gaussian_enhancer.scene.procedural.mesh import join_parts
from gaussian_enhancer.scene.procedural.outdoor import vehicle
from gaussian_enhancer.scene.procedural.palette import Palette
from gaussian_enhancer.scene.procedural.paths import hemisphere


def draft_object(seed: int) -> Draft:
    """Make the draft of the world that a seed determines."""
    rng = np.random.default_rng([seed, 800])
    draft = Draft(
        rng=rng,
        sky=SkySpec((0.75, 0.78, 0.85), (0.5, 0.52, 0.55), (0.3, 0.29, 0.28), 0, studio=True),
        path=hemisphere(seed, (0.0, 0.0, 0.5), 4.0),
        field_of_view=39.6,
        ambient_box=((-1.4, -1.4, -0.2), (1.4, 1.4, 1.8)),
        background=(1.0, 1.0, 1.0),
        probe=(0.0, 0.0, 3.0),
    )
    for azimuth, height, strength in ((rng.uniform(0, 6.3), 1.0, 1.6), (rng.uniform(0, 6.3), 0.5, 0.5)):
        direction = np.array([np.cos(azimuth), np.sin(azimuth), height])
        colour = np.array([1.0, rng.uniform(0.9, 1.0), rng.uniform(0.78, 1.0)]) * strength
        draft.lights.append(
            LightSpec(tuple(direction / np.linalg.norm(direction) * 120), (0, 0, 0.5), 2.0, tuple(colour), side=1536)
        )
    p = Palette(draft)
    [_model, _bricks, _ficus, _still_life, _machine, _seat][int(rng.integers(6))](p)
    return draft


def _model(p: Palette) -> None:
    """Vehicle on a tiled base with a fence, a sign and a potted plant."""
    rng = p.draft.rng
    p.add(shapes.box((2.2, 1.5, 0.08)).transform((0, 0, -0.1)), "tiles")
    size = 0.45
    start = len(p.draft.builder.parts)
    vehicle(p, (0.0, 0.0, 0.0), rng.uniform(-0.2, 0.2))
    parts = p.draft.builder.parts
    parts[start:] = [part.transform(scale=size, at=(0, -0.1, -0.02)) for part in parts[start:]]
    furniture.lattice(p, (0, 0.65, -0.02), 0.0, (2.0, 0.5), 0.1, 0.006)
    furniture.flat_print(
        p, "sign", (-0.5, 0.63, 0.42), (1.0, 0, 0), (0, 0, -0.25), (0.0, 0.25 * int(rng.integers(4)), 1.0, 0.25)
    )
    furniture.potted(p, (0.9, -0.5, -0.02), 0.5)


def _bricks(p: Palette) -> None:
    """Tower of studded toy bricks with wheels, a lattice and a poster."""
    rng, stud_pitch = p.draft.rng, 0.1
    for level in range(9):
        for _ in range(7):
            x, y = rng.integers(-6 + level // 2, 5 - level // 2, 2) * stud_pitch
            w, d = int(rng.integers(1, 5)), int(rng.integers(1, 4))
            parts = [shapes.box((w * stud_pitch * 0.99, d * stud_pitch * 0.99, 0.119)).transform((x, y, level * 0.12))]
            for i in range(w):
                for j in range(d):
                    stud = np.array([[0.03, 0.0], [0.03, 0.018], [0.026, 0.022], [0.0, 0.022]])
                    parts.append(
                        shapes.lathe(stud, 12).transform(
                            (x + (i - w / 2 + 0.5) * stud_pitch, y + (j - d / 2 + 0.5) * stud_pitch, (level + 1) * 0.12)
                        )
                    )
            p.add(join_parts(parts), f"paint {int(rng.integers(6))}")
    for k in range(4):
        tyre, rim = furniture.wheel(0.17, 8, 0.045)
        at = (0.55 * (-1) ** k, 0.62 if k > 1 else -0.62, 0.17)
        p.add(tyre.transform(at), "rubber")
        p.add(rim.transform(at), "chrome")
    furniture.lattice(p, (0, 0.0, 1.08), rng.uniform(0, 3), (0.8, 0.4), 0.09, 0.008)
    furniture.flat_print(p, "poster", (-0.3, -0.66, 0.6), (0.5, 0, 0), (0, 0, -0.4))
    p.add(shapes.box((1.6, 1.5, 0.05)).transform((0, 0, -0.05)), "paint 7")


def _ficus(p: Palette) -> None:
    """Plant in a fluted pot."""
    rng = p.draft.rng
    pot = shapes.smooth_profile([(0.22, 0.0), (0.3, 0.12), (0.36, 0.3), (0.3, 0.42), (0.34, 0.46)], 30)
    p.add(
        shapes.lathe(
            np.concatenate([[[0, 0]], pot, [[0.29, 0.42], [0, 0.4]]]), 60, int(rng.integers(8, 20)), 0.06
        ).transform((0, 0, -0.4)),
        "glaze",
    )
    for k in range(3):
        furniture.plant(
            p, (*(rng.normal(size=2) * 0.06), 0.0), rng.uniform(0.8, 1.25), 160, "sprig" if k % 2 else "sprig 2"
        )
    p.add(shapes.lathe(np.array([[0, -0.4], [0.5, -0.4], [0.52, -0.43], [0, -0.44]]), 48), "wood")


def _still_life(p: Palette) -> None:
    """Vases, books, a page, balls and a torus knot on a small table."""
    rng = p.draft.rng
    furniture.table(p, (0, 0, -0.35), 0.2, (1.5, 1.2), 0.5)
    z = 0.165
    furniture.vase(p, (0, 0.1, z), 0.55, flowers=True)
    furniture.vase(p, (-0.45, 0.15, z), 0.35, flowers=False, material="chrome")
    furniture.vase(p, (0.42, 0.2, z), 0.3, flowers=False)
    furniture.books(p, (-0.45, -0.4, z), 0.2, 0.4, 0.28)
    furniture.flat_print(p, "page", (0.08, -0.1, z + 0.003), (0.4, 0.1, 0), (0.1, -0.35, 0))
    p.add(furniture.knot(rng, 0.15, 0.03).transform((0.5, -0.25, z + 0.1)), "glaze 2")
    for _ in range(5):
        r = rng.uniform(0.03, 0.06)
        p.add(
            shapes.ellipsoid((r, r, r)).transform((rng.uniform(-0.2, 0.6), rng.uniform(-0.2, 0.1), z + r)),
            rng.choice(["paint", "glaze 3", "marble"]),
        )


def _machine(p: Palette) -> None:
    """Gears, a tank, pipes and cables in a frame."""
    rng = p.draft.rng
    corners = [(a * 0.8, b * 0.5) for a in (-1, 1) for b in (-1, 1)]
    frame = [shapes.beam((*c, -0.4), (*c, 1.1), 0.06, 0.06) for c in corners]
    frame += [
        shapes.beam((-0.8, b * 0.5, z), (0.8, b * 0.5, z), 0.05, 0.05) for b in (-1, 1) for z in (-0.38, 0.35, 1.08)
    ]
    frame += [shapes.beam((a * 0.8, -0.5, z), (a * 0.8, 0.5, z), 0.05, 0.05) for a in (-1, 1) for z in (-0.38, 1.08)]
    p.add(join_parts(frame), "paint")
    for k in range(6):
        teeth, r = int(rng.integers(12, 30)), rng.uniform(0.14, 0.3)
        gear = shapes.lathe(
            np.array(
                [
                    [0.04, 0.0],
                    [r, 0.0],
                    [r, 0.06],
                    [r * 0.8, 0.06],
                    [r * 0.75, 0.03],
                    [0.06, 0.03],
                    [0.06, 0.1],
                    [0.0, 0.1],
                ]
            ),
            teeth * 8,
            teeth,
            0.1,
        )
        p.add(
            gear.transform((rng.uniform(-0.6, 0.6), -0.35 + 0.13 * k, rng.uniform(-0.1, 0.9)), tilt=np.pi / 2),
            rng.choice(["chrome", "iron", "chrome 2"]),
        )
    tank = shapes.smooth_profile([(0.02, 0.0), (0.22, 0.06), (0.25, 0.2), (0.25, 0.6), (0.2, 0.78), (0.05, 0.85)], 30)
    p.add(shapes.lathe(tank, 40).transform((0.4, 0.15, -0.35)), "paint 2")
    for _ in range(9):
        ends = rng.uniform((-0.75, -0.45, -0.3), (0.75, 0.45, 1.0), (2, 3))
        p.add(
            shapes.wire(tuple(ends[0]), tuple(ends[1]), rng.uniform(0.0, 0.2), rng.uniform(0.006, 0.025), 8, 24),
            rng.choice(["rubber", "glaze", "iron"]),
        )
    furniture.lattice(p, (0, 0.54, -0.35), 0.0, (1.5, 0.7), 0.09, 0.006)
    furniture.flat_print(
        p, "sign", (-0.7, -0.53, 0.32), (1.2, 0, 0), (0, 0, -0.3), (0.0, 0.25 * int(rng.integers(4)), 1.0, 0.25)
    )
    furniture.flat_print(p, "page", (0.1, -0.53, 0.98), (0.4, 0, 0), (0, 0, -0.5))
    p.add(shapes.box((1.9, 1.3, 0.06)).transform((0, 0, -0.46)), "concrete")


def _seat(p: Palette) -> None:
    """Chair with books on it, a potted plant, a bicycle wheel and a page."""
    rng = p.draft.rng
    start = len(p.draft.builder.parts)
    furniture.chair(p, (0, 0, 0), 0.3)
    furniture.books(p, (-0.16, -0.12, 0.5), 0.3, 0.28, 0.22)
    furniture.potted(p, (0.42, -0.25, 0), 0.55)
    tyre, rim = furniture.wheel(0.3, 28, 0.016)
    p.add(tyre.transform((-0.1, -0.32, 0.31), tilt=0.25), "rubber")
    p.add(rim.transform((-0.1, -0.32, 0.31), tilt=0.25), "chrome")
    furniture.flat_print(p, "page", (-0.5, -0.3, 0.004), (0.3, -0.1, 0), (0.1, 0.3, 0))
    p.add(shapes.lathe(np.array([[0, 0.002], [0.75, 0.002], [0.77, -0.03], [0, -0.03]]), 64), "wood")
    parts = p.draft.builder.parts
    scale = 1.35 + rng.uniform(0, 0.1)
    parts[start:] = [part.transform(scale=scale, at=(0, 0, -0.25)) for part in parts[start:]]
