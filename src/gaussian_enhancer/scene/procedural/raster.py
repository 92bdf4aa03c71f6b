"""The visible face of each sample: exact ray-triangle visibility for pinhole cameras, scan line by scan line.

With a face's corners v0, v1, v2 in camera axes, det = v0 . (v1 x v2) and a ray d = (x, y, 1), the functions
w_i(d) = d . (v_{i+1} x v_{i+2}) / det are linear in the pixel; the ray meets the face in front of the camera exactly
where all three are non-negative, at 1/z = w0 + w1 + w2, with barycentric coordinates z w_i (homogeneous
rasterisation, Olano and Greer, Graphics Hardware 1997). Nothing is clipped, and along a scan line the covered
samples are one interval.

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
    """How a pixel is sampled: `rows` x `columns` points; each row is shifted so that no two share an x.

    One row and one column is the pixel's centre.
    """

    rows: int = 1
    columns: int = 1


@dataclass(frozen=True)
class Projected:
    """Faces as one camera sees them.

    Args:
        edges: coefficients (of x, of y, constant) of the three w_i over pixel coordinates.
        top: first pixel coordinate y that the face can reach.
        bottom: last pixel coordinate y.
        faces: indices of the faces that can be seen at all.
    """

    edges: Float[Tensor, "f 3 3"]
    top: Float[Tensor, " f"]
    bottom: Float[Tensor, " f"]
    faces: Int[Tensor, " n"]


def project(corners: Float[Tensor, "f 3 3"], camera: Camera) -> Projected:
    """Set up faces (world corners) for a camera, in float64: far and slanted faces cancel badly in float32."""
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
    return Projected(edges, top, bottom, in_view.nonzero()[:, 0])


def sample_positions(
    grid: SampleGrid, width: int, first: int, last: int, device: torch.device
) -> tuple[Float[Tensor, " n"], Float[Tensor, " n"]]:
    """Pixel coordinates x and y of all samples in the sample rows from `first` to before `last`, row by row."""
    row = torch.arange(first, last, device=device, dtype=torch.float64)
    column = torch.arange(width * grid.columns, device=device, dtype=torch.float64)
    x = (column[None] + _shift(row, grid)[:, None]) / grid.columns
    y = ((row + 0.5) / grid.rows)[:, None].expand_as(x)
    return x.reshape(-1), y.reshape(-1)


def _shift(row: Tensor, grid: SampleGrid) -> Tensor:
    return (row.remainder(grid.rows) + 0.5) / grid.rows


def barycentric(
    edges: Float[Tensor, "n 3 3"], x: Float[Tensor, " n"], y: Float[Tensor, " n"]
) -> tuple[Float[Tensor, "n 3"], Float[Tensor, " n"]]:
    """Barycentric coordinates and z where samples meet their faces, from the faces' `Projected.edges`."""
    weights = edges[..., 0] * x[:, None] + edges[..., 1] * y[:, None] + edges[..., 2]
    z = 1 / (weights[:, 0] + weights[:, 1] + weights[:, 2])
    return (weights * z[:, None]).float(), z.float()


Keep = Callable[[Int[Tensor, " n"], Float[Tensor, " n"], Float[Tensor, " n"]], Bool[Tensor, " n"]]


