"""Objects of a waterfront: moles, pontoons, pots, nets, buoys, reeds, pines, warehouses, cranes, a lighthouse.

Each function adds one object, or one group of objects, to a draft. Lengths are in metres.
"""

from itertools import pairwise

import numpy as np

from gaussian_enhancer.scene.procedural import shapes
from gaussian_enhancer.scene.procedural.mesh import join_parts
from gaussian_enhancer.scene.procedural.palette import Palette
from gaussian_enhancer.scene.procedural.vector import Vector


def curved_mole(p: Palette, radii: tuple[float, float], sweep: tuple[float, float], foot: float) -> None:
    """Breakwater along an arc about the origin: a paved top, and an ashlar wall on the inner side with a coping."""
    angle = np.linspace(*sweep, 61)
    r = np.linspace(*radii, 9)[:, None]
    top = np.stack(np.broadcast_arrays(r * np.cos(angle), r * np.sin(angle), 0 * r * angle), axis=-1)
    p.add(shapes.sheet(top, np.stack(np.broadcast_arrays(angle * radii[0], r), -1)), "paving", casts=False)
    z = np.linspace(0, foot, 7)[:, None]
    wall = np.stack(np.broadcast_arrays(radii[0] * np.cos(angle), radii[0] * np.sin(angle), z), axis=-1)
    p.add(shapes.sheet(wall, np.stack(np.broadcast_arrays(angle * radii[0], -z), -1)), "ashlar")
    for a in np.arange(*sweep, 0.9 / radii[0]):
        at = ((radii[0] + 0.16) * np.cos(a), (radii[0] + 0.16) * np.sin(a), -0.02)
        p.add(shapes.box((0.4, 0.86, 0.14)).transform(at, yaw=a), "ashlar 2")


def bollard(p: Palette, at: Vector) -> None:
    """Mooring bollard with turns of rope round it."""
    profile = np.array([[0.2, 0], [0.2, 0.05], [0.12, 0.09], [0.1, 0.36], [0.17, 0.42], [0.17, 0.48], [0.0, 0.52]])
    p.add(shapes.lathe(profile, 20).transform(at), "tar")
    turn = np.linspace(0, 6 * np.pi, 70)
    path = np.stack([0.135 * np.cos(turn), 0.135 * np.sin(turn), 0.14 + 0.011 * turn], axis=1)
    p.add(shapes.tube(path, 0.02, 6).transform(at), "rope")


def pontoon(p: Palette, start: Vector, end: Vector) -> None:
    """Floating walkway of cross boards between piles, with cleats."""
    width = 1.1
    a, b = np.asarray(start, dtype=float), np.asarray(end, dtype=float)
    length = float(np.hypot(*(b - a)[:2]))
    yaw = float(np.arctan2(*(b - a)[1::-1]))
    boards = [shapes.box((0.135, width, 0.03)).transform((x, 0, 0)) for x in np.arange(0.08, length, 0.15)]
    floats = [shapes.box((1.3, width * 0.8, 0.35)).transform((x, 0, -0.36)) for x in np.arange(0.9, length, 1.9)]
    p.add(join_parts(boards).transform(start, yaw=yaw), "deck 3")
    p.add(join_parts(floats).transform(start, yaw=yaw), "tar")
    piles = [
        shapes.rod((x, s * (width / 2 + 0.12), -1.6), (x, s * (width / 2 + 0.12), 1.1), 0.1, 12)
        for x in np.arange(0.6, length, 3.1)
        for s in (-1, 1)
    ]
    p.add(join_parts(piles).transform(start, yaw=yaw), "pile")
    cleats = [
        shapes.rod((x - 0.12, s * width * 0.44, 0.08), (x + 0.12, s * width * 0.44, 0.08), 0.02)
        for x in np.arange(1.2, length, 1.7)
        for s in (-1, 1)
    ]
    p.add(join_parts(cleats).transform(start, yaw=yaw), "steel")


