"""A network whose effect can be seen without training."""

from pathlib import Path

import torch

from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.infer.weights import save_weights
from gaussian_enhancer.network.sif import SIF


def bright_network(bias: float = 0.1, levels: int = 3) -> SIF:
    """A network that brightens what it sees; with a bias of 0 it returns the render."""
    torch.manual_seed(0)
    network = SIF((8,) * levels, (1,) * levels)
    torch.nn.init.constant_(network.decode.head.bias, bias)
    return network


def write_bright_weights(folder: Path, strength: float) -> Path:
    """The file of a network that brightens what it sees.

    Args:
        folder: where it is written.
        strength: what the weights' card states.
    """
    path = folder / "bright.safetensors"
    save_weights(path, bright_network(), ReferenceConfig(), {"strength": strength})
    return path
