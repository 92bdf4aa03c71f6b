"""A change confidence holds back what the references do not support."""

from dataclasses import replace

import pytest
import torch
from test_cascade import SMALL

from gaussian_enhancer.align.alignment import Reprojected
from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer import change_confidence
from gaussian_enhancer.infer.change_confidence import (
    BLOCK,
    FEATURES,
    INPUTS,
    STEP,
    ChangeConfidence,
    apply_shares_compiled,
    apply_shares_torch,
    block_features,
    block_products,
    split_change,
)
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.infer.options import EnhancementOptions
from gaussian_enhancer.infer.super_resolution import limit_finer_scales
from gaussian_enhancer.infer.weights import Pretrained, load_weights, save_weights
from gaussian_enhancer.network.cascade import Cascade
from gaussian_enhancer.network.colour_clamping import clamp_to_references
from gaussian_enhancer.network.pyramid import upsample_bicubic
from gaussian_enhancer.network.sif import SIF
from gaussian_enhancer.network.ssif_lr import SSIFLR
from gaussian_enhancer.network.ssif_sr import SSIFSR
from gaussian_enhancer.types import NetworkInput
from support.networks import trained


def views(height: int = 40, width: int = 52, references: int = 3, renders: bool = True) -> NetworkInput:
    draw = torch.Generator().manual_seed(0)
    render = torch.rand(1, 3, height, width, generator=draw)
    photos = (render[:, None] + 0.1 * torch.randn(1, references, 3, height, width, generator=draw)).clamp(0, 1)
    visibility = (torch.rand(1, references, 1, height, width, generator=draw) > 0.3).float()
    own = (photos - 0.05).clamp(0, 1) if renders else None
    return NetworkInput(render, photos * visibility, visibility, reference_renders=own)


def judging(*shares: float) -> ChangeConfidence:
    """Gives the same shares everywhere: of means and of details, or one for both."""
    confidence = ChangeConfidence(8)
    torch.nn.init.zeros_(confidence.layers[-1].weight)
    confidence.layers[-1].bias.data[:] = torch.tensor(shares)
    return confidence.eval()


def by_hand(enhanced: torch.Tensor, seen: NetworkInput, y: int, x: int) -> torch.Tensor:
    """Features of one block in double precision, pixel by pixel as the docstrings have them."""

    def cut(image: torch.Tensor) -> torch.Tensor:
        return image[..., y : y + BLOCK : STEP, x : x + BLOCK : STEP].double()

    def mean(image: torch.Tensor) -> torch.Tensor:
        return image.mean((1, 2), keepdim=True).expand_as(image)

    def detail(image: torch.Tensor) -> torch.Tensor:
        return image - mean(image)

    render, image = cut(seen.render)[0], cut(enhanced)[0]
    change = image - render
    energy = mean(change).square().mean()
    values = [change.mean().abs(), energy / (change.square().mean() + 1e-6), detail(render).square().mean().sqrt()]
    parts = [torch.stack(values)]
    masks = [(cut(v) > 0).double() for v in seen.visibility[0]]
    apart = [(cut(p) - render) * m for p, m in zip(seen.references[0], masks, strict=True)]
    own = [(cut(p) - cut(r)) * m for p, r, m in zip(seen.references[0], seen.reference_renders[0], masks, strict=True)]
    for band in (mean, detail):
        parts.append(band(change).square().mean().sqrt()[None])
        single, pairs = [], []
        for i, (mask, difference, splats) in enumerate(zip(masks, apart, own, strict=True)):
            c, d, s, area = band(change * mask), band(difference), band(splats), mask.mean()
            mine = c.square().mean() + 1e-6
            roots = [(one.square().mean() / area).sqrt() for one in (d, d - c, s, d - s)]
            single.append(torch.stack([(c * d).mean() / mine, (c * s).mean() / mine, *roots, area]))
            for j in range(i):
                e = band(apart[j])
                both, lengths = (d * e).mean(), d.square().mean() * e.square().mean()
                pairs.append(torch.stack([(d - e).square().mean().sqrt(), both, both / (lengths.sqrt() + 1e-6)]))
        for group in (single, pairs):
            stacked = torch.stack(group)
            parts += [stacked.mean(0), stacked.amin(0), stacked.amax(0)]
    features = torch.cat(parts)
    return features.sign() * torch.log1p(20 * features.abs())