def nearest_faces(
    projected: Projected,
    grid: SampleGrid,
    width: int,
    first: int,
    last: int,
    cutout: Bool[Tensor, " f"],
    keep: Keep,
) -> Int[Tensor, " n"]:
    """The nearest face at each sample of the rows from `first` to before `last`, -1 where there is none.

    Args:
        projected: faces set up by `project`.
        grid: samples within a pixel.
        width: image width in pixels.
        first: first sample row.
        last: sample row to stop before.
        cutout: faces with holes.
        keep: tells for (face, x, y) whether a face with holes is solid there.
    """
    columns = width * grid.columns
    count = (last - first) * columns
    # Key: bits of 1/z (positive floats keep their order as integers) above, the face below.
    best = torch.zeros(count, dtype=torch.int64, device=projected.edges.device)
    holed = cutout[projected.faces]
    for faces, test in ((projected.faces[~holed], None), (projected.faces[holed], keep)):
        for face, sample, inverse in _covered_samples(projected, faces, grid, columns, first, last):
            if test is not None:
                ahead = ((inverse.view(torch.int32).long() << 32) > best[sample]).nonzero()[:, 0]
                face, sample, inverse = face[ahead], sample[ahead], inverse[ahead]
                row = (sample // columns).double() + first
                x = ((sample % columns).double() + _shift(row, grid)) / grid.columns
                solid = test(face, x, (row + 0.5) / grid.rows)
                face, sample, inverse = face[solid], sample[solid], inverse[solid]
            key = (inverse.view(torch.int32).long() << 32) | (face + 1)
            best.scatter_reduce_(0, sample, key, "amax")
    return (best & 0xFFFFFFFF) - 1


def _covered_samples(
    projected: Projected, faces: Tensor, grid: SampleGrid, columns: int, first: int, last: int
) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
    """All (face, sample, 1/z) of a band of rows, in portions that fit into memory."""
    top = (projected.top[faces] * grid.rows - 0.5).ceil().long().clamp_min(first)
    bottom = (projected.bottom[faces] * grid.rows - 0.5).floor().long().clamp_max(last - 1)
    rows = (bottom - top + 1).clamp_min(0)
    covered = rows.nonzero()[:, 0]
    for part in _portions(rows[covered], 1_000_000):
        some = covered[part]
        source = torch.repeat_interleave(rows[some])
        start = rows[some].cumsum(0) - rows[some]
        row = top[some][source] + torch.arange(len(source), device=source.device) - start[source]
        face = faces[some][source]
        low, high, value, slope = _spans(projected.edges, face, row, grid, columns)
        lengths = (high - low + 1).clamp_min(0)
        span = lengths.nonzero()[:, 0]
        for portion in _portions(lengths[span], 1_500_000):
            chosen = span[portion]
            length = lengths[chosen]
            index = torch.repeat_interleave(length)
            step = torch.arange(len(index), device=index.device) - (length.cumsum(0) - length)[index]
            sample = ((row[chosen] - first) * columns + low[chosen])[index] + step
            inverse = value[chosen][index] + slope[chosen][index] * step
            yield face[chosen][index], sample, inverse.clamp(1e-12, 1 / NEAR)


def _portions(sizes: Tensor, limit: int) -> Iterator[slice]:
    """Cut a list of sizes into slices whose sums stay near a limit."""
    ends = sizes.cumsum(0)
    total = int(ends[-1]) if len(ends) else 0
    if total <= limit:
        if total:
            yield slice(0, len(sizes))
        return
    status = torch.arange(limit, total + limit, limit, device=sizes.device)
    cuts = [0, *torch.searchsorted(ends, status, right=False).add(1).clamp_max(len(sizes)).unique().tolist()]
    for begin, end in pairwise(cuts):
        yield slice(begin, end)


def _spans(edges: Tensor, face: Tensor, row: Tensor, grid: SampleGrid, columns: int) -> tuple[Tensor, ...]:
    """First and last covered column of each (face, row), and 1/z there with its step a column."""
    y = (row.double() + 0.5) / grid.rows
    shift = _shift(row.double(), grid)
    low = torch.zeros_like(y)
    high = torch.full_like(y, columns - 1)
    chosen = edges[face]
    slope, rest = chosen[..., 0], chosen[..., 1] * y[:, None] + chosen[..., 2]
    for i in range(3):
        crossing = -rest[:, i] / slope[:, i] * grid.columns - shift
        low = torch.where(slope[:, i] > 0, torch.maximum(low, crossing.ceil()), low)
        high = torch.where(slope[:, i] < 0, torch.minimum(high, crossing.floor()), high)
        high = torch.where((slope[:, i] == 0) & (rest[:, i] < 0), torch.full_like(high, -1), high)
    low = low.clamp(0, columns)
    high = high.clamp(-1, columns - 1)
    per_column = (slope[:, 0] + slope[:, 1] + slope[:, 2]) / grid.columns
    value = per_column * (low + shift) + (rest[:, 0] + rest[:, 1] + rest[:, 2])
    return low.long(), high.long(), value.float(), per_column.float()