def pots(p: Palette, at: Vector, yaw: float, rows: int) -> None:
    """Stack of lobster pots: hoops and laths under netting."""
    rng = p.draft.rng
    angle = np.linspace(0, np.pi, 13)
    arch = np.stack([0 * angle, 0.24 * np.cos(angle), 0.3 * np.sin(angle)], axis=1)
    hoops = [shapes.tube(arch + np.array([x, 0, 0]), 0.012, 5) for x in (-0.34, 0.0, 0.34)]
    laths = [
        shapes.rod((-0.36, 0.24 * np.cos(a), 0.3 * np.sin(a)), (0.36, 0.24 * np.cos(a), 0.3 * np.sin(a)), 0.008, 4)
        for a in np.linspace(0, np.pi, 7)
    ]
    slats = [shapes.box((0.76, 0.07, 0.025)).transform((0, y, -0.02)) for y in (-0.22, 0.0, 0.22)]
    frame = join_parts(hoops + laths + slats)
    u, a = np.meshgrid(np.linspace(-0.35, 0.35, 5), angle)
    mesh = shapes.sheet(np.stack([u, 0.235 * np.cos(a), 0.295 * np.sin(a)], -1), np.stack([u, a * 0.27], -1))
    for row in range(rows):
        for k in range(rows - row + 1):
            c, s = np.cos(yaw), np.sin(yaw)
            x = (k - (rows - row) / 2) * 0.82 + rng.normal() * 0.03
            position = (at[0] + c * x, at[1] + s * x, at[2] + 0.03 + row * 0.33)
            turn = yaw + rng.normal() * 0.06
            p.add(frame.transform(position, yaw=turn), "spar")
            p.add(mesh.transform(position, yaw=turn), "net")


def net_rack(p: Palette, at: Vector, yaw: float, width: float) -> None:
    """Rack of poles with three hanging nets, which have corks along their lower edge."""
    rng = p.draft.rng
    poles = [shapes.rod((x, 0, 0), (x, 0, 1.75), 0.04) for x in np.linspace(-width / 2, width / 2, 4)]
    poles.append(shapes.rod((-width / 2 - 0.2, 0, 1.7), (width / 2 + 0.2, 0, 1.7), 0.035))
    p.add(join_parts(poles).transform(at, yaw=yaw), "spar")
    for k in range(3):
        left = -width / 2 + k * width / 3 + 0.05
        net_height = rng.uniform(1.1, 1.5)
        net = shapes.curtain(width / 3 - 0.12, net_height, int(rng.integers(3, 6)), 0.09)
        p.add(net.transform((left, 0.03, 1.7 - net_height)).transform(at, yaw=yaw), f"net {k % 2}")
        corks = [
            shapes.ellipsoid((0.05, 0.05, 0.07), 10).transform((left + x, 0.05 * np.sin(9 * x), 1.7 - net_height))
            for x in np.arange(0.05, width / 3 - 0.15, 0.2)
        ]
        p.add(join_parts(corks).transform(at, yaw=yaw), "buoy")


def buoys(p: Palette, at: Vector, count: int) -> None:
    """Heap of round and elongated buoys with ropes."""
    rng = p.draft.rng
    for _ in range(count):
        x, y = rng.normal(size=2) * 0.35
        r = rng.uniform(0.11, 0.24)
        radii = (r, r, r * 1.15) if rng.random() < 0.6 else (r * 0.6, r * 0.6, r * 1.6)
        position = (at[0] + x, at[1] + y, at[2] + radii[2] * 0.9)
        p.add(shapes.ellipsoid(radii, 22).transform(position, tilt=rng.normal() * 0.3), f"buoy {int(rng.integers(3))}")
        rope_end = (position[0] + rng.normal() * 0.4, position[1] + rng.normal() * 0.4, at[2] + 0.015)
        p.add(shapes.wire((position[0], position[1], position[2] + radii[2]), rope_end, 0.05, 0.012, 5), "rope")