def test_features_are_those_of_a_block_worked_out_by_hand():
    seen = views()
    enhanced = (seen.render + 0.1).clamp(0, 1)
    features = block_features(enhanced, seen)
    assert features.shape == (1, INPUTS, 5, 7)
    for i, j in ((0, 0), (2, 3), (4, 5)):
        torch.testing.assert_close(
            features[0, :FEATURES, i, j].double(), by_hand(enhanced, seen, 8 * i, 8 * j), rtol=1e-4, atol=1e-4
        )


def test_large_images_are_worked_on_in_strips_with_the_same_result(monkeypatch: pytest.MonkeyPatch):
    seen = views(70, 52)
    enhanced = (seen.render + 0.1).clamp(0, 1)
    whole = block_products(enhanced, seen)
    monkeypatch.setattr(change_confidence, "STRIP", 2)
    torch.testing.assert_close(block_products(enhanced, seen), whole)


@pytest.mark.parametrize("references", [0, 1, 3])
@pytest.mark.parametrize("renders", [True, False])
def test_the_compiled_kernel_equals_its_readable_twin(references: int, renders: bool):
    seen = views(45, 52, references=references, renders=renders and references > 0)
    enhanced = (seen.render + 0.1).clamp(0, 1)
    pairs = zip(change_confidence.products_compiled(enhanced, seen), block_products(enhanced, seen), strict=True)
    for found, expected in pairs:
        torch.testing.assert_close(found, expected, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("size", [(1, 1), (45, 52), (64, 40)])
def test_compiled_shares_equal_their_readable_twin(size: tuple[int, int]):
    draw = torch.Generator().manual_seed(0)
    enhanced, render = torch.rand(2, 2, 3, *size, generator=draw)
    shares = torch.rand(2, 2, *(-(-side // BLOCK) for side in size), generator=draw)
    expected = apply_shares_torch(enhanced.double(), render.double(), shares.double())
    torch.testing.assert_close(apply_shares_torch(enhanced, render, shares).double(), expected, rtol=0, atol=1e-6)
    torch.testing.assert_close(apply_shares_compiled(enhanced, render, shares).double(), expected, rtol=0, atol=1e-6)


@pytest.mark.parametrize("references", [0, 1, 8])
@pytest.mark.parametrize("renders", [True, False])
def test_any_number_of_references_gives_a_finite_image(references: int, renders: bool):
    seen = views(references=references, renders=renders and references > 0)
    torch.manual_seed(0)
    image = ChangeConfidence(8).eval()((seen.render + 0.2).clamp(0, 1), seen)
    assert image.shape == seen.render.shape
    assert bool(torch.isfinite(image).all())
    assert 0 <= float(image.min()) <= float(image.max()) <= 1


def test_the_bands_are_the_change():
    change = views(43, 52).references[:, 0] - 0.5
    means, details = split_change(change)
    torch.testing.assert_close(means + details, change)
    smooth = torch.linspace(0, 1, 52).expand(1, 3, 48, 52)  # a ramp is all mean, but where blocks' centres end
    assert float(split_change(smooth)[1][..., 4:44].abs().max()) < 1e-5
    checked = (torch.arange(48)[:, None] + torch.arange(56)) % 2 - 0.5
    assert float(split_change(checked.expand(1, 3, 48, 56))[0].abs().max()) < 1e-6


def test_means_and_details_have_shares_of_their_own():
    seen = views()
    enhanced = (seen.render + 0.3).clamp(0, 1)
    means, details = split_change(enhanced - seen.render)
    for shares, expected in (((1.0, 0.0), seen.render + means), ((0.0, 1.0), seen.render + details)):
        torch.testing.assert_close(judging(*shares)(enhanced, seen), expected.clamp(0, 1))


def test_nothing_changed_and_nothing_seen_is_finite():
    seen = views()
    seen = replace(seen, visibility=torch.zeros_like(seen.visibility), references=torch.zeros_like(seen.references))
    assert bool(torch.isfinite(block_features(seen.render, seen)).all())


@pytest.mark.parametrize("share", [0.0, 0.25, 1.0])
def test_the_enhancer_applies_the_share(share: float):
    options = {"precision": "float32", "colour_clamping": 3, "colour_completion": False}
    seen, network = views(), trained()
    whole = SetEnhancer(network, ReferenceConfig(Reprojected()), **options).enhance(seen)
    some = SetEnhancer(network, ReferenceConfig(Reprojected()), confidence=judging(share), **options).enhance(seen)
    assert float((whole - seen.render).abs().max()) > 0.01
    torch.testing.assert_close(some, seen.render + share * (whole - seen.render), rtol=0, atol=2e-6)


def test_super_resolution_limits_the_change_before_the_finer_scales():
    """The second network sees the limited image of the first, and its own change is applied where a reference shows."""
    seen = replace(views(32, 48), fine_references=torch.rand(1, 3, 3, 128, 192))
    cascade = Cascade(trained(SSIFLR, **SMALL), trained(SSIFSR, **SMALL))
    options = {"precision": "float32", "colour_completion": False}

    def enhanced(confidence: ChangeConfidence | None) -> torch.Tensor:
        return SetEnhancer(cascade, ReferenceConfig(Reprojected()), confidence=confidence, **options).enhance(seen)

    with torch.inference_mode():
        first = clamp_to_references(cascade.first(replace(seen, fine_references=None)), seen, 3)
        means, details = split_change(first - seen.render)
        for shares in ((1.0, 1.0), (0.5, 0.25), (1.0, 0.0)):
            image = (seen.render + shares[0] * means + shares[1] * details).clamp(0, 1)
            finer = limit_finer_scales(cascade.second(replace(seen, render=image)), image, seen)
            torch.testing.assert_close(enhanced(judging(*shares)), finer.clamp(0, 1), rtol=0, atol=1e-5)
            assert float((finer - upsample_bicubic(image, 4)).abs().max()) > 0.01
        finer = limit_finer_scales(cascade.second(replace(seen, render=first)), first, seen)
    torch.testing.assert_close(enhanced(None), finer.clamp(0, 1), rtol=0, atol=1e-5)


def test_weights_keep_their_confidence(tmp_path):
    network, confidence = trained(), judging(0.5)
    torch.nn.init.normal_(confidence.scale)
    save_weights(tmp_path / "a.safetensors", network, ReferenceConfig(), {"name": "a"}, confidence)
    found = load_weights(tmp_path / "a.safetensors")
    assert found.confidence is not None
    for name, value in confidence.state_dict().items():
        assert torch.equal(found.confidence.state_dict()[name], value.half().float()), name
    save_weights(tmp_path / "b.safetensors", network, ReferenceConfig(), {"name": "a"})
    assert load_weights(tmp_path / "b.safetensors").confidence is None


def test_a_confidence_of_another_width_than_its_values_is_refused(tmp_path):
    confidence = judging(0.5)
    confidence.hidden = 1000
    save_weights(tmp_path / "a.safetensors", trained(), ReferenceConfig(), {}, confidence)
    with pytest.raises(InputError, match="does not fit its own design"):
        load_weights(tmp_path / "a.safetensors")


def test_strength_of_the_card_is_for_use_without_confidence():
    pretrained = Pretrained(SIF((8, 8), (1, 1)), ReferenceConfig(), {"strength": 0.75}, judging(0.5))

    def made(**options: float | bool) -> tuple[float, bool]:
        enhancer = EnhancementOptions(**options).enhancer(pretrained, pretrained.reference_config)
        return enhancer.strength, enhancer.confidence is not None

    assert made() == (1.0, True)
    assert made(confidence=False) == (0.75, False)
    assert made(strength=0.5) == (0.5, True)
