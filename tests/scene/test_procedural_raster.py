"""The rasteriser against a ray caster written out face by face, and its edge cases."""

import torch

from gaussian_enhancer.scene.procedural.raster import (
    SampleGrid,
    barycentric,
    nearest_faces,
    project,
    sample_positions,
)
from gaussian_enhancer.types import identity_camera


def visible(
    corners: torch.Tensor, grid: SampleGrid, height: int = 24, width: int = 32
) -> tuple[torch.Tensor, torch.Tensor]:
    camera = identity_camera(height, width, 20.0)
    projected = project(corners, camera)
    none = torch.zeros(len(corners), dtype=torch.bool)
    face = nearest_faces(projected, grid, width, 0, height * grid.rows, none, lambda f, x, y: f >= 0)
    x, y = sample_positions(grid, width, 0, height * grid.rows, face.device)
    _, z = barycentric(projected.edges[face.clamp_min(0)], x, y)
    return face, torch.where(face >= 0, z, torch.zeros_like(z))


def cast(corners: torch.Tensor, grid: SampleGrid, height: int = 24, width: int = 32) -> torch.Tensor:
    """Moeller and Trumbore's test of every ray with every face; z or 0."""
    x, y = sample_positions(grid, width, 0, height * grid.rows, corners.device)
    rays = torch.stack([(x - width / 2) / 20, (y - height / 2) / 20, torch.ones_like(x)], 1)
    best = torch.full((len(rays),), torch.inf, dtype=torch.float64)
    for a, b, c in corners.double():
        p = torch.linalg.cross(rays, (c - a).expand_as(rays))
        det = p @ (b - a)
        u = -(p @ a) / det
        q = torch.linalg.cross(-a, b - a)
        v, t = rays @ q / det, (c - a) @ q / det
        hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0.02)
        best = torch.where(hit & (t < best), t, best)
    return torch.where(best.isinf(), torch.zeros_like(best), best)


def test_agrees_with_a_ray_caster_also_behind_the_camera() -> None:
    generator = torch.Generator().manual_seed(0)
    centres = torch.randn(40, 1, 3, generator=generator) * 2 + torch.tensor([0.0, 0.0, 2.5])
    corners = centres + torch.randn(40, 3, 3, generator=generator)
    assert (corners[..., 2].amin(1) < 0).any()
    for grid in (SampleGrid(), SampleGrid(4, 2)):
        _, z = visible(corners, grid)
        reference = cast(corners, grid)
        near = reference > 0.05
        assert near.float().mean() > 0.5
        assert torch.allclose(z[near].double(), reference[near], rtol=1e-4)
        assert (z[reference == 0] == 0).all()


def test_neighbouring_faces_leave_no_gap() -> None:
    generator = torch.Generator().manual_seed(1)
    angle = torch.arange(17) * (2 * torch.pi / 17)
    rim = torch.stack([3 * angle.cos(), 3 * angle.sin(), torch.full_like(angle, 2.0)], 1)
    rim = rim + 0.1 * torch.randn(17, 3, generator=generator)
    hub = torch.tensor([0.013, -0.021, 2.2]).expand(17, 3)
    face, _ = visible(torch.stack([hub, rim, rim.roll(-1, 0)], 1), SampleGrid(4, 2))
    assert (face >= 0).all()


def test_one_sample_is_the_pixels_centre_and_others_share_no_column() -> None:
    x, y = sample_positions(SampleGrid(), 3, 0, 2, torch.device("cpu"))
    assert torch.equal(x, torch.tensor([0.5, 1.5, 2.5, 0.5, 1.5, 2.5], dtype=torch.float64))
    assert torch.equal(y, torch.tensor([0.5] * 3 + [1.5] * 3, dtype=torch.float64))
    x, _ = sample_positions(SampleGrid(4, 2), 1, 0, 4, torch.device("cpu"))
    assert len(x.unique()) == 8
    assert ((x > 0) & (x < 1)).all()
    assert abs(float(x.mean()) - 0.5) < 1e-9
