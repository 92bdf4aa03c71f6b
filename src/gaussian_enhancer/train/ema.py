"""Update rule of an exponential moving average (EMA) of the weights, for Lightning's ``WeightAveraging`` callback."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class EMA:
    """EMA whose decay rises at the start: after n updates it is min(decay, (n + 2) / (n + 11)).

    Lightning's ``EMAWeightAveraging`` has a constant decay. At decay 0.999 the untrained weights would still make up a
    tenth of the average after 2300 steps. Its base class takes this rule as ``multi_avg_fn``.

    Args:
        decay: share of the average that is kept at each step, after the start.
    """

    decay: float = 0.999

    @torch.no_grad()
    def __call__(self, averages: Sequence[Tensor], values: Sequence[Tensor], updates: Tensor | int) -> None:
        """Move all averages towards the current weights, in place, in one call.

        Args:
            averages: the averaged weights.
            values: the current weights.
            updates: number of earlier updates, including the first one, which copies the weights.
        """
        count = int(updates)
        decay = min(self.decay, (count + 2) / (count + 11))
        torch._foreach_lerp_(list(averages), list(values), 1 - decay)
