"""`harbour`: boats in a basin, photographed from a curved mole. No training scene is from this family.

Its textures, objects, lighting and camera path are not used by other families (`harbour_materials`, `vessels`,
`quayside`), so a test on it measures generalisation beyond the other families. It shares the renderer, basic shapes and
noise with them.
"""

import numpy as np

from gaussian_enhancer.scene.procedural import quayside, shapes, vessels
from gaussian_enhancer.scene.procedural.daylight import towards
from gaussian_enhancer.scene.procedural.draft import Draft, LightSpec, SkySpec
from gaussian_enhancer.scene.procedural.harbour_materials import MATERIALS
from gaussian_enhancer.scene.procedural.noise import wavy
from gaussian_enhancer.scene.procedural.palette import Palette
from gaussian_enhancer.scene.procedural.paths import mole
from gaussian_enhancer.scene.procedural.textures import clouds
from gaussian_enhancer.scene.procedural.vector import Vector

WATER = -0.75
_RADIUS = 9.6

_HOURS: tuple[tuple[Vector, Vector, Vector, float, float], ...] = (
    # zenith, horizon, sun colour, elevation in degrees, exposure
    ((0.16, 0.24, 0.46), (0.95, 0.62, 0.38), (2.5, 1.35, 0.62), 11.0, 1.05),
    ((0.34, 0.36, 0.46), (0.86, 0.68, 0.62), (1.7, 1.15, 0.85), 17.0, 1.1),
    ((0.42, 0.47, 0.52), (0.56, 0.60, 0.63), (0.4, 0.42, 0.44), 60.0, 1.25),
    ((0.12, 0.18, 0.36), (0.42, 0.44, 0.56), (0.5, 0.5, 0.66), 24.0, 1.6),
)


def draft_harbour(seed: int) -> Draft:
    """Make the draft of the world that a seed determines."""
    rng = np.random.default_rng([seed, 2077])
    zenith, horizon, sun_colour, elevation, exposure = _HOURS[int(rng.integers(len(_HOURS)))]
    sun_direction = towards(elevation + rng.uniform(-4, 4), rng.uniform(np.pi * 1.1, np.pi * 1.9))
    black: Vector = (0.0, 0.0, 0.0)
    draft = Draft(
        rng=rng,
        sky=SkySpec(black, black, black, 0),
        path=mole(seed, (0.0, 0.0, 0.7), _RADIUS, (-2.55, -0.6), (1.65, 2.5)),
        field_of_view=60.0,
        ambient_box=((-11.0, -11.0, WATER - 0.1), (11.0, 11.0, 6.0)),
        exposure=exposure * float(rng.uniform(0.92, 1.08)),
        haze=0.0022 * float(rng.uniform(0.4, 1.6)),
        probe=(0.0, -2.0, 1.6),
    )
    ground = tuple(0.45 * np.array(horizon) * np.array([0.75, 0.95, 1.05]))
    draft.sky = SkySpec(zenith, horizon, ground, draft.texture(clouds(rng)), tuple(sun_direction))
    draft.lights.append(LightSpec(tuple(sun_direction * 900), (0.0, 1.0, 0.0), 15.0, sun_colour, side=3072))
    lamp_strength = 0.9 * rng.uniform(0.7, 1.2)
    lamp_position = (rng.uniform(-2, 2), rng.uniform(0.5, 2.5), 3.4)
    draft.lights.append(
        LightSpec(
            lamp_position,
            (lamp_position[0], lamp_position[1], 0.0),
            9.0,
            (lamp_strength, 0.72 * lamp_strength, 0.4 * lamp_strength),
            local=True,
            side=1024,
        )
    )
    p = Palette(draft, MATERIALS)
    _water(p)
    _mole(p)
    _basin(p)
    _far_quay(p)
    return draft


def _water(p: Palette) -> None:
    axis = np.sign(np.linspace(-1, 1, 61)) * np.abs(np.linspace(-1, 1, 61)) ** 2.2 * 420
    p.add(shapes.terrain(axis, axis, lambda x, y: WATER + 0 * x), "water", casts=False)


def _mole(p: Palette) -> None:
    """The mole along which the cameras move, with objects at its edge that are too low to hide the basin."""
    rng = p.draft.rng
    quayside.curved_mole(p, (6.7, 13.5), (-3.0, -0.14), WATER - 0.9)
    for a in np.arange(-2.8, -0.3, 0.62) + rng.uniform(-0.1, 0.1):
        quayside.bollard(p, (7.05 * np.cos(a), 7.05 * np.sin(a), 0.1))
    for a in rng.uniform(-2.6, -0.5, 4):
        at, kind = (7.2 * np.cos(a), 7.2 * np.sin(a), 0.1), int(rng.integers(3))
        if kind == 0:
            quayside.pots(p, at, a + np.pi / 2, int(rng.integers(1, 3)))
        elif kind == 1:
            quayside.buoys(p, at, int(rng.integers(4, 8)))
        else:
            for k in range(3):
                crate = (at[0] + 0.1 * rng.normal(), at[1] + 0.1 * rng.normal(), 0.1 + 0.29 * k)
                p.add(shapes.box((0.6, 0.4, 0.28)).transform(crate, yaw=a + rng.normal() * 0.2), f"crate {k}")
    quayside.road_mirror(p, (7.0 * np.cos(-0.42), 7.0 * np.sin(-0.42), 0.1), float(rng.uniform(-1.1, -0.7)))
    for a in rng.uniform(-2.9, -0.25, 5):
        quayside.reeds(p, (6.3 * np.cos(a), 6.3 * np.sin(a), WATER), rng.uniform(0.5, 1.0), 260)


