import pytest
import torch

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.network.colour_clamping import clamp_to_references, clamp_torch
from gaussian_enhancer.types import NetworkInput


def noise(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed))


def test_colours_within_reach_stay_and_others_go_to_the_nearest() -> None:
    render, photo = torch.full((1, 3, 4, 4), 0.5), torch.full((1, 1, 3, 4, 4), 0.8)
    seen = NetworkInput(render, photo, torch.ones(1, 1, 1, 4, 4))
    values = {0.5: 0.5, 0.65: 0.65, 0.8: 0.8, 0.2: 0.5, 1.0: 0.8}
    for value, kept in values.items():
        assert torch.equal(clamp_to_references(torch.full_like(render, value), seen), torch.full_like(render, kept))


def test_pixels_that_no_reference_shows_are_not_clamped_to_the_render() -> None:
    render, photo = torch.full((2, 3, 4, 8), 0.5), torch.full((2, 1, 3, 4, 8), 0.8)
    visibility = torch.zeros(2, 1, 1, 4, 8)
    visibility[0, ..., 6:] = 1
    image = torch.full_like(render, 1.25)
    clamped = clamp_to_references(image, NetworkInput(render, photo, visibility))
    assert bool((clamped[0, :, :, 6:] == 0.8).all())
    assert bool((clamped[0, :, :, :6] == 1).all())
    assert bool((clamped[1] == 1).all())
    without = NetworkInput(render, photo[:, :0], visibility[:, :0])
    assert bool((clamp_to_references(image, without) == 1).all())


def test_on_request_pixels_that_no_reference_shows_are_clamped_to_the_render() -> None:
    render, photo = torch.full((2, 3, 4, 8), 0.5), torch.full((2, 1, 3, 4, 8), 0.8)
    visibility = torch.zeros(2, 1, 1, 4, 8)
    visibility[0, ..., 6:] = 1
    image, seen = torch.ones_like(render), NetworkInput(render, photo, visibility)
    clamped = clamp_to_references(image, seen, clamp_unseen=True)
    assert torch.equal(clamped[0, :, :, :5], render[0, :, :, :5])
    assert bool((clamped[0, :, :, 5:] == 0.8).all())
    assert bool((clamped[1] == 1).all())  # no reference is visible in it
    assert torch.equal(clamp_torch(image, seen, 1, clamp_unseen=True), clamped)


@pytest.mark.parametrize("window", [1, 3, 5, 9])
@pytest.mark.parametrize(("height", "width"), [(1, 1), (2, 7), (9, 6)])
def test_limits_are_those_of_the_window(window: int, height: int, width: int) -> None:
    render, photos = noise(2, 3, height, width), noise(2, 3, 3, height, width, seed=1)
    visibility = (noise(2, 3, 1, height, width, seed=2) - 0.4).clamp(0)
    image, reach = noise(2, 3, height, width, seed=3), window // 2
    found = clamp_to_references(image, NetworkInput(render, photos, visibility), window)
    for b in range(2):
        for y in range(height):
            for x in range(width):
                place = (slice(max(0, y - reach), y + reach + 1), slice(max(0, x - reach), x + reach + 1))
                shown = [render[(b, slice(None), *place)].flatten(1)]
                for i in range(3):
                    here = visibility[(b, i, 0, *place)] > 0
                    shown.append(photos[(b, i, slice(None), *place)][:, here])
                colours = torch.cat(shown, dim=1)
                expected = image[b, :, y, x]
                if bool((visibility[b, :, 0, y, x] > 0).any()):
                    expected = expected.clamp(colours.amin(1), colours.amax(1))
                assert torch.equal(found[b, :, y, x], expected)
    twin = clamp_to_references(image.double(), NetworkInput(render, photos, visibility), window)
    assert torch.equal(twin.float(), found)


def test_the_render_itself_is_never_changed() -> None:
    render = noise(1, 3, 8, 8)
    seen = NetworkInput(render, noise(1, 2, 3, 8, 8, seed=1), noise(1, 2, 1, 8, 8, seed=2))
    assert torch.equal(clamp_to_references(render, seen), render)


def test_order_of_references_does_not_matter() -> None:
    render, photos, visibility = noise(1, 3, 6, 6), noise(1, 3, 3, 6, 6, seed=1), noise(1, 3, 1, 6, 6, seed=2).round()
    image, order = noise(1, 3, 6, 6, seed=3), [2, 0, 1]
    one = clamp_to_references(image, NetworkInput(render, photos, visibility))
    assert torch.equal(one, clamp_to_references(image, NetworkInput(render, photos[:, order], visibility[:, order])))
    assert not torch.equal(one, image)


@pytest.mark.parametrize("window", [-1, 0, 2])
def test_windows_without_a_middle_are_refused(window: int) -> None:
    render = noise(1, 3, 4, 4)
    with pytest.raises(InputError, match="odd"):
        clamp_to_references(render, NetworkInput(render, render[:, None], torch.ones(1, 1, 1, 4, 4)), window)


def test_gradients_pass_where_the_limits_do_not_hold() -> None:
    image, render = (
        torch.tensor([0.2, 0.9]).expand(1, 3, 1, 2).clone(),
        torch.tensor([0.0, 0.5]).expand(1, 3, 1, 2).clone(),
    )
    image.requires_grad_()
    seen = NetworkInput(render.requires_grad_(), render[:, None].detach(), torch.ones(1, 1, 1, 1, 2))
    clamp_to_references(image, seen, 3).sum().backward()
    assert torch.equal(image.grad, torch.tensor([1.0, 0.0]).expand(1, 3, 1, 2))
    assert render.grad is None
