"""Boats: rowing boats, sailing yachts, trawlers and a distant marina.

Each public function adds a boat or a fleet to a draft. Lengths are in metres. `at` is the boat's midpoint on the water,
`yaw` the rotation of its bow from +x in radians.
Axes: s stations from stern to bow.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from gaussian_enhancer.scene.procedural import shapes
from gaussian_enhancer.scene.procedural.mesh import SurfacePart, join_parts
from gaussian_enhancer.scene.procedural.palette import Palette
from gaussian_enhancer.scene.procedural.vector import Vector

_STATIONS = np.linspace(0, 1, 33)


class Hull:
    """Shape of a hull.

    Args:
        length: overall length.
        beam: largest width.
        freeboard: base height of the rail above the water; it rises towards the bow.
        draught: depth of the keel below the water.
        fine: exponent of the taper towards the bow; 1 is a straight taper, larger values give a fuller bow.
    """

    def __init__(self, length: float, beam: float, freeboard: float, draught: float, fine: float = 2.2) -> None:
        s = _STATIONS
        self.x = (s - 0.5) * length
        stern = 0.72 + 0.28 * np.sin(np.clip(s / 0.45, 0, 1) * np.pi / 2)
        self.half = 0.5 * beam * stern * (1 - np.clip((s - 0.4) / 0.6, 0, 1) ** fine)
        self.sheer = freeboard * (1 + 0.12 * (1 - s) ** 2 + 0.75 * s**3)
        self.keel = -draught * (1 - 0.9 * s**6)

    def rail(self, inset: float = 0.0, lift: float = 0.0) -> Float[np.ndarray, "k 3"]:
        """Edge of the deck: from the stern forward on the port side, round the bow, and back on the starboard side."""
        half = np.maximum(self.half - inset, 0.0)
        side = np.stack([self.x, half, self.sheer + lift], axis=1)
        return np.concatenate([side, (side * [1, -1, 1])[::-1]])

    def skin(self, rake: float = 0.16) -> SurfacePart:
        """Outer surface: cross-sections from rail to rail under the keel; v is the depth below the rail."""
        section = np.linspace(-1, 1, 25)
        depth_share = (1 - np.abs(section)) ** 0.75
        z = self.sheer[:, None] + (self.keel - self.sheer)[:, None] * depth_share
        y = self.half[:, None] * np.sign(section) * (1 - depth_share**2.6) ** 0.5
        overhang = (self.x.max() - self.x.min()) * rake * 0.5
        x = self.x[:, None] - overhang * (self.x / self.x.max()).clip(0, 1)[:, None] ** 4 * depth_share
        x = x + 0.5 * overhang * (1 - _STATIONS[:, None]) ** 8 * depth_share
        uvs = np.stack(np.broadcast_arrays(x, self.sheer[:, None] - z), axis=-1)
        return shapes.sheet(np.stack([x, y, z], axis=-1), uvs)

    def transom(self) -> SurfacePart:
        """Flat stern, as a triangle fan."""
        ring = self.skin().positions.reshape(len(_STATIONS), 25, 3)[0]
        positions, faces = shapes.fan(ring)
        uvs = np.stack([positions[:, 1], self.sheer[0] - positions[:, 2]], axis=1)
        return SurfacePart(positions, np.tile([-1.0, 0, 0], (len(positions), 1)), uvs, faces)

    def deck(self, below: float, inset: float = 0.04, start: float = 0.0, end: float = 0.97) -> SurfacePart:
        """Deck at distance `below` under the rail, between two stations given as shares of the length."""
        in_range = (start <= _STATIONS) & (end >= _STATIONS)
        across = np.linspace(-1, 1, 7)
        y = np.maximum(self.half[in_range] - inset, 0.01)[:, None] * across
        x = np.broadcast_to(self.x[in_range][:, None], y.shape)
        z = (self.sheer[in_range] - below)[:, None] + 0.03 * (1 - across**2)
        return shapes.sheet(np.stack([x, y, z], axis=-1), np.stack([y, x], axis=-1))


def _put(p: Palette, at: Vector, yaw: float, part: SurfacePart, material: str) -> None:
    p.add(part.transform(at, yaw=yaw), material)


def _bulwark(h: Hull, radius: float) -> SurfacePart:
    return shapes.tube(h.rail(), radius, 6)


def rowing_boat(p: Palette, at: Vector, yaw: float) -> None:
    """Open rowing boat with thwarts, ribs, oars and a coil of rope."""
    rng = p.draft.rng
    h = Hull(rng.uniform(3.2, 4.2), rng.uniform(1.25, 1.5), 0.38, 0.22)
    _put(p, at, yaw, join_parts([h.skin(), h.transom()]), f"hull {int(rng.integers(4))}")
    _put(p, at, yaw, h.deck(0.34, 0.16, 0.05, 0.85), "deck")
    _put(p, at, yaw, _bulwark(h, 0.028), "spar")
    thwarts = [
        shapes.box((0.24, 2 * half - 0.06, 0.03)).transform((x, 0, 0.22)) for x, half in _at(h, (0.2, 0.45, 0.68))
    ]
    ribs = [
        shapes.tube(np.array([[x, s * half, 0.36], [x, s * half * 0.9, 0.1], [x, s * half * 0.5, 0.0]]), 0.014, 4)
        for x, half in _at(h, np.arange(0.1, 0.85, 0.07))
        for s in (-1, 1)
    ]
    _put(p, at, yaw, join_parts(thwarts + ribs), "deck 2")
    for s in (-1, 1):
        start, end = (-1.0, s * 0.3, 0.3), (1.1, s * 0.42, 0.33)
        blade = shapes.box((0.55, 0.13, 0.012)).transform((1.3, s * 0.44, 0.325))
        _put(p, at, yaw, join_parts([shapes.rod(start, end, 0.02), blade]), "spar")
    coil = np.linspace(0, 8 * np.pi, 120)
    path = np.stack([0.16 * np.cos(coil), 0.16 * np.sin(coil), 0.012 * coil], axis=1)
    _put(p, at, yaw, shapes.tube(path, 0.014, 5).transform((h.x[26] * 0.9, 0, 0.1)), "rope")


def _at(h: Hull, shares: object) -> list[tuple[float, float]]:
    """Position x and half width of a hull at shares of its length."""
    return [(float(np.interp(s, _STATIONS, h.x)), float(np.interp(s, _STATIONS, h.half))) for s in np.asarray(shares)]


def yacht(p: Palette, at: Vector, yaw: float, length: float, *, hoisted: bool = False) -> None:
    """Sailing yacht: cabin, guard rails, mast with spreaders, stays and halyards, a furled or hoisted sail."""
    rng = p.draft.rng
    h = Hull(length, 0.31 * length, 0.095 * length, 0.08 * length, 1.7)
    deck = float(h.sheer[16])
    _put(p, at, yaw, join_parts([h.skin(), h.transom()]), f"hull {int(rng.integers(4))}")
    _put(p, at, yaw, h.deck(0.05), "deck")
    _put(p, at, yaw, _bulwark(h, 0.03), "spar")
    _cabin(p, at, yaw, length, deck)
    mast, top = 0.06 * length, rng.uniform(1.15, 1.35) * length
    _rig(p, at, yaw, h, mast, top, deck)
    _sails(p, at, yaw, length, mast, top, deck, hoisted=hoisted)
    posts, wires = [], []
    rail = h.rail(0.06)[2:-2:3]
    for foot in rail:
        posts.append(shapes.rod(tuple(foot), tuple(foot + np.array([0, 0, 0.55])), 0.011, 5))
    for lift in (0.3, 0.55):
        wires.append(shapes.tube(rail + np.array([0, 0, lift]), 0.005, 4))
    _put(p, at, yaw, join_parts(posts + wires), "steel")


def _cabin(p: Palette, at: Vector, yaw: float, length: float, deck: float) -> None:
    """Cabin with side windows, front window and hatch."""
    body = np.array([[-0.12, 0.0], [-0.12, 0.055], [0.16, 0.055], [0.22, 0.0]]) * length
    width = 0.085 * length
    top = [(x, s * width * (1 - 0.25 * (z > 0)), z + deck) for s in (-1, 1) for x, z in body]
    left, right = top[:4], top[4:]
    for side in (left, right):
        a, b, c, d = (np.array(corner, dtype=float) for corner in side)
        _put(p, at, yaw, shapes.quad(tuple(b), tuple(c - b), tuple(a - b)), "gelcoat")
        _put(p, at, yaw, shapes.triangle(tuple(c), tuple(d), (c[0], d[1], d[2])), "gelcoat")
        outward_offset = np.array([0, np.sign(a[1]) * 0.008, 0.0])
        for k in range(4):
            start = b + (c - b) * (0.08 + 0.23 * k) + (a - b) * 0.25 + outward_offset
            _put(p, at, yaw, shapes.quad(tuple(start), tuple((c - b) * 0.17), tuple((a - b) * 0.45)), "pane")
    b, c, d = (np.array(left[k], dtype=float) for k in (1, 2, 3))
    upper_edge = np.array([0, right[1][1] - left[1][1], 0.0])
    _put(p, at, yaw, shapes.quad(tuple(b), tuple(c - b), tuple(upper_edge)), "gelcoat")
    lower_edge = np.array([0, right[3][1] - left[3][1], 0.0])
    _put(p, at, yaw, shapes.quad(tuple(c), tuple(d - c), tuple(0.5 * (upper_edge + lower_edge))), "pane")
    _put(p, at, yaw, shapes.box((0.03, 1.5 * width, 0.05 * length)).transform((-0.12 * length, 0, deck)), "deck 2")


def _rig(p: Palette, at: Vector, yaw: float, h: Hull, mast: float, top: float, deck: float) -> None:
    """Mast with spreaders, stays, halyards and a wind vane."""
    peak = (mast, 0.0, top)
    spars = [shapes.tube(np.array([[mast, 0, deck - 0.3], [mast, 0, top]]), np.array([0.055, 0.035]), 10)]
    stays = [
        shapes.rod((float(h.x[-2]), 0, float(h.sheer[-1])), peak, 0.007, 4),
        shapes.rod((float(h.x[0]), 0, float(h.sheer[0])), peak, 0.006, 4),
    ]
    x, half = _at(h, (0.53,))[0]
    for share in (0.45, 0.72):
        z = deck + share * (top - deck)
        half_width = half * (1.05 - 0.35 * share)
        for s in (-1, 1):
            tip = (mast - 0.05, s * half_width, z)
            spars.append(shapes.rod((mast, 0, z), tip, 0.014, 6))
            stays.append(shapes.rod((x, s * half, deck), tip, 0.006, 4))
            stays.append(shapes.rod(tip, (mast, 0, min(top, z + 0.3 * (top - deck))), 0.005, 4))
    for dx, dy in ((0.1, 0.04), (0.08, -0.05), (-0.09, 0.03)):
        stays.append(shapes.wire((mast + dx * 4, dy * 9, deck), (mast + 0.05, dy, top - 0.1), -0.02, 0.005))
    _put(p, at, yaw, join_parts(spars), "alloy")
    _put(p, at, yaw, join_parts(stays), "steel")
    vane = shapes.triangle((mast, 0, top + 0.1), (mast - 0.35, 0.05, top + 0.16), (mast - 0.02, 0, top + 0.26))
    _put(p, at, yaw, join_parts([vane, shapes.rod(peak, (mast, 0, top + 0.3), 0.006, 4)]), "buoy")


def _sails(
    p: Palette, at: Vector, yaw: float, length: float, mast: float, top: float, deck: float, *, hoisted: bool
) -> None:
    rng = p.draft.rng
    foot, clew = deck + 0.12 * length, mast - 0.42 * length
    _put(p, at, yaw, shapes.rod((mast, 0, foot), (clew, 0, foot + 0.05), 0.035), "alloy")
    if hoisted:
        u, v = np.meshgrid(np.linspace(0, 1, 14), np.linspace(0, 1, 18))
        x = mast - 0.06 - (mast - clew) * 0.95 * u * (1 - v)
        y = 0.09 * length * u * (1 - v) * np.sin(np.pi * np.clip(u, 0, 1) * 0.8) * np.sin(np.pi * (0.15 + 0.8 * v))
        z = foot + 0.06 + (top - foot - 0.3) * v
        sail = shapes.sheet(np.stack([x, y, z], -1), np.stack([x, top - z], -1))
        _put(p, at, yaw, sail, f"sail {int(rng.integers(2))}")
        return
    t = np.linspace(0, 1, 24)
    path = np.stack([mast + (clew - mast) * t, 0.02 * np.sin(25 * t), foot + 0.09 + 0.05 * t], axis=1)
    radii = 0.11 * (1 - 0.55 * t) * (1 + 0.12 * np.sin(40 * t))
    _put(p, at, yaw, shapes.tube(path, radii, 10), f"sail {int(rng.integers(2))}")
    ties = [shapes.tube(_ring(path[k], float(radii[k]) * 1.05), 0.008, 4) for k in range(2, 24, 4)]
    _put(p, at, yaw, join_parts(ties), "rope")


def _ring(centre: Float[np.ndarray, " 3"], radius: float) -> Float[np.ndarray, "k 3"]:
    angle = np.linspace(0, 2 * np.pi, 17)
    return centre + radius * np.stack([0 * angle, np.cos(angle), np.sin(angle)], axis=1)


def trawler(p: Palette, at: Vector, yaw: float, length: float) -> None:
    """Fishing boat: wheelhouse with windows on all sides, derricks with tackle, a net drum, tyres as fenders."""
    rng = p.draft.rng
    h = Hull(length, 0.36 * length, 0.13 * length, 0.12 * length, 2.8)
    deck = float(h.sheer[14]) - 0.55
    _put(p, at, yaw, join_parts([h.skin(0.22), h.transom()]), f"hull {int(rng.integers(4))}")
    _put(p, at, yaw, h.deck(0.55), "deck 2")
    _put(p, at, yaw, join_parts([_bulwark(h, 0.05), shapes.tube(h.rail(0.0, -0.35) * [1, 1.01, 1], 0.045, 6)]), "spar")
    _wheelhouse(p, at, yaw, length, deck)
    _gear(p, at, yaw, h, length, deck)
    for k in (5, 11, 17, 22):
        for s in (-1, 1):
            ring = _ring(np.zeros(3), 0.3)[:, [1, 0, 2]]
            position = (float(h.x[k]), s * (float(h.half[k]) + 0.06), float(h.sheer[k]) - 0.45)
            _put(p, at, yaw, shapes.tube(ring, 0.1, 8).transform(position), "tyre")
    for s in (-1, 1):
        bow = np.array([float(h.x[23]), s * (float(h.half[23]) + 0.05), float(h.sheer[23]) - 0.1])
        aft = np.array([float(h.x[20]), s * (float(h.half[20]) + 0.05), float(h.sheer[20]) - 0.1])
        start, along = (aft, bow - aft) if s < 0 else (bow, aft - bow)
        board = shapes.quad(tuple(start), tuple(along), (0, 0, -0.45))
        _put(p, at, yaw, replace(board, uvs=board.uvs / board.uvs.max(0)), f"registration {int(length)}")


def _wheelhouse(p: Palette, at: Vector, yaw: float, length: float, deck: float) -> None:
    """Wheelhouse with windows on all sides, lamps, a radar dish and antennas."""
    x, house_width, house_length, house_height = 0.12 * length, 0.22 * length, 0.2 * length, 2.3
    _put(p, at, yaw, shapes.box((house_length, house_width, house_height)).transform((x, 0, deck)), "gelcoat")
    _put(
        p,
        at,
        yaw,
        shapes.box((house_length + 0.5, house_width + 0.4, 0.1)).transform((x, 0, deck + house_height)),
        "spar",
    )
    low, high = deck + 1.25, deck + 2.05
    for turn, wall_distance, width in (
        (0, house_length / 2, house_width),
        (np.pi / 2, house_width / 2, house_length),
        (np.pi, house_length / 2, house_width),
        (-np.pi / 2, house_width / 2, house_length),
    ):
        count = max(2, int(width / 0.62))
        for k in range(count):
            u = (k + 0.08) * width / count - width / 2
            pane = shapes.quad((wall_distance + 0.01, u, high), (0, 0.84 * width / count, 0), (0, 0, low - high))
            _put(p, at, yaw, pane.transform(yaw=float(turn)).transform((x, 0, 0)), "pane")
    roof = deck + house_height + 0.1
    lamp = [shapes.ellipsoid((0.09, 0.09, 0.07)).transform((x + s, 0.3 * s, roof + 0.1)) for s in (-0.5, 0.5)]
    _put(p, at, yaw, join_parts(lamp), "glow")
    dish = shapes.lathe(np.array([[0, 0], [0.3, 0.02], [0.33, 0.12], [0.3, 0.2], [0, 0.24]]), 24)
    _put(
        p,
        at,
        yaw,
        join_parts([dish.transform((x, 0, roof + 0.5)), shapes.rod((x, 0, roof), (x, 0, roof + 0.55), 0.04)]),
        "gelcoat",
    )
    antennas = [
        shapes.rod((x - 0.4, y, roof), (x - 0.6, 1.2 * y, roof + t), 0.006, 4)
        for y, t in ((-0.6, 2.6), (0.5, 2.0), (0.7, 3.1))
    ]
    _put(p, at, yaw, join_parts(antennas), "steel")


def _gear(p: Palette, at: Vector, yaw: float, h: Hull, length: float, deck: float) -> None:
    """Mast with derricks and tackle, a net drum, a net and fish crates."""
    rng = p.draft.rng
    mast, top = -0.08 * length, deck + 0.55 * length
    frame = [shapes.rod((mast, 0, deck), (mast, 0, top), 0.09, 10)]
    stern = 0.42 * length
    boom_ends = {s: (mast - 0.3 * length, s * 0.16 * length, deck + 0.38 * length) for s in (-1, 1)}
    for s in (-1, 1):
        frame.append(shapes.rod((-stern, s * 0.11 * length, deck), (-stern + 0.3, s * 0.08 * length, deck + 2.6), 0.07))
        frame.append(shapes.rod((mast, s * 0.1, deck + 1.0), boom_ends[s], 0.05))
    frame.append(
        shapes.rod((-stern + 0.3, -0.08 * length, deck + 2.6), (-stern + 0.3, 0.08 * length, deck + 2.6), 0.06)
    )
    _put(p, at, yaw, join_parts(frame), "paintwork")
    tackle = [shapes.rod((mast, 0, top - 0.2), (float(h.x[-2]), 0, float(h.sheer[-2])), 0.012, 4)]
    for s, boom_end in boom_ends.items():
        tackle += [
            shapes.rod((mast, 0, top - 0.1), boom_end, 0.01, 4),
            shapes.wire(boom_end, (boom_end[0], boom_end[1] * 0.6, deck + 0.4), 0.05, 0.01),
        ]
        tackle += [
            shapes.rod((mast, 0, top - 0.3), (float(h.x[k]), s * float(h.half[k]), float(h.sheer[k])), 0.009, 4)
            for k in (10, 13)
        ]
    _put(p, at, yaw, join_parts(tackle), "steel")
    drum = np.array(
        [
            [0, -0.7],
            [0.62, -0.7],
            [0.62, -0.64],
            [0.34, -0.6],
            [0.42, 0],
            [0.34, 0.6],
            [0.62, 0.64],
            [0.62, 0.7],
            [0, 0.7],
        ]
    )
    _put(p, at, yaw, shapes.lathe(drum, 28).transform((-stern + 0.9, 0, deck + 0.75), tilt=np.pi / 2), "twine")
    net = shapes.curtain(0.2 * length, 2.2, 5, 0.16)
    _put(p, at, yaw, net.transform((-stern + 0.25, -0.1 * length, deck + 0.35), yaw=np.pi / 2), "net")
    for _ in range(4):
        crate = (rng.uniform(-0.3, -0.14) * length, rng.uniform(-0.08, 0.08) * length, deck + 0.02)
        _put(
            p,
            at,
            yaw,
            shapes.box((0.6, 0.4, 0.28)).transform(crate, yaw=rng.normal() * 0.2),
            f"crate {int(rng.integers(3))}",
        )


def moored_fleet(p: Palette, count: int, depth: tuple[float, float], span: float, water: float) -> None:
    """Distant marina: small boats with masts and stays."""
    rng = p.draft.rng
    spars, stays = [], []
    for k in range(count):
        x, y, top = rng.uniform(-span, span), rng.uniform(*depth), rng.uniform(6, 11)
        spars.append(shapes.rod((x, y, water), (x, y, water + top), 0.05, 5))
        spars.append(shapes.rod((x - 0.7, y, water + 0.6 * top), (x + 0.7, y, water + 0.6 * top), 0.025, 4))
        stays += [shapes.rod((x + s, y, water + 0.8), (x, y, water + top), 0.012, 3) for s in (-2.2, 2.2)]
        h = Hull(rng.uniform(5.5, 7.5), 2.0, 0.62, 0.4, 1.8)
        yaw = rng.normal() * 0.12 + np.pi * (rng.random() < 0.5)
        paint = "gelcoat" if rng.random() < 0.5 else f"hull {int(rng.integers(4))}"
        _put(p, (x, y, water), yaw, join_parts([h.skin(), h.transom()]), paint)
        _put(p, (x, y, water), yaw, h.deck(0.05), "deck")
        _put(p, (x, y, water), yaw, shapes.box((2.2, 1.0, 0.42)).transform((0.1, 0, 0.55)), "gelcoat")
        _put(p, (x, y, water), yaw, shapes.box((1.7, 1.03, 0.16)).transform((0.1, 0, 0.72)), "pane")
        if k % 3 == 0:
            cover = shapes.tube(
                np.array([[-2.2, 0, 1.5], [-1.0, 0, 1.6], [0.2, 0, 1.6]]), np.array([0.1, 0.2, 0.12]), 8
            )
            _put(p, (x, y, water), yaw, cover, f"sail {int(rng.integers(2))}")
    p.add(join_parts(spars), "alloy")
    p.add(join_parts(stays), "steel")
