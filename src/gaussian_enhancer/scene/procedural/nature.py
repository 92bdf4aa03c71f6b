"""Outdoor objects: trees, stones, grass, bushes, posts, far hills and blocks of houses.

Each function adds one object, or one group of objects, to a draft. Lengths are in metres.
"""

import numpy as np

from gaussian_enhancer.scene.procedural import shapes
from gaussian_enhancer.scene.procedural.mesh import join_parts
from gaussian_enhancer.scene.procedural.noise import wavy
from gaussian_enhancer.scene.procedural.palette import Palette
from gaussian_enhancer.scene.procedural.vector import Vector


def tree(p: Palette, at: Vector, height: float, cards: int, kind: str = "") -> None:
    """Tree: a trunk with branches and twigs, and `cards` leaf cards around their ends."""
    rng = p.draft.rng
    trunk_height = height * rng.uniform(0.25, 0.4)
    thickness = height * rng.uniform(0.016, 0.028)
    lean_offset = rng.normal(size=2) * 0.06 * height
    t = np.linspace(0, 1, 6)[:, None]
    stem = np.concatenate([lean_offset * t**2 + rng.normal(size=(6, 2)) * 0.008 * height * t, trunk_height * t], axis=1)
    wood, ends = [shapes.tube(stem, thickness * (1.35 - 0.5 * t[:, 0]), 10)], []
    for k in range(int(rng.integers(4, 7))):
        angle = 2 * np.pi * (k + rng.uniform(0, 0.6)) / 5
        spread = height * rng.uniform(0.16, 0.3)
        rise = height * rng.uniform(0.2, 0.55)
        tip = np.array([np.cos(angle) * spread, np.sin(angle) * spread, rise])
        branch = stem[-1] + tip * t + np.array([0, 0, -0.08 * height]) * (t * (1 - t))
        wood.append(shapes.tube(branch, thickness * 0.6 * (1 - 0.75 * t[:, 0]), 6))
        for _ in range(3):
            start = branch[int(rng.integers(2, 5))]
            twig = start + (tip * rng.uniform(0.2, 0.5) + rng.normal(size=3) * 0.1 * height) * t
            wood.append(shapes.tube(twig, thickness * 0.22 * (1 - 0.8 * t[:, 0]), 4))
            ends.extend(twig[3:])
        ends.extend(branch[3:])
    p.add(join_parts(wood).transform(at), "bark")
    centres = np.array(ends)[rng.integers(0, len(ends), cards)]
    centres = centres + rng.normal(size=(cards, 3)) * height * np.array([0.075, 0.075, 0.055])
    size = max(0.4, height * 0.15)
    p.add(shapes.cards(rng, centres, size).transform(at), f"leaves{kind}")


