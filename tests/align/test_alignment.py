import dataclasses
from functools import partial

import pytest
import torch

from gaussian_enhancer.align.alignment import LoadedView, Reprojected, Unwarped, _fine_rows
from gaussian_enhancer.align.reproject import Warped
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.types import identity_camera
from support.synthetic_runs import plane_camera, plane_view


def pixels(index: int, gain: float = 1.0, size: tuple[int, int] = (48, 64), cells: int = 24) -> LoadedView:
    generator = torch.Generator().manual_seed(0)
    texture = torch.nn.functional.interpolate(
        torch.rand(1, 3, cells, cells, generator=generator), size=192, mode="bicubic"
    )[0]
    camera = plane_camera(index, *size)
    photo, depth = plane_view(camera, texture.clamp(0, 1))
    return LoadedView(f"{index}.png", (photo * gain).clamp(0, 1), camera, depth, torch.ones_like(depth))


def test_reprojected_references_show_what_the_target_shows():
    target = pixels(0)
    aligned = Reprojected()(target, [pixels(1, 0.8), pixels(2, 1.1), pixels(5)], keep=2)
    assert aligned.references.shape == (2, 3, 48, 64)
    seen = aligned.visibility[:, 0] > 0.9
    assert seen.float().mean() > 0.7
    error = (aligned.references - target.image).abs().mean(1)[seen]
    unaligned = (pixels(1).image - target.image).abs().mean()
    assert error.mean() < 0.15 * unaligned


def test_unwarped_takes_the_nearest_as_they_are_in_the_targets_size():
    target, reference = pixels(0), pixels(1)
    large = dataclasses.replace(reference, image=torch.rand(3, 100, 90), name="large.png", camera=None, alpha=None)
    aligned = Unwarped()(target, [reference, large, reference], keep=2)
    assert torch.equal(aligned.references[0], reference.image)
    assert aligned.references.shape == (2, 3, 48, 64)
    assert bool((aligned.visibility == 1).all())
    assert aligned.names == ("1.png", "large.png")


@pytest.mark.parametrize("warp", [Reprojected(), Unwarped()])
def test_no_reference_is_no_error(warp):
    bare = dataclasses.replace(pixels(0), depth=None, camera=None)
    assert warp(bare, [], keep=3).references.shape == (0, 3, 48, 64)


def test_missing_geometry_is_refused_by_name():
    target, reference = pixels(0), pixels(1)
    with pytest.raises(InputError, match=r"0.png.*no depth"):
        Reprojected()(dataclasses.replace(target, depth=None), [reference], 1)
    with pytest.raises(InputError, match=r"1.png.*no camera"):
        Reprojected()(target, [dataclasses.replace(reference, camera=None)], 1)


@pytest.mark.parametrize("own_render", [True, False])
def test_fine_references_show_what_the_target_shows_in_the_same_exposure(own_render):
    def fine(index: int) -> torch.Tensor:
        return pixels(index, size=(192, 256), cells=96).image

    def stored(index: int, gain: float = 1.0) -> torch.Tensor:
        return (fine(index) * gain * 255).round().byte()

    target, references = pixels(0, cells=96), []
    for index, gain in ((1, 0.8), (2, 0.9)):
        render = pixels(index, cells=96).image if own_render else None
        photo = pixels(index, gain, cells=96)
        references.append(dataclasses.replace(photo, render=render, read_fine=partial(stored, index, gain)))
    errors = []
    for match_colour in (True, False):
        aligned = Reprojected(depth="exact", match_colour=match_colour)(target, references, keep=2)
        assert aligned.fine is not None
        assert aligned.fine.shape == (2, 3, 192, 256)
        pooled = torch.nn.functional.avg_pool2d(aligned.fine, 4)
        assert (pooled - aligned.references).abs().mean(1)[aligned.visibility[:, 0] > 0.9].mean() < 0.03
        shown = torch.nn.functional.interpolate(aligned.visibility, scale_factor=4)[:, 0] > 0.9
        errors.append((aligned.fine - fine(0)).abs().mean(1)[shown].mean())
    assert errors[0] < 0.4 * errors[1]
    blurred = torch.nn.functional.interpolate(target.image[None], scale_factor=4, mode="bicubic")[0]
    clean = [dataclasses.replace(pixels(i, cells=96), read_fine=partial(stored, i)) for i in (1, 2)]
    aligned = Reprojected(depth="exact", match_colour=False)(target, clean, keep=2)
    shown = torch.nn.functional.interpolate(aligned.visibility, scale_factor=4)[:, 0] > 0.9
    assert (aligned.fine - fine(0)).abs().mean(1)[shown].mean() < 0.3 * (blurred - fine(0)).abs().mean()
    hidden = torch.nn.functional.interpolate(aligned.visibility, scale_factor=4)[:, 0] == 0
    assert bool((aligned.fine.abs().amax(1)[hidden] == 0).all())


