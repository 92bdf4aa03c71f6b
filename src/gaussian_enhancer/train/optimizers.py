"""Optimizers and schedulers for Lightning's ``configure_optimizers``, from a configuration's partial constructors."""

from collections.abc import Callable, Iterable
from typing import Any

from torch import Tensor
from torch.optim import Optimizer
from torch.optim.lr_scheduler import LRScheduler, ReduceLROnPlateau

MakeOptimizer = Callable[[list[dict[str, Any]]], Optimizer]
"""For instance ``functools.partial(torch.optim.AdamW, lr=1e-3)``."""
MakeScheduler = Callable[[Optimizer], LRScheduler]
"""For instance ``functools.partial(torch.optim.lr_scheduler.CosineAnnealingLR, T_max=1000)``."""


def decayed_groups(parameters: Iterable[Tensor]) -> list[dict[str, Any]]:
    """Two parameter groups of the trainable parameters: weights of convolutions, and the rest without weight decay."""
    trained = [parameter for parameter in parameters if parameter.requires_grad]
    undecayed = {"params": [parameter for parameter in trained if parameter.dim() != 4], "weight_decay": 0.0}
    return [{"params": [parameter for parameter in trained if parameter.dim() == 4]}, undecayed]


def optimizer_configuration(
    groups: list[dict[str, Any]], optimizer: MakeOptimizer, lr_scheduler: MakeScheduler | None, monitor: str
) -> dict[str, Any]:
    """Optimizer and learning-rate scheduler in the form that Lightning expects.

    A scheduler is stepped after every optimizer step, but ``ReduceLROnPlateau`` after every validation.

    Args:
        groups: parameter groups.
        optimizer: makes the optimizer.
        lr_scheduler: makes the scheduler; None keeps the learning rate constant.
        monitor: the validation metric that ``ReduceLROnPlateau`` monitors.
    """
    built_optimizer = optimizer(groups)
    if lr_scheduler is None:
        return {"optimizer": built_optimizer}
    scheduler = lr_scheduler(built_optimizer)
    interval = "epoch" if isinstance(scheduler, ReduceLROnPlateau) else "step"
    return {
        "optimizer": built_optimizer,
        "lr_scheduler": {"scheduler": scheduler, "interval": interval, "monitor": monitor},
    }
