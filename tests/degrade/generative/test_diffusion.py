"""The sampler is held against a distribution whose best denoiser is known in closed form."""

import pytest
import torch

from gaussian_enhancer.degrade.generative.diffusion import CosineSchedule, Denoiser, LinearSchedule, Sampler
from gaussian_enhancer.degrade.generative.factors import Factors, white_noise
from gaussian_enhancer.errors import InputError
from support.generators import spawn_seeded

CENTRE, SPREAD, COUNT = 1.5, 0.5, 3000
SCHEDULE = CosineSchedule()


def best(noisy: Factors, time: torch.Tensor) -> Factors:
    """E[z | z_t] for z ~ N(CENTRE, SPREAD^2)."""
    a = SCHEDULE.signal(time)
    gain = a * SPREAD**2 / (a**2 * SPREAD**2 + 1 - a**2)

    def clean(part: torch.Tensor) -> torch.Tensor:
        shape = (-1, *[1] * (part.dim() - 1))
        return CENTRE + gain.view(shape) * (part - a.view(shape) * CENTRE)

    return Factors(clean(noisy.vector), clean(noisy.grid))


def sampled(sampler: Sampler) -> Factors:
    generators = spawn_seeded(COUNT)
    start = white_noise(Factors(torch.zeros(COUNT, 2), torch.zeros(COUNT, 1, 1, 2)), generators)
    return sampler(best, start, SCHEDULE, generators)


def test_linear_schedule_is_diffirs():
    squares = LinearSchedule().signal(torch.tensor([0, 0.25, 0.5, 0.75, 1], dtype=torch.float64)) ** 2
    torch.testing.assert_close(squares, torch.tensor([1, 0.900, 0.635, 0.260, 0.0026]).double(), rtol=0, atol=6e-4)


@pytest.mark.parametrize("schedule", [CosineSchedule(), LinearSchedule()])
def test_signal_falls_from_one(schedule):
    signal = schedule.signal(torch.linspace(0, 1, 101, dtype=torch.float64))
    assert signal[0] == 1
    assert (signal.diff() < 0).all()
    assert 0 < signal[-1] < 0.1


@pytest.mark.parametrize("sampler", [Sampler(64, noise=1.0), Sampler(64, noise=0.0), Sampler(64, noise=0.5)])
def test_many_steps_give_the_distribution(sampler):
    for part in (sampled(sampler).vector, sampled(sampler).grid):
        assert part.mean().item() == pytest.approx(CENTRE, abs=0.03)
        assert part.std().item() == pytest.approx(SPREAD, rel=0.06)


def test_error_falls_with_steps_and_the_posterior_mean_collapses():
    ancestral = [abs(sampled(Sampler(steps, noise=1.0)).vector.std().item() - SPREAD) for steps in (1, 2, 4, 8, 32)]
    assert ancestral == sorted(ancestral, reverse=True)
    collapsed = sampled(Sampler(4, mean=True)).vector.std().item()
    assert collapsed < 0.5 * sampled(Sampler(4, noise=1.0)).vector.std().item()


def test_one_step_is_one_prediction():
    generators = spawn_seeded(COUNT)
    start = white_noise(Factors(torch.zeros(COUNT, 2), torch.zeros(COUNT, 1, 1, 2)), generators)
    expected = best(start, torch.ones(COUNT))
    torch.testing.assert_close(sampled(Sampler(1)).vector, expected.vector)


def test_samples_are_repeatable_and_ddim_draws_no_fresh_noise():
    assert torch.equal(sampled(Sampler(4)).grid, sampled(Sampler(4)).grid)
    generator = torch.Generator().manual_seed(1)
    start = white_noise(Factors(torch.zeros(1, 2), torch.zeros(1, 1, 1, 2)), [generator])
    state = generator.get_state()
    Sampler(8, noise=0.0)(best, start, SCHEDULE, [generator])
    assert torch.equal(generator.get_state(), state)
    Sampler(8, noise=1.0)(best, start, SCHEDULE, [generator])
    assert not torch.equal(generator.get_state(), state)


@pytest.mark.parametrize(("choice", "name"), [({"steps": 0}, "steps"), ({"noise": 1.5}, "noise")])
def test_impossible_samplers_are_refused(choice, name):
    with pytest.raises(InputError, match=name):
        Sampler(**choice)


@pytest.mark.parametrize(("vector", "grid"), [(3, 2), (3, 0), (0, 2)])
def test_denoiser_keeps_the_shape_of_codes_and_hears_the_time(vector, grid):
    torch.manual_seed(0)
    denoiser = Denoiser(vector, grid, width=8, blocks=1)
    noisy = Factors(torch.randn(2, vector), torch.randn(2, grid, 2, 3))
    features = denoiser.features(torch.rand(2, 3, 16, 24))
    early, late = (denoiser(noisy, torch.full((2,), t), features) for t in (0.1, 0.9))
    assert early.vector.shape == noisy.vector.shape
    assert early.grid.shape == noisy.grid.shape
    assert not torch.equal(early.vector if vector else early.grid, late.vector if vector else late.grid)
    assert early.vector.isfinite().all()
    assert early.grid.isfinite().all()


class Saturated:
    """No signal in the first half of the way, no noise in the last third: what stiff schedules come to in float64."""

    def signal(self, time: torch.Tensor) -> torch.Tensor:
        return ((0.6 - time) / 0.3).clamp(0, 1)


@pytest.mark.parametrize("sampler", [Sampler(16), Sampler(16, noise=1.0), Sampler(16, mean=True)])
def test_a_schedule_that_holds_still_at_its_ends_is_walked(sampler):
    """Cases steep_64, linear_1000_64: they ended in a division by zero."""
    generators = spawn_seeded(4)
    start = white_noise(Factors(torch.zeros(4, 2), torch.zeros(4, 1, 1, 2)), generators)
    seen = []

    def clean(noisy: Factors, time: torch.Tensor) -> Factors:
        seen.append((float(time[0]), noisy.vector.clone()))
        return Factors(torch.full_like(noisy.vector, 3.0), torch.full_like(noisy.grid, 3.0))

    codes = sampler(clean, start, Saturated(), generators)
    assert torch.equal(codes.vector, torch.full((4, 2), 3.0))
    assert all(torch.equal(z, start.vector) for time, z in seen if time > 0.62), "noise is no signal yet"
    assert min(time for time, _ in seen) > 0.26, "where no noise is left the walk ends"


def test_long_walks_stay_outside_autocast():
    """Case steep_1000: in bfloat16 it ended as far from the solution as a code is large."""
    inside = []

    def clean(noisy: Factors, time: torch.Tensor) -> Factors:
        inside.append(torch.is_autocast_enabled("cpu"))
        return noisy

    generators = spawn_seeded(1)
    start = white_noise(Factors(torch.zeros(1, 2), torch.zeros(1, 1, 1, 2)), generators)
    with torch.autocast("cpu", torch.bfloat16):
        for steps in (64, 65):
            Sampler(steps)(clean, start, CosineSchedule(), generators)
    assert inside == [True] * 64 + [False] * 65
