"""Rasterisation: the visible face of each sample by exact ray-triangle visibility for pinhole cameras, per scan line.

Let v0, v1, v2 be a face's corners in camera axes, det = v0 . (v1 x v2), and d = (x, y, 1) a ray. The functions
w_i(d) = d . (v_{i+1} x v_{i+2}) / det are linear in the pixel coordinates. The ray hits the face in front of the camera
exactly where all three are non-negative, at 1/z = w0 + w1 + w2, with barycentric coordinates z w_i (homogeneous
rasterisation, Olano and Greer, Graphics Hardware 1997). So no face needs clipping, and a face covers one interval of
samples on each scan line.

Axes: f faces, n samples.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from gaussian_enhancer.scene.procedural.vector import dot
from gaussian_enhancer.types import Camera

NEAR = 0.02


@dataclass(frozen=True)
class SampleGrid:
    """Sample positions in a pixel: `rows` x `columns` points. Rows are shifted, so that no two points have the same x.

    One row and one column give the pixel's centre.
    """

    rows: int = 1
    columns: int = 1


@dataclass(frozen=True)
class ProjectedFaces:
    """Faces projected by one camera.

    Args:
        edges: coefficients (of x, of y, constant) of each face's three functions w_i of pixel coordinates.
        top: lower bound of y on the face, in pixels.
        bottom: upper bound of y on the face, in pixels.
        faces: indices of the faces that may be in view.
    """

    edges: Float[Tensor, "f 3 3"]
    top: Float[Tensor, " f"]
    bottom: Float[Tensor, " f"]
    faces: Int[Tensor, " n"]


def project(corners: Float[Tensor, "f 3 3"], camera: Camera) -> ProjectedFaces:
    """Project faces (world corners) in float64; in float32, far and oblique faces suffer from cancellation."""
    K, pose = camera.K.to(corners.device).double(), camera.world_to_camera.to(corners.device).double()
    points = corners.double() @ pose[:3, :3].T + pose[:3, 3]
    crossed = torch.cross(points[:, [1, 2, 0]], points[:, [2, 0, 1]], dim=2)
    det = dot(points[:, 0], crossed[:, 0])
    edges = (crossed @ torch.linalg.inv(K)) / det[:, None, None]
    z = points[..., 2]
    in_front = (z > NEAR).all(1)
    pixels = points @ K.T
    x, y = (pixels[..., :2] / z.clamp_min(NEAR)[..., None]).unbind(-1)
    limit = float(camera.height)
    top = torch.where(in_front, y.amin(1), torch.zeros_like(det))
    bottom = torch.where(in_front, y.amax(1), torch.full_like(det, limit))
    outside = in_front & ((x.amax(1) < 0) | (x.amin(1) > camera.width) | (bottom < 0) | (top > limit))
    in_view = (z > NEAR).any(1) & ~outside & torch.isfinite(edges).all(2).all(1)
    return ProjectedFaces(edges, top, bottom, in_view.nonzero()[:, 0])


def sample_positions(
    grid: SampleGrid, width: int, first_row: int, end_row: int, device: torch.device
) -> tuple[Float[Tensor, " n"], Float[Tensor, " n"]]:
    """Pixel coordinates x and y of all samples in sample rows `first_row` to `end_row` - 1, row by row."""
    row = torch.arange(first_row, end_row, device=device, dtype=torch.float64)
    column = torch.arange(width * grid.columns, device=device, dtype=torch.float64)
    x = (column[None] + _shift(row, grid)[:, None]) / grid.columns
    y = ((row + 0.5) / grid.rows)[:, None].expand_as(x)
    return x.reshape(-1), y.reshape(-1)


def _shift(row: Tensor, grid: SampleGrid) -> Tensor:
    return (row.remainder(grid.rows) + 0.5) / grid.rows


def barycentric(
    edges: Float[Tensor, "n 3 3"], x: Float[Tensor, " n"], y: Float[Tensor, " n"]
) -> tuple[Float[Tensor, "n 3"], Float[Tensor, " n"]]:
    """Barycentric coordinates and z at which samples hit their faces, from the faces' `ProjectedFaces.edges`."""
    weights = edges[..., 0] * x[:, None] + edges[..., 1] * y[:, None] + edges[..., 2]
    z = 1 / (weights[:, 0] + weights[:, 1] + weights[:, 2])
    return (weights * z[:, None]).float(), z.float()


KeepSamples = Callable[[Int[Tensor, " n"], Float[Tensor, " n"], Float[Tensor, " n"]], Bool[Tensor, " n"]]