def _basin(p: Palette) -> None:
    """Pontoon with boats on both sides, mooring ropes, and sometimes a yacht behind it."""
    rng = p.draft.rng
    slant = rng.uniform(-0.25, 0.25)
    start, end = (-6.2, 1.2 - 6 * slant * 0.3, WATER + 0.42), (6.6, 1.2 + 6 * slant * 0.3, WATER + 0.42)
    quayside.pontoon(p, start, end)
    trawler_left = rng.random() < 0.5
    boats = (
        [("trawler", -2.6, 3.6), ("yacht", 3.4, 3.2)] if trawler_left else [("yacht", -3.2, 3.2), ("trawler", 3.0, 3.7)]
    )
    for kind, x, y in boats:
        boat_yaw = rng.normal() * 0.08 + (np.pi if rng.random() < 0.5 else 0.0)
        at = (x + rng.uniform(-0.4, 0.4), y, WATER)
        if kind == "trawler":
            vessels.trawler(p, at, boat_yaw, rng.uniform(7.5, 9.0))
        else:
            vessels.yacht(p, at, boat_yaw, rng.uniform(6.0, 7.4), hoisted=bool(rng.random() < 0.45))
        p.add(shapes.wire((x - 1.5, y - 1.0, 0.5), (x - 0.5, 1.4, WATER + 0.5), 0.12, 0.016, 5), "rope")
    for k, x in enumerate((-3.6, 0.2, 3.9)):
        yaw = rng.uniform(-0.5, 0.5) + np.pi / 2 * (k == 1)
        vessels.rowing_boat(p, (x + rng.uniform(-0.5, 0.5), -1.9 + rng.uniform(-0.5, 0.3), WATER), yaw)
        p.add(shapes.wire((x, -1.4, WATER + 0.4), (x + 0.3, 0.7, WATER + 0.5), 0.2, 0.013, 5), "rope")
    if rng.random() < 0.7:
        vessels.yacht(p, (rng.uniform(-1, 1), 7.6, WATER), rng.normal() * 0.2, rng.uniform(6.5, 8.0))
    quayside.net_rack(p, (rng.uniform(-1.5, 1.5), 1.25, WATER + 0.45), slant * 0.3, 2.6)
    quayside.pots(p, (-5.0, 1.1, WATER + 0.45), 0.1, 2)
    quayside.buoys(p, (5.2, 1.3, WATER + 0.45), 6)
    posts: list[Vector] = [(x, 1.2 + x * slant * 0.3 + 0.4, WATER + 0.4) for x in (-6.0, -1.9, 2.2, 6.3)]
    quayside.festoon(p, posts, 3.1, 6)


def _far_quay(p: Palette) -> None:
    """Background beyond the basin, from 10 to about 270 metres: sheds, a crane, masts, pines, a lighthouse, hills."""
    rng = p.draft.rng
    xs = np.linspace(-70, 70, 15)
    p.add(shapes.terrain(xs, np.linspace(13, 60, 8), lambda x, y: 0.3 + 0.02 * (y - 13)), "paving 2", casts=False)
    p.add(shapes.quad((-70, 13, 0.3), (140, 0, 0), (0, 0, -2.0)), "ashlar")
    x = -46.0
    while x < 46:
        size = (rng.uniform(8, 13), rng.uniform(7, 10), rng.uniform(4.5, 7.5))
        if rng.random() < 0.75:
            quayside.warehouse(p, (x + size[0] / 2, 20 + rng.uniform(0, 4), 0.4), rng.normal() * 0.05, size)
        x += size[0] + rng.uniform(0.8, 4.5)
    quayside.crane(p, (rng.uniform(-14, 14), 15.2, 0.3), rng.uniform(-0.6, 0.6) + np.pi * (rng.random() < 0.5), 9.0)
    for _ in range(26):
        quayside.pine(p, (rng.uniform(-60, 60), rng.uniform(27, 52), 0.5), rng.uniform(7, 13), 200)
    for s in (-1, 1):
        quayside.pine(p, (s * rng.uniform(11, 15), 15 + rng.uniform(0, 2), 0.3), rng.uniform(5, 8), 320)
    vessels.moored_fleet(p, 14, (9.8, 12.2), 34.0, WATER)
    for u in rng.uniform(-12, 12, 5):
        quayside.pots(p, (u, 14.0, 0.35), 0.0, 3)
    quayside.lighthouse(p, (float(rng.choice([-1, 1])) * rng.uniform(30, 48), 95.0, 2.0), 17.0)
    angle = np.linspace(0.1, np.pi - 0.1, 121)
    crest = np.maximum(26 * (0.7 + 0.6 * wavy(rng, angle, (3, 7, 12, 20, 33, 51))), 3)
    p.add(shapes.hillside(angle, crest, 190 * (1 + 0.4 * np.linspace(0, 1, 7)), -1.0), "wood", casts=False)