def test_fine_references_change_nothing_else_and_are_absent_unless_asked_for():
    target, reference = pixels(0), pixels(1)
    photo = (pixels(1, size=(192, 256)).image * 255).byte()
    finer = dataclasses.replace(reference, read_fine=lambda: photo)
    for warp in (Reprojected(), Unwarped()):
        plain, both = warp(target, [reference], 1), warp(target, [finer], 1)
        assert plain.fine is None
        assert both.fine is not None
        assert torch.equal(plain.references, both.references)
        assert torch.equal(plain.visibility, both.visibility)
    assert torch.equal(both.fine[0], photo / 255)


def test_what_does_not_look_like_the_render_is_no_reference_there():
    image = torch.rand(3, 40, 60, generator=torch.Generator().manual_seed(0)) * 0.4
    camera = identity_camera(40, 60, 50.0)
    target = LoadedView("t", image, camera, torch.full((1, 40, 60), 2.0))
    mirror = image.clone()
    mirror[:, 10:30, 20:40] = 1.0
    reference = LoadedView("r", mirror, camera, torch.full((1, 40, 60), 2.0), render=image)
    settings = {"depth": "exact", "match_colour": False}
    unchecked = Reprojected(**settings, photo_consistency=None)(target, [reference], 1)
    checked = Reprojected(**settings)(target, [reference], 1)
    assert bool((unchecked.visibility > 0.9).all())
    assert not bool(checked.visibility[0, :, 12:28, 22:38].any())
    assert not bool(checked.references[0, :, 12:28, 22:38].any())
    assert not bool(checked.renders[0, :, 12:28, 22:38].any())
    torch.testing.assert_close(checked.visibility[0, :, :5], unchecked.visibility[0, :, :5])


def test_what_only_one_of_three_references_shows_is_no_reference_there():
    image = torch.rand(3, 40, 60, generator=torch.Generator().manual_seed(0)) * 0.4
    camera, depth = identity_camera(40, 60, 50.0), torch.full((1, 40, 60), 2.0)
    passer_by = image.clone()
    passer_by[:, 10:30, 20:40] += 0.18  # the render alone does not reject it
    target = LoadedView("t", image, camera, depth)
    references = [LoadedView(str(i), photo, camera, depth) for i, photo in enumerate((image, passer_by, image))]
    settings = {"depth": "exact", "match_colour": False}
    unchecked = Reprojected(**settings, photo_consistency=None)(target, references, 3)
    checked = Reprojected(**settings)(target, references, 3)
    assert bool((unchecked.visibility > 0.9).all())
    assert checked.names == unchecked.names
    hidden = [bool((visibility[:, 13:27, 23:37] == 0).all()) for visibility in checked.visibility]
    assert hidden == [name == "1" for name in checked.names]
    assert torch.equal(checked.visibility[..., :5], unchecked.visibility[..., :5])


@pytest.mark.parametrize("top", [0, 4])
def test_compiled_finish_of_fine_references_equals_its_readable_twin(top):
    generator = torch.Generator().manual_seed(0)
    colour, coarse = 255 * torch.rand(3, 8, 20, generator=generator), torch.rand(3, 3, 5, generator=generator)
    visibility = torch.randint(0, 2, (1, 8, 20), generator=generator).float()
    colours = torch.tensor([[1.2 / 255, -0.1], [0.8 / 255, 0.1], [1 / 255, 0.0]])
    found = _fine_rows(Warped(colour, visibility), colours, coarse, top)
    expected = _fine_rows(Warped(colour.double(), visibility.double()), colours.double(), coarse.double(), top)
    torch.testing.assert_close(found.double(), expected, rtol=0, atol=1e-6)
    assert found.shape == colour.shape