def nearest_faces(
    projected: ProjectedFaces,
    grid: SampleGrid,
    width: int,
    first_row: int,
    end_row: int,
    cutout: Bool[Tensor, " f"],
    keep: KeepSamples,
) -> Int[Tensor, " n"]:
    """Return the nearest face at each sample of rows `first_row` to `end_row` - 1; -1 where there is none.

    Args:
        projected: faces projected by `project`.
        grid: samples within a pixel.
        width: image width in pixels.
        first_row: first sample row.
        end_row: sample row after the last one.
        cutout: whether each face's texture has holes.
        keep: returns, for (face, x, y), whether a face with holes is solid at that pixel position.
    """
    columns = width * grid.columns
    count = (end_row - first_row) * columns
    # Key: upper 32 bits: bits of 1/z, which sort like the positive floats; lower 32 bits: face index + 1.
    best = torch.zeros(count, dtype=torch.int64, device=projected.edges.device)
    has_holes = cutout[projected.faces]
    for faces, hole_test in ((projected.faces[~has_holes], None), (projected.faces[has_holes], keep)):
        for face, sample, inverse_depth in _covered_samples(projected, faces, grid, columns, first_row, end_row):
            if hole_test is not None:
                nearer = ((inverse_depth.view(torch.int32).long() << 32) > best[sample]).nonzero()[:, 0]
                face, sample, inverse_depth = face[nearer], sample[nearer], inverse_depth[nearer]
                row = (sample // columns).double() + first_row
                x = ((sample % columns).double() + _shift(row, grid)) / grid.columns
                solid = hole_test(face, x, (row + 0.5) / grid.rows)
                face, sample, inverse_depth = face[solid], sample[solid], inverse_depth[solid]
            key = (inverse_depth.view(torch.int32).long() << 32) | (face + 1)
            best.scatter_reduce_(0, sample, key, "amax")
    return (best & 0xFFFFFFFF) - 1


def _covered_samples(
    projected: ProjectedFaces, faces: Tensor, grid: SampleGrid, columns: int, first_row: int, end_row: int
) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
    """Yield all (face, sample, 1/z) of a band of rows, in portions of limited size."""
    top = (projected.top[faces] * grid.rows - 0.5).ceil().long().clamp_min(first_row)
    bottom = (projected.bottom[faces] * grid.rows - 0.5).floor().long().clamp_max(end_row - 1)
    rows = (bottom - top + 1).clamp_min(0)
    covered = rows.nonzero()[:, 0]
    for face_slice in _portions(rows[covered], 1_000_000):
        part_indices = covered[face_slice]
        face_of_row = torch.repeat_interleave(rows[part_indices])
        start = rows[part_indices].cumsum(0) - rows[part_indices]
        row = (
            top[part_indices][face_of_row]
            + torch.arange(len(face_of_row), device=face_of_row.device)
            - start[face_of_row]
        )
        face = faces[part_indices][face_of_row]
        low, high, value, slope = _spans(projected.edges, face, row, grid, columns)
        lengths = (high - low + 1).clamp_min(0)
        span = lengths.nonzero()[:, 0]
        for span_slice in _portions(lengths[span], 1_500_000):
            span_indices = span[span_slice]
            length = lengths[span_indices]
            span_of_sample = torch.repeat_interleave(length)
            step = (
                torch.arange(len(span_of_sample), device=span_of_sample.device)
                - (length.cumsum(0) - length)[span_of_sample]
            )
            sample = ((row[span_indices] - first_row) * columns + low[span_indices])[span_of_sample] + step
            inverse_depth = value[span_indices][span_of_sample] + slope[span_indices][span_of_sample] * step
            yield face[span_indices][span_of_sample], sample, inverse_depth.clamp(1e-12, 1 / NEAR)


def _portions(sizes: Tensor, limit: int) -> Iterator[slice]:
    """Split a list of sizes into slices whose sums are close to a limit."""
    ends = sizes.cumsum(0)
    total = int(ends[-1]) if len(ends) else 0
    if total <= limit:
        if total:
            yield slice(0, len(sizes))
        return
    boundaries = torch.arange(limit, total + limit, limit, device=sizes.device)
    cuts = [0, *torch.searchsorted(ends, boundaries, right=False).add(1).clamp_max(len(sizes)).unique().tolist()]
    for begin, end in pairwise(cuts):
        yield slice(begin, end)


def _spans(edges: Tensor, face: Tensor, row: Tensor, grid: SampleGrid, columns: int) -> tuple[Tensor, ...]:
    """First and last covered column of each (face, row), 1/z at the first, and its increment per column."""
    y = (row.double() + 0.5) / grid.rows
    shift = _shift(row.double(), grid)
    low = torch.zeros_like(y)
    high = torch.full_like(y, columns - 1)
    coefficients = edges[face]
    slope, constant = coefficients[..., 0], coefficients[..., 1] * y[:, None] + coefficients[..., 2]
    for i in range(3):
        crossing = -constant[:, i] / slope[:, i] * grid.columns - shift
        low = torch.where(slope[:, i] > 0, torch.maximum(low, crossing.ceil()), low)
        high = torch.where(slope[:, i] < 0, torch.minimum(high, crossing.floor()), high)
        high = torch.where((slope[:, i] == 0) & (constant[:, i] < 0), torch.full_like(high, -1), high)
    low = low.clamp(0, columns)
    high = high.clamp(-1, columns - 1)
    per_column = (slope[:, 0] + slope[:, 1] + slope[:, 2]) / grid.columns
    inverse_depth = per_column * (low + shift) + (constant[:, 0] + constant[:, 1] + constant[:, 2])
    return low.long(), high.long(), inverse_depth.float(), per_column.float()
