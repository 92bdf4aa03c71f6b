"""Learning rate over a training, as a factor for `torch.optim.lr_scheduler.LambdaLR`."""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class WarmupCosine:
    """Linear warm-up times a cosine down to zero.

    factor(t) = min(1, (t + 1) / warmup) * (1 + cos(pi min(1, t / steps))) / 2

    Args:
        steps: length of the training.
        warmup: steps of rising learning rate.
    """

    steps: int
    warmup: int = 200

    def __call__(self, step: int) -> float:
        """Share of the largest learning rate at a step."""
        rise = min(1.0, (step + 1) / max(1, self.warmup))
        return rise * 0.5 * (1 + math.cos(math.pi * min(1.0, step / max(1, self.steps))))
