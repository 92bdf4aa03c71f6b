"""Pruning by free space on a sheet of coloured Gaussians, whose photos are its own renders."""

from dataclasses import replace

import pytest
import torch

from gaussian_enhancer.distil.prune import PruneSettings, prune
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.runs.rendered_capture import SplatRenderer
from gaussian_enhancer.scene.scene import Photo
from gaussian_enhancer.splat.methods import Method, MipSplatting, ThreeDGS, TwoDGS
from gaussian_enhancer.types import Gaussians
from support.synthetic_runs import coloured_sheet, plane_camera

SHEET = coloured_sheet(24)


def kind(gaussians: Gaussians, method: Method) -> Gaussians:
    if isinstance(method, TwoDGS):
        return replace(gaussians, log_scales=gaussians.log_scales[:, :2])
    smoothing = torch.full((len(gaussians),), 0.01) if isinstance(method, MipSplatting) else None
    return replace(gaussians, smoothing=smoothing)


def with_floaters(*places: tuple[float, float, float], opacity: float = 0.9) -> Gaussians:
    """The sheet with grey Gaussians before it, at the end of the list."""
    count = len(places)
    logit = float(torch.logit(torch.tensor(opacity)))
    joined = {
        "means": torch.tensor(places),
        "log_scales": torch.full((count, 3), 0.05).log(),
        "quaternions": torch.tensor([[1.0, 0, 0, 0]]).repeat(count, 1),
        "opacity_logits": torch.full((count,), logit),
        "sh": torch.zeros(count, 1, 3),
    }
    return Gaussians(**{name: torch.cat([getattr(SHEET, name), value]) for name, value in joined.items()})


def renderer(gaussians: Gaussians, method: Method) -> SplatRenderer:
    return SplatRenderer(kind(gaussians, method), method, (0.0, 0.0, 0.0), 0.01)


def photos_of(drawn: SplatRenderer, noise: float = 0.02) -> tuple[Photo, ...]:
    """Photos of the plane's cameras: renders with noise."""
    generator = torch.Generator().manual_seed(1)
    found = []
    for index in range(8):
        camera = plane_camera(index, 48, 64)
        clean = drawn(camera).colour
        pixels = (clean + noise * torch.randn(clean.shape, generator=generator)).clamp(0, 1)
        found.append(Photo(f"{index}.png", camera, lambda pixels=pixels: pixels))
    return tuple(found)


@pytest.mark.parametrize("method", [ThreeDGS(), TwoDGS(), MipSplatting()], ids=lambda m: m.name)
@pytest.mark.parametrize("opacity", [0.3, 0.9])
def test_injected_floaters_go_and_nothing_else(method, opacity):
    photos = photos_of(renderer(SHEET, method))
    spoilt = renderer(with_floaters((0.0, 0.0, 1.5), (0.3, -0.2, 1.0), opacity=opacity), method)
    found = prune(spoilt, photos, PruneSettings())
    assert (~found.kept).nonzero()[:, 0].tolist() == [len(SHEET), len(SHEET) + 1]
    assert found.after > found.before
    assert str(found).startswith(f"2 of {len(SHEET) + 2} Gaussians removed")


@pytest.mark.parametrize("method", [ThreeDGS(), TwoDGS(), MipSplatting()], ids=lambda m: m.name)
def test_a_clean_splat_stays_as_it_is(method):
    drawn = renderer(SHEET, method)
    found = prune(drawn, photos_of(drawn), PruneSettings())
    assert bool(found.kept.all())
    assert found.suspected == 0
    assert found.after == found.before


def test_what_the_photos_show_stays_although_it_hangs_in_the_air():
    drawn = renderer(with_floaters((0.0, 0.0, 1.5)), ThreeDGS())
    assert bool(prune(drawn, photos_of(drawn), PruneSettings()).kept.all())


def test_what_few_views_see_through_stays():
    photos = photos_of(renderer(SHEET, ThreeDGS()))
    spoilt = renderer(with_floaters((0.0, 0.0, 1.5)), ThreeDGS())
    assert bool(prune(spoilt, photos, PruneSettings(views=9)).kept.all())
    behind = renderer(with_floaters((0.0, 0.0, 2.9)), ThreeDGS())  # within the margin of the surface
    assert bool(prune(behind, photos, PruneSettings()).kept.all())


def test_nothing_goes_where_the_photos_would_be_shown_worse(monkeypatch):
    from gaussian_enhancer.distil import prune as module

    photos = photos_of(renderer(SHEET, ThreeDGS()))
    spoilt = renderer(with_floaters((0.0, 0.0, 1.5)), ThreeDGS())
    falling = iter((30.0, 29.99))
    monkeypatch.setattr(module, "_psnr", lambda *_: next(falling))
    found = prune(spoilt, photos, PruneSettings())
    assert bool(found.kept.all())
    assert (found.suspected, found.before, found.after) == (1, 30.0, 30.0)


def test_bad_evidence_and_photos_without_cameras_are_refused():
    with pytest.raises(InputError, match=r"prune\.views"):
        PruneSettings(views=0)
    with pytest.raises(InputError, match="has no camera"):
        prune(renderer(SHEET, ThreeDGS()), (Photo("a.png", None, lambda: torch.zeros(3, 4, 4)),), PruneSettings())
