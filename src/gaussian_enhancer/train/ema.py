"""The running mean of a network's weights."""

import torch
from torch import nn


@torch.no_grad()
def follow(ema: nn.Module, network: nn.Module, decay: float, step: int) -> None:
    """Move an average towards a network's present weights; early on it follows faster.

    Args:
        ema: a copy of the network; changed in place, its buffers become the network's.
        network: what is trained.
        decay: share of the average that stays at each step, once the training is under way.
        step: steps done so far.
    """
    decay = min(decay, (1 + step) / (10 + step))
    for mean, value in zip(ema.parameters(), network.parameters(), strict=True):
        mean.lerp_(value, 1 - decay)
    for kept, present in zip(ema.buffers(), network.buffers(), strict=True):
        kept.copy_(present)
