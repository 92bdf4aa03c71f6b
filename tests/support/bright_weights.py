"""Weights whose effect can be seen without training."""

from pathlib import Path

import torch

from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.infer.weights import save_weights
from gaussian_enhancer.network.sif import SIF


def write_bright_weights(folder: Path, strength: float) -> Path:
    """The file of a network that brightens what it sees.

    Args:
        folder: where it is written.
        strength: what the weights' card states.
    """
    path = folder / "bright.safetensors"
    torch.manual_seed(0)
    network = SIF((8, 8, 8), (1, 1, 1))
    torch.nn.init.constant_(network.decode.head.bias, 0.1)
    save_weights(path, network, ReferenceConfig(), {"strength": strength})
    return path
