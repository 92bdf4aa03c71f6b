"""Training of a change confidence: what its blocks say, and that it learns from them."""

import torch

from gaussian_enhancer.align.exposure import apply_colour, fit_colour
from gaussian_enhancer.align.references import ReferenceConfig, ReferencePool, build_network_input, read_target
from gaussian_enhancer.infer.change_confidence import BLOCK, INPUTS, ChangeConfidence, split_change
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.network.sif import SIF
from gaussian_enhancer.scene.renders import read_run, run_steps
from gaussian_enhancer.train.confidence import ViewBlocks, measure_views, train_confidence


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
    aligned = enhancer.reference_config.align(target, view, ReferencePool(rendered.references))
    enhanced = enhancer.enhance(build_network_input(target, aligned))[0]
    truth = apply_colour(photo, fit_colour(photo, target.image, torch.ones_like(photo[:1])))
    found = next(measure_views(plane_run, enhancer))
    height, width = (-(-side // BLOCK) for side in target.image.shape[-2:])
    assert found.features.shape == (height * width, INPUTS)
    assert target.image.shape[-2] % BLOCK == target.image.shape[-1] % BLOCK == 0
    blocks = torch.nn.functional.avg_pool2d((truth - target.image).square().mean(0)[None], BLOCK).flatten()
    torch.testing.assert_close(found.error, blocks / blocks.mean(), rtol=1e-3, atol=1e-4)
    means, details = split_change(enhanced[None] - target.image)
    for shares in ((0.3, 0.3), (1.0, 1.0), (0.2, 0.9)):
        applied = target.image + shares[0] * means[0] + shares[1] * details[0]
        left, raw = ((image - truth).square().mean() for image in (applied, target.image))
        told = 1 + found.added_error(torch.tensor(shares).expand(len(found.helpful), 2)).mean()
        torch.testing.assert_close(told, left / raw, rtol=1e-4, atol=1e-5)


def test_a_view_comes_overfitted_without_renders_and_where_it_has_more_than_two_references_with_fewer_as_well(
    plane_run,
):
    rendered = read_run(plane_run)
    expected = 5 * len(rendered.targets) * len(run_steps(plane_run))
    assert len(list(measure_views(plane_run, changing()))) == expected


def judged(confidence: ChangeConfidence, features: torch.Tensor) -> torch.Tensor:
    with torch.no_grad():
        return confidence.predict_shares(features.T[None, :, None])[0, :, 0].T


def apart(features: torch.Tensor, helpful: torch.Tensor) -> ViewBlocks:
    """Blocks whose bands have nothing to do with each other."""
    return ViewBlocks(features, torch.eye(2).expand(len(features), 2, 2), helpful, torch.ones(len(features)))


def test_it_learns_which_band_of_which_block_gains():
    torch.manual_seed(0)
    features = torch.randn(3000, INPUTS)
    good = (features[:, (5, 40)] > 0).float()
    confidence, again = (
        train_confidence([[apart(features, good)]], hidden=32, steps=400, block_harm=0.0) for _ in range(2)
    )
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
        confidence = train_confidence([[apart(features, helpful)]], hidden=8, steps=200, harm=harm, block_harm=0.0)
        return float(judged(confidence, features).mean())

    assert mean(0.0) - mean(3.0) > 0.1


def test_a_block_loses_decibels_of_its_own_error():
    error = torch.tensor([1.0, 0.1, 0.1, 0.01])
    view = ViewBlocks(torch.zeros(4, INPUTS), torch.zeros(4, 2, 2), torch.zeros(4, 2), error)
    lost = view.lost_decibels(torch.tensor([0.1, 0.1, -0.05, 0.1]))
    torch.testing.assert_close(lost, torch.tensor([0.4139, 3.0, 0.0, 3.0]), atol=1e-3, rtol=0)


def test_decibels_of_blocks_make_it_hold_back_where_the_render_is_nearly_right():
    draw = torch.Generator().manual_seed(0)
    features = torch.randn(4000, INPUTS, generator=draw)
    right = features[:, 7] > 0
    helpful = 0.7 + 0.8 * torch.randn(4000, 2, generator=draw)
    error = torch.where(right, 0.1, 10.0)
    view = ViewBlocks(features, torch.eye(2).expand(4000, 2, 2), helpful, error)
    shares = [
        judged(train_confidence([[view]], hidden=16, steps=300, harm=0.0, block_harm=price), features).mean(1)
        for price in (0.0, 1.0)
    ]
    assert abs(float(shares[0][right].mean() - shares[0][~right].mean())) < 0.1
    assert float(shares[0][right].mean() - shares[1][right].mean()) > 0.1
    assert abs(float(shares[0][~right].mean() - shares[1][~right].mean())) < 0.1


def test_a_fit_of_many_views_counts_as_much_as_one_of_few():
    features = torch.randn(500, INPUTS, generator=torch.Generator().manual_seed(0))
    gains, loses = apart(features, torch.ones(500, 2)), apart(features, torch.zeros(500, 2))

    def mean(fits: list[list[ViewBlocks]]) -> float:
        return float(judged(train_confidence(fits, 8, 300, harm=0.0, block_harm=0.0), features).mean())

    assert abs(mean([[gains] * 9, [loses]]) - 0.5) < 0.1
    assert abs(mean([[gains] * 9 + [loses]]) - 0.9) < 0.1
