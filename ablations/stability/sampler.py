"""The latent sampler: few and many steps, and schedules that make the reverse process stiff."""

import math
from dataclasses import dataclass
from functools import cache, partial

import torch
from torch import Tensor, nn

from ablations.stability.case import Case, Problem, Tolerance
from gaussian_enhancer.degrade.artefacts.rng import spawn
from gaussian_enhancer.degrade.generative.diffusion import CosineSchedule, LinearSchedule, Sampler, Schedule
from gaussian_enhancer.degrade.generative.factors import Factors, cells, white
from gaussian_enhancer.degrade.generative.second_stage import FactorModel
from gaussian_enhancer.degrade.generative.weights import load_model

SIDE, STEPS = 16, (1, 4, 64, 1000)
FINEST = 4096
"""Steps of the solution that others are compared with."""

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
    """All of the noise falls away within a small share of the time: a stiff reverse process.

    a = 1 / sqrt(1 + exp(2 slope (t - 1/2))): the log of signal over noise falls linearly. In double precision a is 1
    near one end, and next to nothing near the other.

    Args:
        slope: of that logarithm; 5 is about the cosine schedule's.
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
"""Those in use and, after them, those whose reverse process is stiff."""
IN_USE = ("cosine", "linear")
THOUSANDS = ("cosine", "linear", "steep")
"""Those that are walked in a thousand steps as well."""


def cases() -> list[Case]:
    """The family; DDIM everywhere, and ancestral sampling and the posterior's mean on the schedules in use."""
    found = []
    for name in SCHEDULES:
        # A thousand evaluations in every precision take minutes: one stiff schedule stands for the others.
        for steps in STEPS if name in THOUSANDS else STEPS[:-1]:
            # Deriving through many evaluations says nothing that four do not.
            passes = ("forward", "backward") if steps <= 4 else ("forward",)
            about = f"DDIM, {steps} steps, schedule {name}"
            build = partial(sampled, name, Sampler(steps))
            found.append(Case("sampler", f"{name}_{steps}", about, build, *limits(name), passes, seconds=600.0))
    for kind, options in (("ancestral", {"noise": 1.0}), ("mean", {"mean": True})):
        for name in ("cosine", "linear", "steep"):
            build = partial(sampled, name, Sampler(64, **options))  # type: ignore[arg-type]
            about = f"{kind}, 64 steps, schedule {name}"
            found.append(Case("sampler", f"{name}_{kind}", about, build, *limits(name), ("forward",)))
    return found


def limits(name: str) -> tuple[Tolerance, str]:
    """Tolerances of a schedule with their reason."""
    return (TOLERANCE, WHY) if name in IN_USE else (STIFF, STIFF_WHY)


def sampled(name: str, sampler: Sampler) -> Problem:
    """Codes from noise by the shipped denoiser."""
    model = denoising()
    manual = torch.rand(1, 3, SIDE, SIDE, generator=torch.Generator().manual_seed(9), dtype=torch.float64)
    return Problem(partial(_sampled, name, sampler), {"manual": manual}, model)


def _sampled(name: str, sampler: Sampler, module: nn.Module | None, inputs: dict[str, Tensor]) -> Tensor:
    if not isinstance(module, FactorModel):
        raise TypeError(f"{type(module).__name__} is no factor model")
    manual = inputs["manual"]
    features = module.denoiser.features(manual)
    rows, columns = cells(*manual.shape[-2:])
    design = module.design
    empty = manual.new_zeros(1, design.vector), manual.new_zeros(1, design.grid, rows, columns)
    generators = spawn(1, torch.Generator().manual_seed(10))

    def predict(noisy: Factors, time: Tensor) -> Factors:
        return module.denoiser(noisy, time, features)

    codes = sampler(predict, white(Factors(*empty), generators), SCHEDULES[name], generators)
    return torch.cat([codes.vector.flatten(), codes.grid.flatten()])


@cache
def denoising() -> FactorModel:
    """The shipped simulator's networks in double precision; shared, callers copy them."""
    return load_model("simulator").model.double()


def order(name: str, counts: tuple[int, ...], finest: int = FINEST) -> dict[int, float]:
    """Error of DDIM by steps: root mean square difference to the finest solution, in double precision.

    Args:
        name: of the schedule.
        counts: of steps.
        finest: steps of the solution that is compared with.
    """

    def solved(steps: int) -> Tensor:
        found = sampled(name, Sampler(steps))
        with torch.no_grad():
            return found.call(found.module, dict(found.inputs))

    truth = solved(finest)
    return {steps: math.sqrt(float((solved(steps) - truth).square().mean())) for steps in counts}
