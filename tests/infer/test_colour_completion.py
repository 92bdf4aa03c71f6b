"""The smooth change of colour is carried on to where no reference sees."""

import pytest
import torch

from gaussian_enhancer.infer.colour_completion import complete_change, complete_compiled, complete_torch
from gaussian_enhancer.types import NetworkInput

HEIGHT, WIDTH = 60, 80


def noise(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed))


def views(render: torch.Tensor, seen: torch.Tensor, alpha: torch.Tensor | None = None) -> NetworkInput:
    return NetworkInput(render, torch.zeros_like(render)[:, None], seen[:, None], alpha=alpha)


def left_half(batch: int = 1) -> torch.Tensor:
    seen = torch.zeros(batch, 1, HEIGHT, WIDTH)
    seen[..., : WIDTH // 2] = 1
    return seen


def hazy(batch: int = 1) -> tuple[torch.Tensor, torch.Tensor]:
    """A scene under haze, and the scene."""
    scene = torch.nn.functional.interpolate(noise(batch, 3, 6, 8), (HEIGHT, WIDTH), mode="bicubic").clamp(0, 1)
    return 0.6 * scene + 0.3, scene


def error(image: torch.Tensor, scene: torch.Tensor) -> float:
    return float((image - scene)[..., 3 * WIDTH // 4 :].square().mean())


def test_haze_that_is_removed_in_one_half_is_removed_in_the_other() -> None:
    render, scene = hazy()
    seen = left_half()
    enhanced = torch.where(seen > 0, scene, render)
    completed = complete_change(enhanced, views(render, seen))
    assert error(completed, scene) < 0.05 * error(enhanced, scene)


def test_what_references_see_stays_as_the_network_made_it() -> None:
    render, scene = hazy()
    seen = left_half()
    enhanced = torch.where(seen > 0, scene, render)
    completed = complete_change(enhanced, views(render, seen))
    assert torch.allclose(completed[..., : WIDTH // 3], enhanced[..., : WIDTH // 3], atol=1e-3)


def test_detail_that_the_network_added_where_nothing_is_seen_is_kept() -> None:
    render, scene = hazy()
    seen = left_half()
    enhanced = torch.where(seen > 0, scene, render)
    pattern = 0.1 * (torch.arange(WIDTH) % 2 - 0.5).expand(1, 3, HEIGHT, WIDTH)
    one, other = (complete_change(image, views(render, seen)) for image in (enhanced, enhanced + pattern))
    assert torch.allclose((other - one)[..., 3 * WIDTH // 4 : -4], pattern[..., 3 * WIDTH // 4 : -4], atol=0.01)


@pytest.mark.parametrize("references", [0, 1])
def test_without_a_visible_reference_nothing_changes(references: int) -> None:
    render, enhanced = noise(1, 3, HEIGHT, WIDTH), noise(1, 3, HEIGHT, WIDTH, seed=1)
    shape = (1, references)
    unseen = NetworkInput(render, torch.zeros(*shape, 3, HEIGHT, WIDTH), torch.zeros(*shape, 1, HEIGHT, WIDTH))
    assert torch.equal(complete_change(enhanced, unseen), enhanced)


def test_background_that_no_gaussian_covers_keeps_its_colour() -> None:
    render, scene = hazy()
    seen, alpha = left_half(), torch.ones(1, 1, HEIGHT, WIDTH)
    alpha[..., 3 * WIDTH // 4 :] = 0
    enhanced = torch.where(seen > 0, scene, render)
    completed = complete_change(enhanced, views(render, seen, alpha))
    assert torch.equal(completed[..., 3 * WIDTH // 4 :], enhanced[..., 3 * WIDTH // 4 :])


def test_images_of_a_batch_do_not_mix() -> None:
    render, scene = hazy(2)
    seen = left_half(2)
    seen[1] = 0
    enhanced = torch.where(left_half(2) > 0, scene, render)
    both = complete_change(enhanced, views(render, seen))
    assert torch.allclose(both[:1], complete_change(enhanced[:1], views(render[:1], seen[:1])), atol=1e-5)
    assert torch.allclose(both[1:], enhanced[1:], atol=1e-5)


@pytest.mark.parametrize(("height", "width"), [(1, 1), (2, 7), (300, 17), (501, 400)])
def test_any_size_stays_finite(height: int, width: int) -> None:
    render, enhanced = noise(1, 3, height, width), noise(1, 3, height, width, seed=1)
    seen = (noise(1, 1, height, width, seed=2) > 0.5).float()
    seen[..., 0, 0] = 1
    completed = complete_change(enhanced, views(render, seen))
    assert completed.shape == enhanced.shape
    assert bool(completed.isfinite().all())
    assert float((completed - enhanced).abs().max()) < 2


@pytest.mark.parametrize(("size", "cells"), [((31, 45), (7, 10)), ((4, 6), (4, 6)), ((9, 5), (1, 1))])
def test_the_compiled_kernel_equals_its_readable_twin(size: tuple[int, int], cells: tuple[int, int]):
    given = torch.rand(2, 3, *size), torch.rand(2, 3, *size), torch.rand(2, 1, *size), torch.rand(2, 13, *cells) - 0.5
    torch.testing.assert_close(complete_compiled(*given), complete_torch(*given), rtol=0, atol=1e-5)