def bush(p: Palette, at: Vector, radius: float, cards: int) -> None:
    """Round bush: leaf cards over a solid core."""
    rng = p.draft.rng
    direction = rng.normal(size=(cards, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    centres = direction * np.array([1, 1, 0.8]) * radius * rng.uniform(0.7, 1.0, (cards, 1))
    centres[:, 2] = np.abs(centres[:, 2])
    p.add(shapes.cards(rng, centres, 0.42 * radius + 0.12, 0.9).transform(at), "leaves 2")
    p.add(shapes.ellipsoid((0.75 * radius, 0.75 * radius, 0.6 * radius)).transform(at), "foliage")


def stone(p: Palette, at: Vector, size: float) -> None:
    """A boulder."""
    rng = p.draft.rng
    radii = size * rng.uniform(0.5, 1.0, 3)
    boulder = shapes.ellipsoid((radii[0], radii[1], radii[2] * 0.8), 26, rng.normal(size=(7, 3)) * 3.0)
    p.add(boulder.transform(at, yaw=rng.uniform(0, 6.3)), "concrete 2")


def grass(p: Palette, count: int, inner: float, outer: float, height: float) -> None:
    """Blades of grass in tufts, over a ring of flat ground about the origin."""
    rng = p.draft.rng
    tufts = max(1, count // 14)
    r = np.sqrt(rng.uniform(inner**2, outer**2, tufts))
    a = rng.uniform(0, 2 * np.pi, tufts)
    tuft = rng.integers(0, tufts, count)
    xy = np.stack([r * np.cos(a), r * np.sin(a)], axis=1)[tuft] + rng.normal(size=(count, 2)) * 0.07
    roots = np.concatenate([xy, np.full((count, 1), -0.01)], axis=1)
    p.add(shapes.blades(rng, roots, height, 0.012), "blades", casts=False)


def hills(p: Palette, distance: float, height: float, material: str) -> None:
    """Closed ring of hills about the origin, from `distance` to 1.5 times that."""
    angle = np.linspace(0, 2 * np.pi, 181)
    crest = np.maximum(height * (0.75 + 0.5 * wavy(p.draft.rng, angle, (2, 3, 5, 8, 13, 21, 34))), 0.15 * height)
    ring = shapes.hillside(angle, crest, distance * (1 + 0.5 * np.linspace(0, 1, 9)), -2.0)
    p.add(ring, material, casts=False)


def house(p: Palette, at: Vector, yaw: float, size: Vector, wall: str) -> None:
    """House for the background: walls, rows of framed windows, a gable roof."""
    x, y, h = size
    panes, frames = [], []
    for side, width, turn in ((y / 2, x, 0.0), (x / 2, y, np.pi / 2), (y / 2, x, np.pi), (x / 2, y, -np.pi / 2)):
        for k in range(max(1, int(width / 2.4))):
            for level in range(max(1, int(h / 2.9))):
                u = (k + 0.5) * width / max(1, int(width / 2.4)) - width / 2
                panes.append(
                    shapes.quad((u - 0.5, -side - 0.03, level * 2.9 + 2.4), (1.0, 0, 0), (0, 0, -1.4)).transform(
                        yaw=turn
                    )
                )
                frames += [
                    shapes.box((w, 0.14, t)).transform((u + dx, -side, level * 2.9 + z)).transform(yaw=turn)
                    for dx, z, w, t in (
                        (0, 0.9, 1.3, 0.1),
                        (0, 2.4, 1.2, 0.1),
                        (-0.53, 1.0, 0.08, 1.4),
                        (0.53, 1.0, 0.08, 1.4),
                        (0, 1.0, 0.05, 1.4),
                    )
                ]
    p.add(shapes.box(size).transform(at, yaw=yaw), wall)
    p.add(join_parts(panes).transform(at, yaw=yaw), "glass")
    p.add(join_parts(frames).transform(at, yaw=yaw), "plaster 3")
    ridge_height, overhang = h + 0.45 * y, 0.4
    slopes = [
        shapes.quad(
            (-x / 2 - overhang, s * -(y / 2 + overhang), h - 0.18 * y * overhang),
            (x + 2 * overhang, 0, 0),
            (0, s * (y / 2 + overhang), ridge_height - h + 0.18 * y * overhang),
        )
        for s in (-1, 1)
    ]
    p.add(join_parts(slopes).transform(at, yaw=yaw), "tiles 3")
    gables = [
        shapes.triangle((s * x / 2, -y / 2, h), (s * x / 2, y / 2, h), (s * x / 2, 0, ridge_height)) for s in (-1, 1)
    ]
    p.add(join_parts(gables).transform(at, yaw=yaw), wall)


def lamp_post(p: Palette, at: Vector, height: float) -> None:
    """Thin lamp post with an arm."""
    profile = np.array([[0.09, 0], [0.09, 0.25], [0.05, 0.3], [0.035, height]])
    arm = np.array([[0, 0, height], [0.1, 0, height + 0.2], [0.5, 0, height + 0.3], [0.9, 0, height + 0.25]])
    lamp = shapes.ellipsoid((0.22, 0.1, 0.06)).transform((0.95, 0, height + 0.23))
    parts = [shapes.lathe(profile, 14), shapes.tube(arm, 0.025, 8), lamp]
    p.add(join_parts(parts).transform(at, yaw=p.draft.rng.uniform(0, 6.3)), "iron")