def reeds(p: Palette, centre: Vector, radius: float, count: int) -> None:
    """Reeds at the water's edge: tall blades, and stems with heads."""
    rng = p.draft.rng
    r, a = radius * np.sqrt(rng.random(count)), rng.uniform(0, 2 * np.pi, count)
    roots = np.stack([r * np.cos(a), 0.5 * r * np.sin(a), np.zeros(count)], axis=1) + np.asarray(centre)
    p.add(shapes.blades(rng, roots, 1.35, 0.022), "reed")
    stems = []
    for root in roots[:: max(1, count // 26)]:
        tip = root + np.array([rng.normal() * 0.12, rng.normal() * 0.12, rng.uniform(1.3, 1.75)])
        stems.append(shapes.rod(tuple(root), tuple(tip), 0.006, 4))
        stems.append(shapes.ellipsoid((0.022, 0.022, 0.1), 8).transform(tuple(tip)))
    p.add(join_parts(stems), "bulrush")


def pine(p: Palette, at: Vector, height: float, cards: int) -> None:
    """Bent pine: a bare trunk, nine whorls of branches, and cards of needles."""
    rng = p.draft.rng
    t = np.linspace(0, 1, 9)[:, None]
    bend = rng.normal(size=2) * 0.09 * height
    stem = np.concatenate([bend * t**2, height * t], axis=1)
    wood, ends = [shapes.tube(stem, 0.022 * height * (1.1 - t[:, 0]), 9)], []
    for level in np.linspace(0.4, 0.97, 9):
        root = np.array([np.interp(level, t[:, 0], stem[:, k]) for k in range(3)])
        for a in rng.uniform(0, 2 * np.pi, 4):
            spread = height * 0.3 * (1.08 - level) * rng.uniform(0.7, 1.2)
            bough = root + t[:5] / 0.5 * spread * [np.cos(a), np.sin(a), 0.0] + [0, 0, 0.06 * height] * t[:5]
            wood.append(shapes.tube(bough, 0.006 * height * (1 - 1.5 * t[:5, 0]).clip(0.15), 4))
            ends.extend(bough[1:])
    p.add(join_parts(wood).transform(at), "trunk")
    centres = np.array(ends)[rng.integers(0, len(ends), cards)] + rng.normal(size=(cards, 3)) * height * [
        0.025,
        0.025,
        0.012,
    ]
    p.add(shapes.cards(rng, centres, 0.12 * height, 0.95).transform(at), "needles")


def warehouse(p: Palette, at: Vector, yaw: float, size: Vector) -> None:
    """Shed of corrugated metal on a stone plinth, with a door, a row of windows and a gable roof."""
    rng = p.draft.rng
    x, y, h = size
    wall = f"corrugated {int(rng.integers(4))}"
    p.add(shapes.box(size).transform(at, yaw=yaw), wall)
    p.add(shapes.box((x + 0.1, y + 0.1, 0.7)).transform(at, yaw=yaw), "ashlar")
    overhang, rise = 0.5, 0.32 * y
    for s in (-1, 1):
        slope = shapes.quad(
            (-x / 2 - overhang, s * -(y / 2 + overhang), h - 0.15),
            (x + 2 * overhang, 0, 0),
            (0, s * (y / 2 + overhang), rise + 0.15),
        )
        p.add(slope.transform(at, yaw=yaw), f"corrugated {4 + int(rng.integers(2))}")
        gable = shapes.triangle((s * x / 2, -y / 2, h), (s * x / 2, y / 2, h), (s * x / 2, 0, h + rise))
        p.add(gable.transform(at, yaw=yaw), wall)
    door = shapes.quad((-1.6, -y / 2 - 0.06, 3.2), (3.2, 0, 0), (0, 0, -3.2))
    p.add(door.transform(at, yaw=yaw), "paintwork 2")
    panes, bars = [], []
    for u in np.arange(-x / 2 + 1.0, x / 2 - 0.8, 1.7):
        if abs(u) < 2.4 and h < 4.4:
            continue
        panes.append(shapes.quad((u - 0.55, -y / 2 - 0.05, h - 0.5), (1.1, 0, 0), (0, 0, -0.9)))
        bars += [
            shapes.box((0.05, 0.08, 0.95)).transform((u + d, -y / 2 - 0.06, h - 1.42))
            for d in (-0.55, -0.18, 0.18, 0.55)
        ]
        bars.append(shapes.box((1.2, 0.08, 0.05)).transform((u, -y / 2 - 0.06, h - 0.95)))
    p.add(join_parts(panes).transform(at, yaw=yaw), "pane")
    p.add(join_parts(bars).transform(at, yaw=yaw), "spar")


def crane(p: Palette, at: Vector, yaw: float, height: float) -> None:
    """Quay crane: lattice tower, lattice jib, cab and cables."""

    def truss(start: Vector, end: Vector, side: float, steps: int) -> list:
        a, b = np.asarray(start, dtype=float), np.asarray(end, dtype=float)
        direction = (b - a) / np.linalg.norm(b - a)
        across = np.cross(direction, [0.0, 1.0, 0.0])
        corner_offsets = [
            s * side * across + e * side * np.array([0, 1.0, 0]) for s, e in ((-1, -1), (1, -1), (1, 1), (-1, 1))
        ]
        bars = [shapes.rod(tuple(a + c), tuple(b + c), 0.05, 5) for c in corner_offsets]
        for k in range(steps):
            lower, upper = a + (b - a) * k / steps, a + (b - a) * (k + 1) / steps
            for i in range(4):
                bars.append(
                    shapes.rod(tuple(lower + corner_offsets[i]), tuple(upper + corner_offsets[(i + 1) % 4]), 0.028, 4)
                )
        return bars

    top, tip = (0.0, 0.0, height), (0.75 * height, 0.0, 1.25 * height)
    bars = truss((0, 0, 0), top, 0.6, 9) + truss(top, tip, 0.35, 10)
    p.add(join_parts(bars).transform(at, yaw=yaw), "paintwork")
    mast = (-0.1 * height, 0.0, 1.35 * height)
    cables = [
        shapes.rod(mast, tip, 0.025, 4),
        shapes.rod(mast, top, 0.04, 4),
        shapes.rod(tip, (tip[0], 0, 0.45 * height), 0.02, 4),
    ]
    p.add(join_parts(cables).transform(at, yaw=yaw), "steel")
    p.add(shapes.box((2.0, 1.6, 1.7)).transform((-0.3, 0, height)).transform(at, yaw=yaw), "paintwork 2")


def lighthouse(p: Palette, at: Vector, height: float) -> None:
    """Lighthouse: a tower with coloured bands, a gallery and a lantern."""
    for k in range(6):
        low, high = k / 6, (k + 1) / 6
        ring = np.array([[(1.9 - 0.9 * low), height * low], [(1.9 - 0.9 * high), height * high]])
        p.add(shapes.lathe(ring, 30).transform(at), "gelcoat" if k % 2 else "band")
    head = np.array([[1.5, height], [1.55, height + 0.15], [0.0, height + 0.16]])
    p.add(shapes.lathe(head, 30).transform(at), "tar")
    p.add(shapes.lathe(np.array([[0.75, height + 0.15], [0.75, height + 1.5]]), 16).transform(at), "glow")
    p.add(
        shapes.lathe(np.array([[0.95, height + 1.5], [0.3, height + 2.2], [0, height + 2.3]]), 20).transform(at), "band"
    )


def road_mirror(p: Palette, at: Vector, yaw: float) -> None:
    """Convex traffic mirror with a rim, on a post."""
    t = np.linspace(0, 1, 14)
    dome = np.stack([0.38 * np.sin(t * 1.1) / np.sin(1.1), 0.28 * (np.cos(t * 1.1) - np.cos(1.1))], axis=1)
    face = shapes.lathe(dome[::-1], 40).transform(tilt=np.pi / 2).transform((0, -0.02, 1.9)).transform(at, yaw=yaw)
    p.add(face, "mirror")
    ring = np.linspace(0, 2 * np.pi, 41)
    rim = shapes.tube(np.stack([0.39 * np.cos(ring), 0 * ring, 1.9 + 0.39 * np.sin(ring)], 1), 0.035, 8)
    p.add(join_parts([rim, shapes.rod((0, 0.06, 0), (0, 0.06, 1.9), 0.04)]).transform(at, yaw=yaw), "buoy")


def festoon(p: Palette, posts: list[Vector], height: float, bulbs: int) -> None:
    """Posts, and wires with lamps between them."""
    rods = [shapes.rod(post, (post[0], post[1], post[2] + height), 0.04, 8) for post in posts]
    wires, lamps = [], []
    for a, b in pairwise(posts):
        start, end = (a[0], a[1], a[2] + height), (b[0], b[1], b[2] + height)
        wires.append(shapes.wire(start, end, 0.35, 0.009, 4, 20))
        for t in (np.arange(bulbs) + 0.5) / bulbs:
            lamp_position = np.asarray(start) * (1 - t) + np.asarray(end) * t - [0, 0, 0.35 * 4 * t * (1 - t) + 0.08]
            lamps.append(shapes.ellipsoid((0.055, 0.055, 0.075), 10).transform(tuple(lamp_position)))
    p.add(join_parts(rods + wires), "tar")
    p.add(join_parts(lamps), "glow", casts=False)
