"""Cases of the latent sampler: few and many steps, and schedules that make the reverse process stiff."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, partial

import torch
from torch import Tensor, nn

from ablations.stability.case import Case, Problem, Tolerance
from gaussian_enhancer.degrade.artefacts.rng import spawn
from gaussian_enhancer.degrade.generative.diffusion import CosineSchedule, LinearSchedule, Sampler, Schedule
from gaussian_enhancer.degrade.generative.factors import Factors, grid_size, white_noise
from gaussian_enhancer.degrade.generative.second_stage import FactorModel
from gaussian_enhancer.degrade.generative.weights import load_model

SIDE, STEPS = 16, (1, 4, 64, 1000)
FINEST = 4096
"""Number of steps of the reference solution."""

TOLERANCE: Tolerance = {
    "float32": (1e-3, 1e-2),
    "bfloat16": (0.3, 0.5),
    "float16": (0.05, 0.1),
    "autocast bfloat16": (0.2, 0.5),
    "autocast float16": (0.05, 0.1),
}
WHY = "codes have unit size; each step adds the denoiser's rounding, and later steps forget earlier ones"
STIFF: Tolerance = {**TOLERANCE, "bfloat16": (0.5, 0.5), "autocast bfloat16": (0.5, 0.5), "float16": (0.1, 0.1)}
STIFF_WHY = "a stiff process magnifies each step's rounding"


@dataclass(frozen=True)
class SteepSchedule:
    """A schedule that removes all noise within a small part of the time, which makes the reverse process stiff.

    a = 1 / sqrt(1 + exp(2 slope (t - 1/2))): the logarithm of signal over noise decreases linearly. In double
    precision, a is 1 near one end and almost 0 near the other.

    Args:
        slope: of that logarithm; the cosine schedule has about 5.
    """

    slope: float = 200.0

    def signal(self, time: Tensor) -> Tensor:
        """The signal a at times in [0, 1]."""
        return torch.sigmoid(-2 * self.slope * (time - 0.5)).sqrt()


SCHEDULES: dict[str, Schedule] = {
    "cosine": CosineSchedule(),
    "linear": LinearSchedule(),
    "cosine_to_zero": CosineSchedule(end=1.0),
    "linear_1000": LinearSchedule(steps=1000),
    "steep": SteepSchedule(),
    "steepest": SteepSchedule(slope=2000.0),
}
"""Schedules: first those in use, then those whose reverse process is stiff."""
IN_USE = ("cosine", "linear")
THOUSANDS = ("cosine", "linear", "steep")
"""Schedules that are also computed with a thousand steps."""


def cases() -> Iterator[Case]:
    """The cases of this family: DDIM on all schedules; ancestral sampling and the posterior mean on three of them."""
    for name in SCHEDULES:
        # A thousand evaluations in every precision take minutes: only one stiff schedule is computed with them.
        for steps in STEPS if name in THOUSANDS else STEPS[:-1]:
            # A backward pass through many evaluations shows nothing that four do not.
            passes = ("forward", "backward") if steps <= 4 else ("forward",)
            about = f"DDIM, {steps} steps, schedule {name}"
            build = partial(sampler_problem, name, Sampler(steps))
            yield Case("sampler", f"{name}_{steps}", about, build, *limits(name), passes, seconds=600.0)
    for kind, options in (("ancestral", {"noise": 1.0}), ("mean", {"mean": True})):
        for name in ("cosine", "linear", "steep"):
            build = partial(sampler_problem, name, Sampler(64, **options))  # type: ignore[arg-type]
            about = f"{kind}, 64 steps, schedule {name}"
            yield Case("sampler", f"{name}_{kind}", about, build, *limits(name), ("forward",))


def limits(name: str) -> tuple[Tolerance, str]:
    """Tolerances of a schedule, and their reason."""
    return (TOLERANCE, WHY) if name in IN_USE else (STIFF, STIFF_WHY)


def sampler_problem(name: str, sampler: Sampler) -> Problem:
    """Codes sampled from noise by the shipped denoiser."""
    model = shipped_factor_model()
    manual = torch.rand(1, 3, SIDE, SIDE, generator=torch.Generator().manual_seed(9), dtype=torch.float64)
    return Problem(partial(_sample_codes, name, sampler), {"manual": manual}, model)


def _sample_codes(name: str, sampler: Sampler, module: nn.Module | None, inputs: dict[str, Tensor]) -> Tensor:
    if not isinstance(module, FactorModel):
        raise TypeError(f"{type(module).__name__} is no factor model")
    manual = inputs["manual"]
    features = module.denoiser.features(manual)
    rows, columns = grid_size(*manual.shape[-2:])
    design = module.design
    zeros = manual.new_zeros(1, design.vector), manual.new_zeros(1, design.grid, rows, columns)
    generators = spawn(1, torch.Generator().manual_seed(10))

    def predict(noisy: Factors, time: Tensor) -> Factors:
        return module.denoiser(noisy, time, features)

    codes = sampler(predict, white_noise(Factors(*zeros), generators), SCHEDULES[name], generators)
    return torch.cat([codes.vector.flatten(), codes.grid.flatten()])


@cache
def shipped_factor_model() -> FactorModel:
    """The shipped simulator's networks in double precision; they are shared, so callers copy them."""
    return load_model("simulator").model.double()


def ddim_errors(name: str, counts: tuple[int, ...], finest: int = FINEST) -> dict[int, float]:
    """Error of DDIM by number of steps: root mean square difference to the reference solution, in double precision.

    Args:
        name: of the schedule.
        counts: numbers of steps.
        finest: number of steps of the reference solution.
    """

    def solved(steps: int) -> Tensor:
        sampling_problem = sampler_problem(name, Sampler(steps))
        with torch.no_grad():
            return sampling_problem.call(sampling_problem.module, dict(sampling_problem.inputs))

    reference = solved(finest)
    return {steps: math.sqrt(float((solved(steps) - reference).square().mean())) for steps in counts}
