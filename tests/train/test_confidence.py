"""Training of a change confidence: what its blocks say, and that it learns from them."""

import torch

from gaussian_enhancer.align.exposure import apply_colour, fit_colour
from gaussian_enhancer.align.references import Pool, ReferenceConfig, join, read_target
from gaussian_enhancer.infer.change_confidence import BLOCK, INPUTS, ChangeConfidence, split_change
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.network.sif import SIF
from gaussian_enhancer.scene.renders import read_run, run_steps
from gaussian_enhancer.train.confidence import JudgedView, judged_views, train_confidence


def changing() -> SetEnhancer:
    torch.manual_seed(0)
    network = SIF((8, 8, 8), (1, 1, 1))
    for value in network.parameters():
        torch.nn.init.normal_(value, std=0.1)
    return SetEnhancer(network, ReferenceConfig(), precision="float32")


def test_blocks_tell_the_error_that_every_share_leaves(plane_run):
    enhancer = changing()
    rendered = read_run(plane_run, run_steps(plane_run)[0])
    view = rendered.targets[0]
    target, photo = read_target(view), view.read_photo()
    aligned = enhancer.reference_config.align(target, view, Pool(rendered.references))
    enhanced = enhancer.enhance(join(target, aligned))[0]
    truth = apply_colour(photo, fit_colour(photo, target.image, torch.ones_like(photo[:1])))
    found = next(judged_views(plane_run, enhancer))
    height, width = (-(-side // BLOCK) for side in target.image.shape[-2:])
    assert found.features.shape == (height * width, INPUTS)
    assert target.image.shape[-2] % BLOCK == target.image.shape[-1] % BLOCK == 0
    means, details = split_change(enhanced[None] - target.image)
    for shares in ((0.3, 0.3), (1.0, 1.0), (0.2, 0.9)):
        applied = target.image + shares[0] * means[0] + shares[1] * details[0]
        left, raw = ((image - truth).square().mean() for image in (applied, target.image))
        told = 1 + found.added(torch.tensor(shares).expand(len(found.helpful), 2)).mean()
        torch.testing.assert_close(told, left / raw, rtol=1e-4, atol=1e-5)


def test_a_view_comes_overfitted_without_renders_and_where_it_has_more_than_two_references_with_fewer_as_well(
    plane_run,
):
    rendered = read_run(plane_run)
    expected = 5 * len(rendered.targets) * len(run_steps(plane_run))
    assert len(list(judged_views(plane_run, changing()))) == expected


def judged(confidence: ChangeConfidence, features: torch.Tensor) -> torch.Tensor:
    with torch.no_grad():
        return confidence.judge(features.T[None, :, None])[0, :, 0].T


def apart(features: torch.Tensor, helpful: torch.Tensor) -> JudgedView:
    """Blocks whose bands have nothing to do with each other."""
    return JudgedView(features, torch.eye(2).expand(len(features), 2, 2), helpful)


def test_it_learns_which_band_of_which_block_gains():
    torch.manual_seed(0)
    features = torch.randn(3000, INPUTS)
    good = (features[:, (5, 40)] > 0).float()
    confidence, again = (train_confidence([apart(features, good)], hidden=32, steps=400) for _ in range(2))
    shares = judged(confidence, features)
    assert torch.equal(shares, judged(again, features))
    for band, feature in enumerate((5, 40)):
        clear = features[:, feature].abs() > 0.5
        assert float(shares[clear & (good[:, band] > 0), band].mean()) > 0.8
        assert float(shares[clear & (good[:, band] == 0), band].mean()) < 0.15


def test_harm_that_counts_more_makes_it_hold_back():
    features = torch.randn(3000, INPUTS, generator=torch.Generator().manual_seed(0))
    helpful = torch.randn(3000, 2, generator=torch.Generator().manual_seed(1)) + 0.7

    def mean(harm: float) -> float:
        confidence = train_confidence([apart(features, helpful)], hidden=8, steps=200, harm=harm)
        return float(judged(confidence, features).mean())

    assert mean(0.0) - mean(3.0) > 0.1
