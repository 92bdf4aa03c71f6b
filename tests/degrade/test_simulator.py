import pytest
import torch

from gaussian_enhancer.degrade.artefact_types import TYPES
from gaussian_enhancer.degrade.artefacts.rng import spawn
from gaussian_enhancer.degrade.artefacts.view import View
from gaussian_enhancer.degrade.gates.gate import AllGate, NoGate, RandomGate
from gaussian_enhancer.degrade.manual import degrade
from gaussian_enhancer.degrade.simulator import Simulator
from gaussian_enhancer.errors import InputError

LIGHT = {name: name in ("blur", "noise", "cloudy", "floater") for name in TYPES}


def photo(count=3, size=(32, 40)):
    generator = torch.Generator().manual_seed(0)
    smooth = torch.nn.functional.interpolate(torch.rand(count, 3, 6, 8, generator=generator), size, mode="bicubic")
    depth = 1 + torch.rand(count, 1, *size, generator=generator)
    return View(smooth.clamp(0, 1), depth, torch.ones(count, 1, *size))


def seeded(seed):
    return torch.Generator().manual_seed(seed)


def simulator(second=None):
    return Simulator(RandomGate(LIGHT, chance=0.8), second)


def test_no_gate_returns_the_photo_to_8_bits():
    view = photo()
    done = Simulator(NoGate())(view, seeded(1))
    torch.testing.assert_close(done.image, view.image, atol=0.5 / 255 + 1e-6, rtol=0)
    torch.testing.assert_close(done.image * 255, (done.image * 255).round(), atol=1e-4, rtol=0)
    assert torch.equal(done.depth, view.depth)
    assert torch.equal(done.alpha, view.alpha)


def test_a_seed_repeats_and_another_does_not():
    view = photo()
    one, again, other = (simulator()(view, seeded(seed)).image for seed in (1, 1, 2))
    assert torch.equal(one, again)
    assert (one - other).abs().max() > 0.02


def test_a_batch_is_its_samples_one_by_one():
    view = photo(4)
    together = simulator()(view, spawn(4, seeded(3)))
    for i, generator in enumerate(spawn(4, seeded(3))):
        alone = simulator()(view[torch.tensor([i])], [generator])
        # One 8-bit step: sums in another order may round the other way.
        torch.testing.assert_close(together.image[i], alone.image[0], atol=1.01 / 255, rtol=0)
        torch.testing.assert_close(together.depth[i], alone.depth[0])
        torch.testing.assert_close(together.alpha[i], alone.alpha[0])


def test_the_second_stage_gets_the_first_ones_output_and_has_the_last_word():
    view, seen = photo(), []

    def second(manual, generators, real=None):
        seen.append((manual, real))
        return View(manual.image + 2, manual.depth, manual.alpha)

    real = torch.rand(3, 3, 32, 40)
    done = simulator(second)(view, spawn(3, seeded(4)), real)
    generators = spawn(3, seeded(4))
    steps = [simulator().gate.draw(one) for one in generators]
    assert torch.equal(seen[0][0].image, degrade(view, steps, generators).image)
    assert seen[0][1] is real
    assert torch.equal(done.image, torch.ones_like(done.image))


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_half_precision_is_simulated_in_single(dtype):
    """Case constant_simulated: it was an error about types of matrices, and autocast rounded what artefacts drew."""
    half = photo().to(dtype)
    done = Simulator(AllGate())(half, seeded(1))
    assert done.image.dtype == torch.float32
    expected = Simulator(AllGate())(half.to(torch.float32), seeded(1))
    assert torch.equal(done.image, expected.image)
    with torch.autocast("cpu", dtype):
        assert torch.equal(Simulator(AllGate())(half.to(torch.float32), seeded(1)).image, expected.image)


def test_a_photo_that_is_not_finite_is_refused():
    view = photo()
    view.image[1, 0, 3, 3] = float("nan")
    with pytest.raises(InputError, match="photo: has colours that are not finite"):
        simulator()(view, seeded(1))
