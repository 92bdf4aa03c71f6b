"""The look at candidates on a coarse grid: sizes, shares, and that it takes those that the full warp would take."""

import torch

from gaussian_enhancer.align.alignment import LoadedView, Reprojected
from gaussian_enhancer.align.coarse_visibility import coarse_visibility, coarsen, visible_shares
from support.synthetic_runs import plane_camera, plane_view

TEXTURE = torch.rand(3, 192, 192, generator=torch.Generator().manual_seed(0))


def view(index: int, size: tuple[int, int] = (192, 256)) -> LoadedView:
    camera = plane_camera(index, *size)
    photo, depth = plane_view(camera, TEXTURE)
    return LoadedView(f"{index}.png", photo, camera, depth, torch.ones_like(depth), photo, lambda: (255 * photo).byte())


def test_a_coarse_view_is_the_same_view_with_few_pixels():
    small = coarsen(view(0))
    assert small.image.shape == (3, 48, 64)
    assert small.camera is not None
    assert (small.camera.height, small.camera.width) == (48, 64)
    torch.testing.assert_close(small.image.mean(), view(0).image.mean(), atol=1e-4, rtol=0)
    assert small.depth is not None
    assert set(small.depth.unique().tolist()) <= set(view(0).depth.unique().tolist())  # type: ignore[union-attr]
    assert small.read_fine is None
    assert coarsen(view(0, (24, 32))).image.shape == (3, 24, 32)


def test_candidates_are_seen_as_the_full_warp_sees_them():
    target, others = view(0), [view(index) for index in (1, 3, 6)]
    seen = coarse_visibility(Reprojected(), coarsen(target), [coarsen(other) for other in others])
    found = visible_shares(seen, coarsen(target).alpha)
    full = Reprojected()(target, others, 3)
    assert next(iter(found)) == full.names[0]
    assert set(found) == set(full.names)
    for name, exact in zip(full.names, full.visibility.mean((1, 2, 3)).tolist(), strict=True):
        assert abs(found[name] - exact) < 0.03


def test_what_is_not_there_cannot_be_missed():
    target, other = view(0), view(1)
    half = torch.ones(1, 192, 256)
    half[..., :128] = 0
    masked = coarsen(LoadedView("0.png", target.image, target.camera, target.depth, half))
    seen = coarse_visibility(Reprojected(), masked, [coarsen(other)])
    assert visible_shares(seen, masked.alpha)["1.png"] > 0.9
    assert visible_shares(seen, None)["1.png"] < 0.51
