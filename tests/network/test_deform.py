import pytest
import torch

from gaussian_enhancer.network.deform import Deformation, deformable_sample


@pytest.mark.parametrize(("kernel", "groups", "size"), [(3, 2, (7, 9)), (1, 4, (5, 6)), (3, 1, (1, 1))])
def test_equals_torchvision(kernel, groups, size):
    ops = pytest.importorskip("torchvision.ops")
    generator = torch.Generator().manual_seed(0)

    def noise(*shape):
        return torch.randn(*shape, generator=generator, dtype=torch.float64).requires_grad_()

    taps = groups * kernel**2
    x, offset, mask = noise(2, 8, *size), noise(2, 2 * taps, *size), noise(2, taps, *size)
    weight, bias = noise(6, 8, kernel, kernel), noise(6)
    ours = deformable_sample(x, 3 * offset, mask, weight, bias)
    theirs = ops.deform_conv2d(x, 3 * offset, weight, bias, padding=kernel // 2, mask=mask)
    torch.testing.assert_close(ours, theirs)
    inputs = (x, offset, mask, weight, bias)
    for a, b in zip(
        torch.autograd.grad(ours.sin().sum(), inputs), torch.autograd.grad(theirs.sin().sum(), inputs), strict=True
    ):
        torch.testing.assert_close(a, b)


@pytest.mark.parametrize(("kernel", "width"), [(1, None), (3, None), (3, 4)])
def test_is_a_plain_convolution_at_birth_and_learns_offsets_and_masks(kernel, width):
    torch.manual_seed(0)
    module = Deformation(8, kernel=kernel, width=width)
    references, target = torch.rand(2, 3, 8, 12, 16), torch.rand(2, 8, 12, 16)
    plain = module.mix(module.narrow(references.flatten(0, 1))).unflatten(0, (2, 3))
    torch.testing.assert_close(module(references, target), plain)
    module(references, target).square().sum().backward()
    moved = module.predict.weight.grad.abs().sum((1, 2, 3))
    split = 2 * module.groups * kernel**2
    assert moved[:split].min() > 0
    assert moved[split:].min() > 0


def test_offsets_are_bounded():
    module = Deformation(4, kernel=1, groups=1, reach=2.0)
    torch.nn.init.constant_(module.predict.bias, 1e4)
    ramp = torch.arange(20.0).expand(1, 4, 20, 20)
    torch.testing.assert_close(
        module(ramp[:, None], ramp)[:, 0, :, :17, :17], 2 * (ramp + 2)[..., :17, :17] + module.mix.bias[:, None, None]
    )
