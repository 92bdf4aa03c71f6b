import dataclasses
from collections import Counter

import pytest
import torch
import torch.nn.functional as F
from torch import nn

from gaussian_enhancer.network import ssif_sr
from gaussian_enhancer.network.deform import Deformable, Unrefined
from gaussian_enhancer.network.fuse import Mean, Trust
from gaussian_enhancer.network.halving import halve
from gaussian_enhancer.network.output_head import Gated, Residual
from gaussian_enhancer.network.ssif_sr import SSIFSR, merge_torch
from gaussian_enhancer.types import NetworkInput
from support.networks import trained, views


def fine_views(height: int = 16, width: int = 24, references: int = 2, fine: bool = True) -> NetworkInput:
    return views(height, width, references, renders=True, fine=fine)


def small(**choices: object) -> SSIFSR:
    return SSIFSR(widths=(16, 16, 24), blocks=(1, 1, 1), **choices)


def part(seen: NetworkInput, order: list[int]) -> NetworkInput:
    index = torch.tensor(order, dtype=torch.long)
    names = ("references", "visibility", "reference_renders", "fine_references")
    return dataclasses.replace(seen, **{name: getattr(seen, name)[:, index] for name in names})


@pytest.mark.parametrize("size", [(1, 1), (3, 5), (16, 24), (17, 9)])
@pytest.mark.parametrize(("references", "fine"), [(0, True), (1, True), (3, True), (2, False)])
@pytest.mark.parametrize("refine", [Unrefined(), Deformable()])
def test_untrained_network_returns_the_bicubically_enlarged_render_bit_for_bit(size, references, fine, refine):
    seen = fine_views(*size, references=references, fine=fine)
    expected = F.interpolate(seen.render, scale_factor=4, mode="bicubic", align_corners=False)
    network = SSIFSR(widths=(8, 8, 8), blocks=(1, 1, 1), refine=refine)
    assert torch.equal(network(seen), expected)
    with torch.autocast("cpu", torch.bfloat16):
        stages = network.stages(seen)
    assert torch.equal(stages[0], seen.render)
    assert torch.equal(stages[2], expected)
    assert [tuple(image.shape[-2:]) for image in stages] == [(n * size[0], n * size[1]) for n in (1, 2, 4)]


@pytest.mark.parametrize("fusion", [Trust(), Trust(pooled=True), Mean()])
@pytest.mark.parametrize("output", [Gated(), Residual()])
def test_order_of_references_changes_nothing(fusion, output):
    network, seen = trained(small, fusion=fusion, output=output), fine_views(references=3)
    torch.testing.assert_close(network(part(seen, [2, 0, 1])), network(seen), rtol=0, atol=1e-5)


def test_fine_references_reach_the_image_and_their_absence_is_no_error():
    network, seen = trained(small), fine_views()
    assert seen.fine_references is not None
    other = dataclasses.replace(seen, fine_references=seen.fine_references.flip(-1))
    one, two, bare = (
        network.stages(seen),
        network.stages(other),
        network(dataclasses.replace(seen, fine_references=None)),
    )
    assert torch.equal(one[0], two[0])
    assert (one[1] - two[1]).abs().max() > 1e-3
    assert (one[2] - two[2]).abs().max() > 1e-3
    assert bare.shape == one[2].shape
    assert bool(torch.isfinite(bare).all())


@pytest.mark.parametrize("references", [0, 2])
def test_large_images_are_finished_in_parts_with_the_same_result(references, monkeypatch: pytest.MonkeyPatch):
    network, seen = trained(small), fine_views(72, 104, references=references)
    with torch.no_grad():
        whole = network(seen)
        monkeypatch.setattr(ssif_sr, "TILE", 16)
        parts = network(seen)
        torch.testing.assert_close(parts, whole, rtol=0, atol=1e-5)
        monkeypatch.setattr(ssif_sr, "MARGIN", -3)  # what is left of the halo is too narrow
        assert (network(seen) - whole).abs().max() > 1e-4


def test_features_are_computed_once_for_all_scales_and_known_ones_are_not_computed_again():
    network, seen, calls = trained(small), fine_views(), Counter()
    parts: dict[str, nn.Module] = {
        "render": network.gather.encode_render,
        "reference": network.gather.encode_reference,
        "fine": network.middle.encode_reference,
        "fuse": network.gather.fuse,
    }
    for name, module in parts.items():
        module.register_forward_hook(lambda *_, name=name: calls.update([name]))
    whole = network.stages(seen)
    assert calls == {"render": 1, "reference": 1, "fine": 1, "fuse": 1}
    known = network.encode(seen)
    calls.clear()
    again = network.stages(seen, known)
    assert calls == {"render": 1, "fuse": 1}
    for one, other in zip(whole, again, strict=True):
        torch.testing.assert_close(one, other)


def test_detail_that_is_handed_on_knows_no_exposure_and_no_smooth_part():
    generator = torch.Generator().manual_seed(0)
    fine = torch.rand(1, 2, 3, 32, 32, generator=generator)
    trust = torch.tensor([0.3, 0.1]).view(1, 2, 1, 1, 1).expand(1, 2, 1, 16, 16)

    def detail(photos: torch.Tensor) -> torch.Tensor:
        one, _ = merge_torch(torch.zeros(1, 3, 32, 32), photos, halve(photos), torch.ones_like(trust), trust)
        assert one.reference_renders is not None
        return (one.references - one.reference_renders)[0, 0]

    assert detail(fine).abs().mean() > 0.05
    brighter = fine + torch.tensor([0.3, -0.2]).view(1, 2, 1, 1, 1)
    torch.testing.assert_close(detail(brighter), detail(fine), rtol=0, atol=1e-5)
    ramp = torch.linspace(0, 1, 32).expand(1, 2, 3, 32, 32)
    assert detail(ramp)[..., 2:-2].abs().max() < 1e-5


def test_one_merged_reference_is_their_mean_by_trust():
    photos, halved = torch.rand(1, 2, 3, 8, 8), torch.rand(1, 2, 3, 4, 4)
    trust = torch.tensor([0.3, 0.1]).view(1, 2, 1, 1, 1).expand(1, 2, 1, 4, 4)
    one, together = merge_torch(torch.zeros(1, 3, 8, 8), photos, halved, torch.ones(1, 2, 1, 4, 4), trust)
    torch.testing.assert_close(one.references[:, 0], 0.75 * photos[:, 0] + 0.25 * photos[:, 1])
    torch.testing.assert_close(together, torch.full((1, 1, 1, 4, 4), 0.4))


def test_a_shift_of_everything_shifts_the_image():
    network, seen = trained(small), fine_views(104, 112)
    with torch.no_grad():
        moved = network(seen.map_images(lambda image, n: image.roll((8 * n, 8 * n), (-2, -1))))
        still = network(seen).roll((32, 32), (-2, -1))
    inner = (..., slice(4 * 48, -4 * 40), slice(4 * 48, -4 * 40))
    torch.testing.assert_close(moved[inner], still[inner], rtol=0, atol=1e-4)
    assert (moved - network(seen)).detach()[inner].abs().max() > 0.1
