import pytest
import torch

from gaussian_enhancer.network.combine import Combination, Combined, Uncombined


def coarser(handed: int = 2) -> list[torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    return [torch.rand(1, 3 + handed, side, side, generator=generator) for side in (8, 16)]


def test_untrained_scales_leave_each_other_alone_and_still_learn():
    module = Combined(handed=2).build(16, 2)
    fine, render = torch.rand(1, 3, 32, 32), torch.rand(1, 3, 32, 32)
    assert torch.equal(module(fine, render, coarser()), fine)
    module(fine, render, coarser()).square().sum().backward()
    assert float(module.head.weight.grad.abs().sum((1, 2, 3)).min()) > 0


def test_gain_adds_the_enlarged_change_of_its_own_scale():
    module = Combination(2, 2, 8)
    values = [torch.full((1, 5, side, side), value) for side, value in ((8, 0.25), (16, 0.5))]
    fine = torch.rand(1, 3, 32, 32)
    for scale, value in enumerate((0.25, 0.5)):
        torch.nn.init.zeros_(module.head.bias)
        module.head.bias.data[12 + scale] = 2.0
        torch.testing.assert_close(module(fine, fine, values), fine + 2 * value)


def test_gain_hands_the_gradient_to_the_coarser_change():
    module = Combination(1, 0, 4)
    torch.nn.init.zeros_(module.join.weight)
    module.head.bias.data[12] = 2.0
    change = torch.rand(1, 3, 8, 8).requires_grad_()
    fine = torch.rand(1, 3, 32, 32)
    module(fine, fine, [change]).sum().backward()
    assert change.grad is not None
    torch.testing.assert_close(change.grad.sum(), torch.tensor(2.0 * 3 * 32 * 32))


def test_a_ramp_stays_a_ramp():
    """Scales are registered at pixels' outer edges: a change that is linear in x is the same line at every scale."""
    module = Combination(1, 0, 4)
    module.head.bias.data[12] = 1.0
    x = (torch.arange(16) + 0.5) / 16
    fine = torch.zeros(1, 3, 64, 64)
    combined = module(fine, fine, [x.expand(1, 3, 16, 16)])
    expected = ((torch.arange(64) + 0.5) / 64).expand_as(combined)
    torch.testing.assert_close(combined[..., 4:-4], expected[..., 4:-4])


def test_reads_everything_that_is_handed_on():
    torch.manual_seed(0)
    module = Combined(handed=2).build(16, 2)
    torch.nn.init.normal_(module.head.weight)
    values = [value.requires_grad_() for value in coarser()]
    fine, render = (torch.rand(1, 3, 32, 32).requires_grad_() for _ in range(2))
    module(fine, render, values).square().sum().backward()
    for value in (fine, render, *values):
        assert value.grad is not None
        assert float(value.grad.abs().sum((0, 2, 3)).min()) > 0


@pytest.mark.parametrize("combine", [Combined(), Uncombined()])
def test_null_version_has_the_same_signature(combine):
    fine = torch.rand(2, 3, 16, 16)
    values = [torch.rand(2, 3 + combine.handed, side, side) for side in (4, 8)]
    assert torch.equal(combine.build(8, 2)(fine, fine, values), fine)
