"""Settings of distilling."""

from dataclasses import dataclass, field
from typing import Annotated

from pydantic import Field

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.splat.fit.optimise import LearningRates
from gaussian_enhancer.typed import Share, check_fields


def _rates() -> LearningRates:
    return LearningRates(means=1.6e-5, means_final=1.6e-6, boost=1.0)


@dataclass(frozen=True)
class DistilSettings:
    """Settings of distilling.

    Args:
        steps: total number of steps in all rounds; each step uses one image.
        rounds: number of rounds; each makes its enhanced views from the current splat.
        views: number of enhanced views per round.
        share: expected share of steps on enhanced views; other steps use training photos. With 0, no views are made.
        weight: factor on the gradient of an enhanced view, in addition to its confidence at each pixel.
        around: largest displacement of new cameras from the path through the training cameras along each world axis, in
            mean distances from a training camera to its nearest neighbour.
        ssim_weight: weight of 1 - SSIM in the loss; the weight of L1 is 1 minus this.
        seed: seed of all random numbers.
        rates: learning rates at the first step; that of the centres is smaller than in a fit.
        fade: factor on the learning rates at the last step, reached exponentially. The centres' rate ends at
            ``rates.means_final`` instead.
    """

    steps: Annotated[int, Field(ge=1)] = 1500
    rounds: Annotated[int, Field(ge=1)] = 2
    views: Annotated[int, Field(ge=2)] = 48
    share: Share = 0.7
    weight: Share = 1.0
    around: Share = 0.75
    ssim_weight: Share = 0.2
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    rates: LearningRates = field(default_factory=_rates)
    fade: Annotated[int | float, Field(gt=0, le=1)] = 0.1

    def __post_init__(self) -> None:
        check_fields(self, "settings.")
        if self.rounds > self.steps:
            raise InputError("settings.rounds", f"is {self.rounds} for {self.steps} steps", "give at most one a step")

    def round_of(self, step: int) -> int:
        """Index of the round to which a step belongs; both count from 0."""
        return step * self.rounds // self.steps
