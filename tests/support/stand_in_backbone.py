"""An untrained VGG16 in place of the trained one: its LPIPS has no meaning, but is measured as the real one."""

from pathlib import Path

import torch
import torchvision


def write_vgg(path: Path, whole: bool = False) -> None:
    """Write an untrained VGG16's weights as torchvision does: of its features alone, or with its classifier's keys."""
    torch.manual_seed(0)
    features = torchvision.models.vgg.make_layers(torchvision.models.vgg.cfgs["D"]).state_dict()
    state = {f"features.{key}": value for key, value in features.items()} if whole else dict(features)
    if whole:
        state["classifier.0.weight"] = torch.zeros(1)  # never read
    path.parent.mkdir(parents=True, exist_ok=True)
    torch.save(state, path)
