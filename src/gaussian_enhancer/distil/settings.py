"""The choices of distilling, as plain values."""

from dataclasses import dataclass, field
from typing import Annotated

from pydantic import Field

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.splat.fit.optimise import LearningRates
from gaussian_enhancer.typed import check_fields

Share = Annotated[int | float, Field(ge=0, le=1)]


def _rates() -> LearningRates:
    return LearningRates(means=1.6e-5, means_final=1.6e-6, boost=1.0)


@dataclass(frozen=True)
class DistilSettings:
    """Choices of distilling.

    Args:
        steps: number of further steps in all rounds together, one image each.
        rounds: how often the enhanced views are made anew, from the splat as it is then.
        views: enhanced views a round.
        share: share of steps on enhanced views; the others are on the training photos. 0 makes no enhanced view.
        weight: factor on the gradient of an enhanced view, which its confidence scales as well, pixel by pixel.
        around: how far new cameras leave the way between training cameras at most, in mean distances from one training
            camera to the next.
        ssim_weight: share of 1 - SSIM in the loss; L1 has the rest.
        seed: of all randomness.
        rates: learning rates of the first step; centres move less than in a fit.
        fade: share of these rates that is left at the last step.
    """

    steps: Annotated[int, Field(ge=1)] = 1500
    rounds: Annotated[int, Field(ge=1)] = 2
    views: Annotated[int, Field(ge=2)] = 48
    share: Share = 0.7
    weight: Share = 1.0
    around: Annotated[int | float, Field(ge=0, le=1)] = 0.75
    ssim_weight: Share = 0.2
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    rates: LearningRates = field(default_factory=_rates)
    fade: Annotated[int | float, Field(gt=0, le=1)] = 0.1

    def __post_init__(self) -> None:
        check_fields(self, "settings.")
        if self.rounds > self.steps:
            raise InputError("settings.rounds", f"is {self.rounds} for {self.steps} steps", "give at most one a step")

    def round_of(self, step: int) -> int:
        """The round to which a step belongs, both counted from 0."""
        return step * self.rounds // self.steps
