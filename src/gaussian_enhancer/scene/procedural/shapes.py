"""Basic shapes: quads, boxes, solids of revolution, tubes, terrains, leaf cards and grass blades.

Axes: k points of a profile or path, n cards or blades, v vertices, f faces. Metres, z up.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from gaussian_enhancer.scene.procedural.mesh import SurfacePart, join_parts
from gaussian_enhancer.scene.procedural.vector import Number, Vector


def quad(origin: Vector, right: Vector, down: Vector, uv0: tuple[Number, Number] = (0.0, 0.0)) -> SurfacePart:
    """Parallelogram from its upper left corner; texture u increases to the right and v downwards, from `uv0`."""
    o, r, d = (np.asarray(value, dtype=float) for value in (origin, right, down))
    normal = np.cross(d, r)
    normal /= np.linalg.norm(normal)
    width, height = np.linalg.norm(r), np.linalg.norm(d)
    positions = np.stack([o, o + r, o + r + d, o + d])
    uvs = np.array([[0, 0], [width, 0], [width, height], [0, height]]) + np.asarray(uv0)
    return SurfacePart(positions, np.tile(normal, (4, 1)), uvs, np.array([[0, 1, 2], [0, 2, 3]]))


def box(size: Vector) -> SurfacePart:
    """Box of `size` (x, y, z), centred in x and y, from 0 to its height in z."""
    x, y, h = size[0] / 2, size[1] / 2, size[2]
    return join_parts(
        [
            quad((-x, -y, h), (2 * x, 0, 0), (0, 0, -h)),
            quad((x, y, h), (-2 * x, 0, 0), (0, 0, -h)),
            quad((x, -y, h), (0, 2 * y, 0), (0, 0, -h)),
            quad((-x, y, h), (0, -2 * y, 0), (0, 0, -h)),
            quad((-x, y, h), (2 * x, 0, 0), (0, -2 * y, 0)),
            quad((-x, -y, 0), (2 * x, 0, 0), (0, 2 * y, 0)),
        ]
    )


def triangle(a: Vector, b: Vector, c: Vector) -> SurfacePart:
    """One triangle; texture u runs along its first side."""
    positions = np.array([a, b, c], dtype=float)
    along = positions[1] - positions[0]
    width = np.linalg.norm(along)
    along /= width
    normal = np.cross(along, positions[2] - positions[0])
    normal /= np.linalg.norm(normal)
    uvs = (positions - positions[0]) @ np.stack([along, -np.cross(normal, along)], axis=1)
    return SurfacePart(positions, np.tile(normal, (3, 1)), uvs, np.array([[0, 1, 2]]))


def beam(start: Vector, end: Vector, width: float, depth: float) -> SurfacePart:
    """A straight square bar between two points."""
    a, b = np.asarray(start, dtype=float), np.asarray(end, dtype=float)
    w = (b - a) / np.linalg.norm(b - a)
    u = np.cross(w, [0.0, 0.0, 1.0] if abs(w[2]) < 0.9 else [0.0, 1.0, 0.0])
    u /= np.linalg.norm(u)
    v = np.cross(w, u)
    part = box((width, depth, float(np.linalg.norm(b - a))))
    axes = np.stack([u, v, w], axis=1)
    return replace(part, positions=part.positions @ axes.T + a, normals=part.normals @ axes.T)


def sheet(positions: np.ndarray, uvs: np.ndarray) -> SurfacePart:
    """A smooth surface through a grid of (rows, columns) points."""
    rows, columns = positions.shape[:2]
    along_row = np.gradient(positions, axis=1)
    along_column = np.gradient(positions, axis=0)
    normals = np.cross(along_row, along_column)
    normals /= np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-12)
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    return SurfacePart(positions.reshape(-1, 3), normals.reshape(-1, 3), uvs.reshape(-1, 2), faces)


def fan(outline: Float[np.ndarray, "k 3"]) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]:
    """Positions and faces of a triangle fan about the centroid of an outline; the centroid is the first position."""
    index = np.arange(1, len(outline))
    faces = np.stack([np.zeros_like(index), index, index + 1], axis=1)
    return np.concatenate([outline.mean(0)[None], outline]), faces


def _closed_sheet(positions: np.ndarray, uvs: np.ndarray) -> SurfacePart:
    """A sheet whose last column coincides with its first; the normals on both sides of the seam are made equal."""
    open_sheet = sheet(positions, uvs)
    normals = open_sheet.normals.reshape(positions.shape).copy()
    seam = normals[:, 0] + normals[:, -1]
    seam /= np.maximum(np.linalg.norm(seam, axis=1, keepdims=True), 1e-12)
    normals[:, 0] = normals[:, -1] = seam
    return replace(open_sheet, normals=normals.reshape(-1, 3))


def lathe(profile: Float[np.ndarray, "k 2"], segments: int = 24, flutes: int = 0, depth: float = 0.0) -> SurfacePart:
    """Solid of revolution about z from (radius, height) pairs, optionally with flutes of relative depth `depth`."""
    angle = np.linspace(0, 2 * np.pi, segments + 1)
    radius = profile[:, :1] * (1 - depth * (0.5 + 0.5 * np.cos(flutes * angle))[None])
    positions = np.stack(
        [radius * np.cos(angle), radius * np.sin(angle), np.broadcast_to(profile[:, 1:], radius.shape)], axis=-1
    )
    steps = np.linalg.norm(np.diff(profile, axis=0), axis=1)
    arc_length = np.concatenate([[0.0], np.cumsum(steps)])
    circumference = 2 * np.pi * max(float(profile[:, 0].max()), 1e-6)
    uvs = np.stack(
        np.broadcast_arrays(angle[None] / (2 * np.pi) * circumference, arc_length.max() - arc_length[:, None]), axis=-1
    )
    return _closed_sheet(positions, uvs)


def smooth_profile(points: list[tuple[float, float]], count: int = 24) -> Float[np.ndarray, "k 2"]:
    """Catmull-Rom curve through (radius, height) points, for `lathe`."""
    p = np.array([points[0], *points, points[-1]], dtype=float)
    t = np.linspace(0, len(points) - 1 - 1e-9, count)
    i = t.astype(int)
    s = (t - i)[:, None]
    a, b, c, d = p[i], p[i + 1], p[i + 2], p[i + 3]
    curve = 0.5 * (2 * b + (c - a) * s + (2 * a - 5 * b + 4 * c - d) * s**2 + (3 * b - a - 3 * c + d) * s**3)
    return np.stack([np.maximum(curve[:, 0], 0.0), curve[:, 1]], axis=1)


def ellipsoid(radii: Vector, segments: int = 20, bumps: Float[np.ndarray, "k 3"] | None = None) -> SurfacePart:
    """Ellipsoid about the origin; `bumps` are wave vectors of bumps on its surface, as for stones."""
    polar = np.linspace(0, np.pi, segments // 2 + 1)[:, None]
    angle = np.linspace(0, 2 * np.pi, segments + 1)[None]
    unit_sphere = np.stack(
        np.broadcast_arrays(np.sin(polar) * np.cos(angle), np.sin(polar) * np.sin(angle), -np.cos(polar)), axis=-1
    )
    radius_factor = np.ones(unit_sphere.shape[:2])
    for wave in bumps if bumps is not None else ():
        radius_factor = radius_factor + 0.35 / (1 + np.linalg.norm(wave)) * np.sin(unit_sphere @ wave + wave.sum())
    positions = unit_sphere * radius_factor[..., None] * np.asarray(radii)
    size = float(np.mean(radii))
    uvs = np.stack(np.broadcast_arrays(angle * size, polar * size), axis=-1)
    return _closed_sheet(positions, uvs)


def tube(path: Float[np.ndarray, "k 3"], radius: float | Float[np.ndarray, " k"], sides: int = 8) -> SurfacePart:
    """Round tube along a path, with constant or varying radius, for wires, poles, branches and frames."""
    tangents = np.gradient(path, axis=0)
    tangents /= np.maximum(np.linalg.norm(tangents, axis=1, keepdims=True), 1e-12)
    normals = np.empty_like(path)
    normal = np.cross(tangents[0], [0.0, 0.0, 1.0] if abs(tangents[0, 2]) < 0.9 else [1.0, 0.0, 0.0])
    for i, direction in enumerate(tangents):
        normal = normal - direction * (normal @ direction)
        normal = normal / np.linalg.norm(normal)
        normals[i] = normal
    binormals = np.cross(tangents, normals)
    angle = np.linspace(0, 2 * np.pi, sides + 1)
    r = np.broadcast_to(np.asarray(radius, dtype=float), (len(path),))[:, None, None]
    ring = np.cos(angle)[None, :, None] * normals[:, None] + np.sin(angle)[None, :, None] * binormals[:, None]
    arc_length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    uvs = np.stack(np.broadcast_arrays(angle[None] * float(np.mean(r)), arc_length[:, None]), axis=-1)
    return _closed_sheet(path[:, None] + r * ring, uvs)


def rod(start: Vector, end: Vector, radius: float, sides: int = 8) -> SurfacePart:
    """A straight tube between two points."""
    return tube(np.array([start, end], dtype=float), radius, sides)


def wire(start: Vector, end: Vector, sag: float, radius: float, sides: int = 4, count: int = 14) -> SurfacePart:
    """Wire between two points that hangs down by `sag` metres in the middle."""
    t = np.linspace(0, 1, count)[:, None]
    path = np.asarray(start) * (1 - t) + np.asarray(end) * t
    path[:, 2] -= sag * 4 * (t * (1 - t))[:, 0]
    return tube(path, radius, sides)


def terrain(
    xs: Float[np.ndarray, " columns"],
    ys: Float[np.ndarray, " rows"],
    height: Callable[[np.ndarray, np.ndarray], np.ndarray],
) -> SurfacePart:
    """Height field over a grid of x and y; `height` returns z."""
    x, y = np.meshgrid(xs, ys)
    return sheet(np.stack([x, y, height(x, y)], axis=-1), np.stack([x, y], axis=-1))


def hillside(
    angle: Float[np.ndarray, " columns"],
    crest: Float[np.ndarray, " columns"],
    radii: Float[np.ndarray, " rows"],
    foot: float,
) -> SurfacePart:
    """Slope about the origin, seen from inside, that rises from `foot` at the first radius by `crest` at the last."""
    r, rise = radii[:, None], np.sin(np.linspace(0, 1, len(radii)) * np.pi / 2)[:, None]
    z = crest[None] * rise + foot
    positions = np.stack(np.broadcast_arrays(r * np.cos(angle), r * np.sin(angle), z), axis=-1)
    return sheet(positions, np.stack(np.broadcast_arrays(angle[None] * radii[0], r + z), axis=-1))


def curtain(width: float, height: float, folds: int, depth: float) -> SurfacePart:
    """Hanging cloth in the xz plane, with folds of a depth along y."""
    x, z = np.meshgrid(np.linspace(0, width, 96), np.linspace(height, 0, 6))
    y = depth * np.sin(2 * np.pi * folds * x / width + 0.3 * np.sin(3 * x)) * (0.6 + 0.4 * (1 - z / height))
    return sheet(np.stack([x, y, z], axis=-1), np.stack([x * 1.3, height - z], axis=-1))


def cards(rng: np.random.Generator, centres: Float[np.ndarray, "n 3"], size: float, lift: float = 0.5) -> SurfacePart:
    """Randomly rotated square cards, one per centre, for leaf textures with holes; with `lift` 0 they are upright."""
    n = len(centres)
    yaw, pitch = rng.uniform(0, 2 * np.pi, n), rng.uniform(-np.pi / 2, np.pi / 2, n) * lift
    right = np.stack([np.cos(yaw), np.sin(yaw), np.zeros(n)], -1)
    down = np.stack([np.sin(pitch) * np.sin(yaw), -np.sin(pitch) * np.cos(yaw), -np.cos(pitch)], -1)
    half_sizes = (0.5 * size * rng.uniform(0.7, 1.3, n))[:, None]
    corners = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    positions = np.stack([centres + half_sizes * (a * right + b * down) for a, b in corners], axis=1)
    # Normals point away from the crown's centre, so that the crown is shaded as a volume, not as single cards.
    outward = centres - centres.mean(0) + np.array([0, 0, 0.4]) * size
    outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-9)
    normals = np.repeat(outward[:, None], 4, axis=1)
    uvs = np.broadcast_to(np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]]) * size, (n, 4, 2))
    start = 4 * np.arange(n)[:, None, None]
    faces = (start + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
    return SurfacePart(positions.reshape(-1, 3), normals.reshape(-1, 3), uvs.reshape(-1, 2), faces)


def blades(rng: np.random.Generator, roots: Float[np.ndarray, "n 3"], height: float, width: float) -> SurfacePart:
    """Grass: one thin bent blade of two triangles per root."""
    n = len(roots)
    yaw, bend_angle = rng.uniform(0, 2 * np.pi, n), rng.uniform(0, 2 * np.pi, n)
    heights = (height * rng.uniform(0.5, 1.3, n))[:, None]
    right = np.stack([np.cos(yaw), np.sin(yaw), np.zeros(n)], -1) * width / 2
    bend = (
        np.stack([np.cos(bend_angle), np.sin(bend_angle), np.zeros(n)], -1)
        * heights
        * rng.uniform(0.1, 0.6, n)[:, None]
    )
    up = np.array([0, 0, 1.0]) * heights
    middle = roots + 0.55 * up + 0.3 * bend
    positions = np.stack([roots - right, roots + right, middle + 0.7 * right, roots + up + bend], axis=1)
    normals = np.broadcast_to(np.array([0, 0, 1.0]), positions.shape) + 0.5 * rng.normal(size=(n, 1, 3))
    normals = normals / np.linalg.norm(normals, axis=2, keepdims=True)
    blade_uvs = np.array([[0, 1], [0.1, 1], [0.08, 0.45], [0.05, 0.0]]) * height
    uvs = blade_uvs[None] + rng.uniform(0, 4, (n, 1, 2))
    faces = (4 * np.arange(n)[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
    return SurfacePart(positions.reshape(-1, 3), normals.reshape(-1, 3), uvs.reshape(-1, 2), faces)
