"""Build the result of Lightning's ``configure_optimizers`` from a configuration's partial constructors."""

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
    """Parameter groups in which the weights of convolutions alone decay: those that are trained, of any optimizer."""
    trained = [parameter for parameter in parameters if parameter.requires_grad]
    others = {"params": [parameter for parameter in trained if parameter.dim() != 4], "weight_decay": 0.0}
    return [{"params": [parameter for parameter in trained if parameter.dim() == 4]}, others]


def optimizer_configuration(
    groups: list[dict[str, Any]], optimizer: MakeOptimizer, lr_scheduler: MakeScheduler | None, monitor: str
) -> dict[str, Any]:
    """Optimizer and learning-rate scheduler as Lightning takes them.

    A scheduler is stepped after every optimizer step; ``ReduceLROnPlateau`` after every validation.

    Args:
        groups: parameter groups.
        optimizer: makes the optimizer.
        lr_scheduler: makes the scheduler; None keeps the learning rate.
        monitor: the validation metric that ``ReduceLROnPlateau`` follows.
    """
    made = optimizer(groups)
    if lr_scheduler is None:
        return {"optimizer": made}
    scheduler = lr_scheduler(made)
    interval = "epoch" if isinstance(scheduler, ReduceLROnPlateau) else "step"
    return {"optimizer": made, "lr_scheduler": {"scheduler": scheduler, "interval": interval, "monitor": monitor}}
