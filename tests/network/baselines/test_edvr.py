import pytest
import torch

from gaussian_enhancer.infer.weights import count_parameters
from gaussian_enhancer.network.baselines.edvr import EDVR, Attention, OffsetStep
from gaussian_enhancer.network.sif import SIF


def small() -> EDVR:
    torch.manual_seed(0)
    return EDVR(widths=(8, 12, 16), blocks=(1, 1, 1))


def trained() -> EDVR:
    """A network whose zero-initialised layers have been moved."""
    network = small()
    for parameter in network.parameters():
        parameter.data += 0.2 * torch.randn_like(parameter)
    return network.eval()


@pytest.mark.parametrize(
    ("widths", "blocks", "encoder_blocks"),
    [((16, 24, 32), (1, 1, 2), 1), ((32, 64, 96), (2, 2, 3), 1), ((48, 96, 144), (3, 3, 6), 2)],
)
def test_has_as_many_parameters_as_sif(widths, blocks, encoder_blocks):
    own, theirs = count_parameters(EDVR(widths, blocks)), count_parameters(SIF(widths, blocks, encoder_blocks))
    assert own == pytest.approx(theirs, rel=0.05)


def test_offsets_are_bounded_and_zero_at_birth():
    step, found = OffsetStep(8, groups=2, reach=3.0, has_coarser=False), torch.rand(1, 4, 6, 6)
    offset, mask = step.predict_offsets(found)
    assert torch.equal(offset, torch.zeros(1, 36, 6, 6))
    assert torch.equal(mask, torch.ones(1, 18, 6, 6))
    torch.nn.init.constant_(step.predict.bias, 1e4)
    offset, mask = step.predict_offsets(found)
    assert offset.max() == 3.0
    assert mask.max() == 2.0


def test_a_step_moves_features_by_its_offsets():
    step = OffsetStep(4, groups=1, reach=2.0, has_coarser=False)
    torch.nn.init.zeros_(step.mix.weight)
    step.mix.weight.data[:, :, 1, 1] = torch.eye(4)
    torch.nn.init.zeros_(step.mix.bias)
    ramp = torch.arange(12.0).expand(1, 4, 12, 12)
    torch.testing.assert_close(step(ramp, ramp, None)[1], ramp)
    step.predict.bias.data[1:18:2] = 1e4
    torch.testing.assert_close(step(ramp, ramp, None)[1][..., :10], ramp[..., :10] + 2)


def test_attention_prefers_what_is_alike_and_visible():
    attention = Attention(4)
    for embed in (attention.embed_reference, attention.embed_target):
        torch.nn.init.dirac_(embed.weight)
        torch.nn.init.zeros_(embed.bias)
    target = torch.full((1, 4, 2, 2), 10.0)
    aligned = torch.cat([target, -target])
    seen = torch.ones(2, 1, 2, 2)
    news = attention.gather(aligned, target.repeat(2, 1, 1, 1), seen, count=2)
    torch.testing.assert_close(news, target / 2)
    news = attention.gather(aligned, target.repeat(2, 1, 1, 1), torch.tensor([0.0, 1.0]).view(2, 1, 1, 1) * seen, 2)
    torch.testing.assert_close(news, torch.zeros_like(news), rtol=0, atol=1e-6)


def test_refuses_widths_that_its_groups_cannot_share():
    with pytest.raises(ValueError, match="coarsest width is 20"):
        EDVR(widths=(8, 16, 20))
