"""Exponential moving average (EMA) of the weights, as a rule for Lightning's ``WeightAveraging`` callback."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class EMA:
    """Averages follow faster early on: after n updates the decay is min(decay, (n + 2) / (n + 11)).

    Lightning's ``EMAWeightAveraging`` has a constant decay, with which the untrained weights stand for a tenth of the
    average still after 2300 steps at decay 0.999. Its base class takes this rule as ``multi_avg_fn``.

    Args:
        decay: share of the average that stays at each step, once the training is under way.
    """

    decay: float = 0.999

    @torch.no_grad()
    def __call__(self, averages: Sequence[Tensor], values: Sequence[Tensor], updates: Tensor | int) -> None:
        """Move averages towards the present weights, in place, all of them in one call.

        Args:
            averages: what is kept.
            values: present weights.
            updates: how many there were before; the first one, a copy, among them.
        """
        count = int(updates)
        decay = min(self.decay, (count + 2) / (count + 11))
        torch._foreach_lerp_(list(averages), list(values), 1 - decay)
