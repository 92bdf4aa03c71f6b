"""Initialisation of layers whose output is zero before training, so that an untrained network returns the render."""

from torch import nn


def zero_initialise(layer: nn.Conv2d) -> None:
    """Set the weight and the bias of a convolution to zero.

    Args:
        layer: the convolution, which has a bias.
    """
    nn.init.zeros_(layer.weight)
    nn.init.zeros_(layer.bias)  # type: ignore[arg-type]
