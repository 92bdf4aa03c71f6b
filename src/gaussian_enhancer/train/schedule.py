"""Learning-rate schedule, as a factor for `torch.optim.lr_scheduler.LambdaLR`."""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class WarmupCosine:
    """Linear warm-up times a cosine decay to zero.

    factor(t) = min(1, (t + 1) / warmup) * (1 + cos(pi min(1, t / steps))) / 2

    Args:
        steps: number of training steps.
        warmup: number of warm-up steps.
    """

    steps: int
    warmup: int = 200

    def __call__(self, step: int) -> float:
        """Learning rate at a step, as a factor of the largest one."""
        rise = min(1.0, (step + 1) / max(1, self.warmup))
        return rise * 0.5 * (1 + math.cos(math.pi * min(1.0, step / max(1, self.steps))))
