"""Furniture of rooms and yards: tables, chairs, shelves with books, vases, plants, lattices.

Each function adds one object to a draft. Lengths are in metres; `at` is the object's position, `yaw` its rotation about
z in radians.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from gaussian_enhancer.scene.procedural import shapes
from gaussian_enhancer.scene.procedural.mesh import SurfacePart, join_parts
from gaussian_enhancer.scene.procedural.palette import Palette
from gaussian_enhancer.scene.procedural.vector import Vector


def flat_print(
    p: Palette,
    name: str,
    origin: Vector,
    right: Vector,
    down: Vector,
    window: tuple[float, float, float, float] = (0.0, 0.0, 1.0, 1.0),
) -> None:
    """Printed sheet; `window` is the part of the texture that is shown (u, v, width, height)."""
    sheet = shapes.quad(origin, right, down)
    u, v, w, h = window
    p.add(replace(sheet, uvs=sheet.uvs / sheet.uvs.max(0) * [w, h] + [u, v]), name)


def table(p: Palette, at: Vector, yaw: float, size: tuple[float, float], height: float, material: str = "wood") -> None:
    """Table with four legs, stretchers and a round or rectangular top, chosen at random."""
    rng = p.draft.rng
    x, y = size[0] / 2 - 0.07, size[1] / 2 - 0.07
    thickness = rng.uniform(0.03, 0.055)
    if rng.random() < 0.35:
        r = min(size) / 2
        top = shapes.lathe(
            np.array(
                [[0, -thickness], [r * 0.95, -thickness], [r, -thickness / 2], [r, 0], [r - 0.01, 0.004], [0, 0.004]]
            ),
            40,
        )
        x = y = r * 0.6
    else:
        top = shapes.box((size[0], size[1], thickness)).transform((0, 0, -thickness))
    legs = [
        shapes.rod((a * x, b * y, 0), (a * x * 0.92, b * y * 0.92, height - thickness), 0.025, 10)
        for a in (-1, 1)
        for b in (-1, 1)
    ]
    legs += [shapes.rod((-x, b * y, height * 0.25), (x, b * y, height * 0.25), 0.012, 6) for b in (-1, 1)]
    p.add(join_parts([top.transform((0, 0, height)), *legs]).transform(at, yaw=yaw), material)


def chair(p: Palette, at: Vector, yaw: float) -> None:
    """Chair with spindles in its back."""
    rng = p.draft.rng
    width, seat_height, back_height = rng.uniform(0.4, 0.48), 0.45, rng.uniform(0.85, 1.1)
    half_width = width / 2 - 0.025
    frame = [
        shapes.rod((a * half_width, b * half_width, 0), (a * half_width, b * half_width, seat_height), 0.018)
        for a in (-1, 1)
        for b in (-1, 1)
    ]
    frame += [
        shapes.rod((a * half_width, half_width, seat_height), (a * half_width, half_width + 0.08, back_height), 0.017)
        for a in (-1, 1)
    ]
    frame += [
        shapes.rod((-half_width, half_width + 0.08, back_height), (half_width, half_width + 0.08, back_height), 0.022)
    ]
    for t in np.linspace(-0.8, 0.8, int(rng.integers(4, 9))):
        frame.append(
            shapes.rod(
                (t * half_width, half_width, seat_height), (t * half_width, half_width + 0.08, back_height), 0.008, 6
            )
        )
    frame += [
        shapes.rod((-half_width, b * half_width, 0.2), (half_width, b * half_width, 0.2), 0.01, 6) for b in (-1, 1)
    ]
    p.add(join_parts(frame).transform(at, yaw=yaw), rng.choice(["wood 2", "iron", "chrome"]))
    p.add(
        shapes.box((width, width, 0.05)).transform((0, 0, seat_height)).transform(at, yaw=yaw),
        rng.choice(["cloth", "wood 2", "cloth 2"]),
    )


def sofa(p: Palette, at: Vector, yaw: float, length: float) -> None:
    """Sofa of rounded cushions, with two pillows of another cloth."""
    rng = p.draft.rng

    def cushion(x: float, y: float, z: float) -> SurfacePart:
        sphere = shapes.ellipsoid((1.0, 1.0, 1.0), 24)
        rounded_box = np.sign(sphere.positions) * np.abs(sphere.positions) ** 0.38
        return replace(sphere, positions=rounded_box * np.array([x, y, z]) / 2, uvs=sphere.uvs * 0.4)

    seats = int(rng.integers(2, 4))
    seat_width = length / seats
    parts = [
        shapes.box((length, 0.75, 0.25)).transform((0, 0, 0.1)),
        shapes.box((length, 0.2, 0.7)).transform((0, 0.32, 0.1)),
    ]
    parts += [cushion(0.22, 0.9, 0.55).transform((a * (length / 2 + 0.05), 0, 0.32)) for a in (-1, 1)]
    for k in range(seats):
        x = (k + 0.5) * seat_width - length / 2
        parts += [
            cushion(seat_width, 0.7, 0.2).transform((x, -0.05, 0.4)),
            cushion(seat_width, 0.22, 0.5).transform((x, 0.25, 0.65), tilt=-0.2),
        ]
    p.add(join_parts(parts).transform(at, yaw=yaw), "cloth 3")
    pillows = [
        cushion(0.42, 0.16, 0.42).transform((x, 0.05, 0.68), yaw=rng.uniform(-0.5, 0.5), tilt=-0.35)
        for x in rng.uniform(-length / 2.6, length / 2.6, 2)
    ]
    p.add(join_parts(pillows).transform(at, yaw=yaw), "cloth 4")


def books(p: Palette, at: Vector, yaw: float, width: float, height: float = 0.26) -> None:
    """Row of books with their spines towards -y; some lean."""
    rng, x = p.draft.rng, 0.0
    while x < width - 0.05:
        thickness = rng.uniform(0.018, 0.05)
        book_height = height * rng.uniform(0.65, 1.0)
        depth = rng.uniform(0.13, 0.19)
        lean = float(rng.uniform(0.0, 0.12)) if rng.random() < 0.15 else 0.0
        body = shapes.box((thickness, depth, book_height)).transform((x + thickness / 2, depth / 2, 0))
        body = replace(body, positions=body.positions + np.outer(body.positions[:, 2], [lean, 0, 0]))
        p.add(body.transform(at, yaw=yaw), "page 2" if rng.random() < 0.3 else "cloth 5")
        k = int(rng.integers(32))
        spine = shapes.quad(
            (x + lean * book_height, -0.002, book_height), (thickness, 0, 0), (-lean * book_height, 0, -book_height)
        )
        uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * [0.94 / 32, 1.0] + [(k + 0.03) / 32, 0]
        p.add(replace(spine, uvs=uv).transform(at, yaw=yaw), "spines")
        x += thickness + 0.002 + lean * book_height


def shelf(p: Palette, at: Vector, yaw: float, width: float, levels: int) -> None:
    """Shelf with books and vases; its back, for a wall, is at +y."""
    rng = p.draft.rng
    level_height, depth = 0.34, 0.28
    boards = [shapes.box((width, depth, 0.022)).transform((0, 0, 0.06 + k * level_height)) for k in range(levels + 1)]
    boards += [
        shapes.box((0.022, depth, levels * level_height + 0.09)).transform((a * width / 2, 0, 0)) for a in (-1, 1)
    ]
    boards += [
        shapes.quad(
            (-width / 2, depth / 2, levels * level_height + 0.08), (width, 0, 0), (0, 0, -levels * level_height)
        )
    ]
    p.add(join_parts(boards).transform(at, yaw=yaw), "wood 3")
    c, s = np.cos(yaw), np.sin(yaw)

    def place(x: float, y: float, z: float) -> Vector:
        return at[0] + c * x - s * y, at[1] + s * x + c * y, at[2] + z

    for k in range(levels):
        z, split = 0.085 + k * level_height, rng.uniform(0.35, 0.95)
        books(p, place(-width / 2 + 0.03, -depth / 2 + 0.03, z), yaw, (width - 0.06) * split)
        if split < 0.75:
            vase(p, place(width / 2 - 0.15, 0.0, z), rng.uniform(0.15, 0.24), flowers=False)


def vase(p: Palette, at: Vector, height: float, *, flowers: bool, material: str | None = None) -> None:
    """Turned vase, with or without flowers."""
    rng = p.draft.rng
    r = height * rng.uniform(0.18, 0.36, 5)
    points = [(r[0], 0.0), (r[1] * 1.3, 0.3), (r[2], 0.6), (r[3] * 0.6, 0.85), (r[4] * 0.8, 1.0)]
    outer = shapes.smooth_profile([(a, b * height) for a, b in points], 26)
    profile = np.concatenate(
        [[[0.0, 0.0]], outer, [[outer[-1, 0] * 0.92, height], [outer[-1, 0] * 0.7, height * 0.85], [0.0, height * 0.8]]]
    )
    fluted = rng.random() < 0.4
    body = shapes.lathe(profile, 48, int(rng.integers(6, 16)) if fluted else 0, 0.1 if fluted else 0.0)
    p.add(body.transform(at), material or rng.choice(["glaze", "glaze 2", "marble", "chrome"]))
    if flowers:
        plant(p, (at[0], at[1], at[2] + height * 0.95), height * rng.uniform(0.9, 1.5), 40)


def plant(p: Palette, at: Vector, height: float, count: int, leaf: str = "sprig") -> None:
    """Plant: thin bent stems with leaf cards near their ends."""
    rng = p.draft.rng
    stems, tips = [], []
    for _ in range(max(5, count // 6)):
        spread = rng.normal(size=2) * height * 0.33
        t = np.linspace(0, 1, 7)[:, None]
        path = np.concatenate([spread * t**1.6, height * rng.uniform(0.6, 1.1) * (t - 0.25 * t**3)], axis=1)
        stems.append(shapes.tube(path, 0.006 * height + 0.0015, 5))
        tips.append(path[rng.integers(2, 7, max(1, count // max(5, count // 6)))])
    p.add(join_parts(stems).transform(at), "bark 2")
    centres = np.concatenate(tips)
    centres = centres + rng.normal(size=centres.shape) * 0.06 * height
    p.add(shapes.cards(rng, centres, 0.34 * height, 0.7).transform(at), leaf)


def potted(p: Palette, at: Vector, height: float) -> None:
    """A plant in a pot."""
    r = height * 0.17
    pot = np.array(
        [
            [0, 0],
            [r * 0.7, 0],
            [r * 0.95, r * 1.5],
            [r * 1.08, r * 1.5],
            [r * 1.08, r * 1.75],
            [r * 0.95, r * 1.75],
            [r * 0.9, r * 1.5],
            [0, r * 1.5],
        ]
    )
    p.add(shapes.lathe(pot, 36).transform(at), p.draft.rng.choice(["glaze 3", "brick", "concrete"]))
    plant(p, (at[0], at[1], at[2] + r * 1.5), height * 0.75, 90)


def lattice(
    p: Palette, at: Vector, yaw: float, size: tuple[float, float], pitch: float, radius: float, material: str = "iron"
) -> None:
    """Lattice of crossing diagonal rods in a frame, in the xz plane."""
    w, h = size
    rods = [shapes.rod((-w / 2, 0, z), (w / 2, 0, z), radius * 2.2, 6) for z in (0, h)]
    rods += [shapes.rod((x, 0, 0), (x, 0, h), radius * 2.2, 6) for x in (-w / 2, w / 2)]
    for c in np.arange(-h - w / 2, w / 2, pitch):
        for sign in (-1, 1):
            z0, z1 = max(0.0, -w / 2 - c), min(h, w / 2 - c)
            if z1 > z0:
                rods.append(
                    shapes.rod((sign * (c + z0), sign * radius, z0), (sign * (c + z1), sign * radius, z1), radius, 4)
                )
    p.add(join_parts(rods).transform(at, yaw=yaw), material)


def wheel(radius: float, spokes: int, tyre: float) -> tuple[SurfacePart, SurfacePart]:
    """Wheel in the xz plane about the origin: (tyre, rim with spokes)."""
    angle = np.linspace(0, 2 * np.pi, 41)
    ring = np.stack([np.cos(angle), 0 * angle, np.sin(angle)], axis=1)
    tyre_part = shapes.tube(ring * (radius - tyre), tyre, 10)
    rim = [
        shapes.tube(ring * (radius - 2.2 * tyre), tyre * 0.6, 6),
        shapes.rod((0, -2 * tyre, 0), (0, 2 * tyre, 0), 1.2 * tyre, 8),
    ]
    for k in range(spokes):
        a = 2 * np.pi * k / spokes
        end = ((radius - 2 * tyre) * np.cos(a), 0.0, (radius - 2 * tyre) * np.sin(a))
        rim.append(shapes.rod((0, tyre * (-1) ** k, 0), end, max(0.0016, tyre * 0.08), 4))
    return tyre_part, join_parts(rim)


def bicycle(p: Palette, at: Vector, yaw: float) -> None:
    """Bicycle with thin spokes, tubes and cables."""
    for x in (-0.52, 0.52):
        tyre, rim = wheel(0.34, 28, 0.018)
        p.add(tyre.transform((x, 0, 0.34)).transform(at, yaw=yaw), "rubber")
        p.add(rim.transform((x, 0, 0.34)).transform(at, yaw=yaw), "chrome")
    joints = {
        "rear": (-0.52, 0, 0.34),
        "crank": (-0.08, 0, 0.3),
        "seat": (-0.22, 0, 0.85),
        "head": (0.36, 0, 0.8),
        "front": (0.52, 0, 0.34),
    }
    bars = [
        ("rear", "crank"),
        ("rear", "seat"),
        ("crank", "seat"),
        ("crank", "head"),
        ("seat", "head"),
        ("head", "front"),
    ]
    tubes = [shapes.rod(joints[a], joints[b], 0.016, 10) for a, b in bars]
    p.add(join_parts(tubes).transform(at, yaw=yaw), "paint")
    bar = np.array([[0.3, -0.28, 0.98], [0.4, -0.2, 1.0], [0.36, 0, 0.98], [0.4, 0.2, 1.0], [0.3, 0.28, 0.98]])
    metal = [
        shapes.tube(bar, 0.012),
        shapes.rod((0.36, 0, 0.8), (0.36, 0, 0.98), 0.013),
        shapes.rod((-0.22, 0, 0.85), (-0.24, 0, 0.95), 0.013),
    ]
    metal += [shapes.wire((0.32, 0.2 * s, 0.99), (0.5, 0, 0.6), 0.1, 0.003) for s in (-1, 1)]
    p.add(join_parts(metal).transform(at, yaw=yaw), "chrome")
    p.add(shapes.ellipsoid((0.14, 0.07, 0.035)).transform((-0.24, 0, 0.97)).transform(at, yaw=yaw), "rubber")


def knot(rng: np.random.Generator, radius: float, tube_radius: float) -> SurfacePart:
    """A torus knot."""
    a, b = [(2, 3), (3, 2), (3, 4), (2, 5)][int(rng.integers(4))]
    t = np.linspace(0, 2 * np.pi, 220)
    r = radius * (0.7 + 0.3 * np.cos(b * t))
    path: Float[np.ndarray, "k 3"] = np.stack(
        [r * np.cos(a * t), r * np.sin(a * t), 0.45 * radius * np.sin(b * t)], axis=1
    )
    return shapes.tube(path, tube_radius, 12)
