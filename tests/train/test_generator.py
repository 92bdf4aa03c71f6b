from functools import partial
from unittest import mock

import pytest
import torch

from gaussian_enhancer.degrade.generative.diffusion import Sampler
from gaussian_enhancer.degrade.generative.factors import white_noise
from gaussian_enhancer.degrade.generative.second_stage import FactorDesign, FactorModel
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.train.generator import DiffusedModule, GeneratorLoss, PairedModule
from gaussian_enhancer.types import Batch, NetworkInput

ADAM = partial(torch.optim.Adam, lr=1e-3)
PIXELS_ALONE = GeneratorLoss(pixels=10.0, texture=0.0, size=0.0, noise=0.0)


def batch(count: int = 2, side: int = 16) -> Batch:
    """Photos, M = photos, R = photos with errors of a cell's size, which a code of cells can hold."""
    generator = torch.Generator().manual_seed(0)
    photo = torch.rand(count, 3, side, side, generator=generator) * 0.6 + 0.2
    error = torch.rand(count, 3, side // 8, side // 8, generator=generator) * 0.4 - 0.2
    real = photo + torch.nn.functional.interpolate(error, scale_factor=8, mode="nearest")
    empty = torch.zeros(count, 0, 3, side, side), torch.zeros(count, 0, 1, side, side)
    return Batch(NetworkInput(photo, *empty), photo, tuple("ab"[:count]), real)


def model() -> FactorModel:
    torch.manual_seed(0)
    return FactorModel(FactorDesign(vector=4, grid=4, widths=(16, 16), code_width=16, code_blocks=1))


def quiet(module):
    module.log = module.log_dict = lambda *args, **kwargs: None
    return module


def train(module, steps: int, lr: float = 3e-3, *, new_noise: bool = False) -> list[float]:
    """Train on one batch, whose noise stays the same unless it is to be drawn anew at each step."""
    optimiser = torch.optim.Adam([p for p in module.parameters() if p.requires_grad], lr=lr)
    losses = []
    for step in range(steps):
        with mock.patch.object(type(module), "global_step", step if new_noise else 0):
            loss = module.training_step(batch(), step)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses.append(float(loss.detach()))
    return losses


def difference(made: torch.Tensor) -> float:
    return float((made - batch().real).abs().mean())


def test_paired_step_overfits_to_nearly_no_error():
    module = quiet(PairedModule(model(), PIXELS_ALONE, ADAM))
    before = difference(batch().photo)
    train(module, 400)
    manual, real, generators = module.prepare_batch(batch(), 0)
    with torch.no_grad():
        factors = module.model.extractor(manual, real)
        white_noise(factors, generators)  # as in training, so that the combiner reads the noise that it learned with
        made = module.model.combine(manual, factors, generators)
    assert difference(made) < 0.05 * before


def test_diffused_step_learns_the_codes_of_its_views():
    """With one pair a code is determined by M, so that samples come near R, and nearer with training."""
    module = quiet(PairedModule(model(), GeneratorLoss(pixels=10.0, texture=0.0, noise=0.05), ADAM))
    train(module, 300)
    second = quiet(DiffusedModule(module.model, GeneratorLoss(noise=0.05), ADAM, Sampler(4)))
    before = difference(sampled(second)), unknown(second)
    train(second, 400, new_noise=True)
    assert difference(sampled(second)) < before[0]
    assert unknown(second) < 0.5 * before[1]


def unknown(module) -> float:
    """Mean squared error of the predicted codes over many times and noises."""
    prepared = module.prepare_batch(batch(), 99)
    with torch.no_grad():
        return float(torch.stack([module._denoising_loss(*prepared) for _ in range(64)]).mean())


def sampled(module) -> torch.Tensor:
    manual, _, generators = module.prepare_batch(batch(), 0)
    with torch.no_grad():
        return module.model.combine(manual, module.model.sample(manual, Sampler(4), generators), generators)


def test_second_step_trains_the_denoiser_alone():
    module = quiet(DiffusedModule(model(), GeneratorLoss(), ADAM, Sampler(2)))
    module.training_step(batch(), 0).backward()
    assert all(p.grad is not None for p in module.model.denoiser.parameters())
    others = (*module.model.extractor.parameters(), *module.model.combiner.parameters())
    assert all(p.grad is None for p in others)


@pytest.mark.parametrize("step", ["paired", "diffused"])
def test_randomness_is_that_of_the_seed_and_the_step_alone(step):
    """A training that goes on after a kill must draw what it would have drawn."""
    made = []
    for state, at in ((1, 3), (2, 3), (1, 4)):
        networks = model()
        for parameter in networks.parameters():  # an untrained combiner returns its input
            torch.nn.init.normal_(parameter, std=0.1)
        module = PairedModule(networks, GeneratorLoss(), ADAM)
        if step == "diffused":
            module = DiffusedModule(networks, GeneratorLoss(), ADAM, Sampler(2))
        torch.manual_seed(state)
        with mock.patch.object(type(module), "global_step", at):
            made.append(float(quiet(module).training_step(batch(), 0).detach()))
    assert made[0] == made[1] != made[2]


def test_scale_follows_the_size_of_codes():
    module = quiet(PairedModule(model(), GeneratorLoss(noise=0.3), ADAM))
    manual, real, _ = module.prepare_batch(batch(), 0)
    factors = module.model.extractor(manual, real)
    for _ in range(1500):
        module._update_scale(factors)
    expected = (factors.grid.square().mean((0, 2, 3)) + 0.09).sqrt()
    torch.testing.assert_close(module.model.grid_scale.flatten(), expected, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("kind", ["paired", "diffused"])
def test_schedulers_watch_a_value_that_their_step_logs(kind):
    logged, plateau = [], partial(torch.optim.lr_scheduler.ReduceLROnPlateau, factor=0.5)
    module = quiet(
        PairedModule(model(), PIXELS_ALONE, ADAM, plateau)
        if kind == "paired"
        else DiffusedModule(model(), PIXELS_ALONE, ADAM, Sampler(steps=2), plateau)
    )
    module.log = lambda name, *args, **kwargs: logged.append(name)
    module.log_dict = lambda values, **kwargs: logged.extend(values)
    module.validation_step(batch(), 0)
    assert module.configure_optimizers()["lr_scheduler"]["monitor"] in logged


def test_batches_without_real_renders_are_refused():
    module = quiet(PairedModule(model(), GeneratorLoss(), ADAM))
    plain = Batch(batch().views, batch().photo, ("a", "b"))
    with pytest.raises(InputError, match="simulates nothing"):
        module.training_step(plain, 0)
