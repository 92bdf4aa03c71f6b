"""LPIPS with a local backbone. Backbones are never downloaded, and never substituted for each other.

The linear heads (v0.1) come with the ``lpips`` package. The backbones are torchvision's ImageNet networks. They are
searched for in a given file or folder, in the folder ``lpips`` of the data folder, and in torchvision's cache.
Source: Zhang et al., The Unreasonable Effectiveness of Deep Features as a Perceptual Metric, CVPR 2018.

Axes: h height, w width.
"""

import functools
import os
import pickle
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlparse

import torch
from jaxtyping import Float
from torch import Tensor, nn

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.input_files import refuse_larger_archive


@dataclass(frozen=True)
class Backbone:
    """A network whose features LPIPS compares.

    Args:
        builder: torchvision's function that builds it.
        weights: torchvision's name of its weights.
        features: usual name of a file with the weights of its ``features`` part only.
        smallest: smallest height and width in pixels for which no feature map is empty.
    """

    builder: str
    weights: str
    features: str
    smallest: int


BACKBONES = {
    "vgg": Backbone("vgg16", "VGG16_Weights", "vgg16_features.pth", 16),
    "alex": Backbone("alexnet", "AlexNet_Weights", "alexnet_features.pth", 31),
    "squeeze": Backbone("squeezenet1_1", "SqueezeNet1_1_Weights", "squeezenet1_1_features.pth", 17),
}

VARIANTS = {
    "lpips_vgg_raw": ("vgg", False),
    "lpips_vgg": ("vgg", True),
    "lpips_alex": ("alex", True),
    "lpips_squeeze": ("squeeze", True),
}
"""Backbone of each named distance, and whether [0, 1] is rescaled to the [-1, 1] that LPIPS was trained on.

3DGS's published tables use VGG without rescaling: ``lpips_vgg_raw``.
"""


NO_BACKBONE = "not measured: no backbone"
"""How the reason of a distance without a backbone begins."""


@dataclass(frozen=True)
class PerceptualDistance:
    """A named LPIPS distance, or the reason why it cannot be measured.

    Args:
        name: one of `VARIANTS`.
        network: LPIPS network for images in [-1, 1]; None without a backbone.
        reason: why there is no network; empty otherwise.
    """

    name: str
    network: nn.Module | None
    reason: str = ""

    def size_reason(self, height: int, width: int) -> str:
        """Why images of this size cannot be measured; empty if they can."""
        smallest = BACKBONES[VARIANTS[self.name][0]].smallest
        if self.network is not None and min(height, width) < smallest:
            return f"not measured: {width}x{height} is smaller than the network's {smallest} pixels"
        return self.reason

    @torch.no_grad()
    def between(self, image: Float[Tensor, "3 h w"], photo: Float[Tensor, "3 h w"]) -> float:
        """Distance of two images in [0, 1]: 0 for equal images, about 1 for unrelated ones.

        Raises:
            InputError: there is no backbone, or the images are too small for it.
        """
        reason = self.size_reason(image.shape[1], image.shape[2])
        if reason or self.network is None:
            raise InputError(self.name, reason, "leave it out of the metrics")
        device = next(self.network.parameters()).device
        pair = [image[None].to(device, torch.float32), photo[None].to(device, torch.float32)]
        return self.network(*pair, normalize=VARIANTS[self.name][1]).item()


DEFAULT_DISTANCES = ("lpips_vgg_raw", "lpips_vgg", "lpips_alex")
"""The distances that are measured by default."""


def requested_distances(
    names: Sequence[str] | None, backbone: str | Path | None = None, device: torch.device | str = "cpu"
) -> list[PerceptualDistance]:
    """Make the named distances; without names, those of `DEFAULT_DISTANCES` that have a backbone.

    Args:
        names: names of the requested distances; None for the defaults.
        backbone: see `perceptual_distance`.
        device: device to measure on.

    Raises:
        InputError: see `perceptual_distance`.
    """
    distances = [
        perceptual_distance(name, backbone, device) for name in (DEFAULT_DISTANCES if names is None else names)
    ]
    return [distance for distance in distances if names is not None or distance.network is not None]


def perceptual_distance(
    name: str, backbone: str | Path | None = None, device: torch.device | str = "cpu"
) -> PerceptualDistance:
    """Make a named LPIPS distance. Without a backbone, it contains the reason and the remedy.

    Args:
        name: one of `VARIANTS`.
        backbone: a file of weights (of the whole network or of its ``features``), or a folder of such files under
            their usual names. If None, or if the folder lacks the file, ``GAUSSIAN_ENHANCER_DATA/lpips`` and then
            torchvision's cache are searched.
        device: device to measure on.

    Raises:
        InputError: the name is unknown, or the file does not hold this backbone.
    """
    if name not in VARIANTS:
        raise InputError(f"metric {name!r}", "is unknown", f"choose from {', '.join(VARIANTS)}")
    net = VARIANTS[name][0]
    file = _find_backbone(net, None if backbone is None else Path(backbone))
    if file is None:
        spec = BACKBONES[net]
        command = f"from torchvision.models import *; {spec.builder}(weights={spec.weights}.IMAGENET1K_V1)"
        remedy = f"{backbone_place(name)}, or get it with: python -c '{command}'"
        return PerceptualDistance(name, None, f"{NO_BACKBONE}; {remedy}")
    return PerceptualDistance(name, _network(net, file, str(device)))


def backbone_place(name: str) -> str:
    """Which file to put where so that a named distance can be measured, as an instruction.

    Args:
        name: one of `VARIANTS`.
    """
    net = VARIANTS[name][0]
    files = f"torchvision's {_download_name(net)} (or its features alone, {BACKBONES[net].features})"
    return f"put {files} into the folder $GAUSSIAN_ENHANCER_DATA/lpips or into one given as backbones=FOLDER"


def data_backbones() -> Path | None:
    """The folder ``lpips`` in the data folder ``GAUSSIAN_ENHANCER_DATA``; None if it does not exist."""
    data = os.environ.get("GAUSSIAN_ENHANCER_DATA")
    folder = Path(data) / "lpips" if data else None
    return folder if folder is not None and folder.is_dir() else None


def _find_backbone(net: str, path: Path | None) -> Path | None:
    """The backbone's file: the given file, or one in the given folder, in the data folder or in torchvision's cache."""
    spec = BACKBONES[net]
    if path is not None and not path.exists():
        raise InputError(path, "does not exist", "name the backbone's file or its folder")
    if path is not None and path.is_file():
        return path.resolve()
    download_name = _download_name(net)
    folders = [folder for folder in (path, data_backbones()) if folder is not None]
    candidates = [folder / name for folder in folders for name in (spec.features, download_name)]
    candidates.append(Path(torch.hub.get_dir()) / "checkpoints" / download_name)
    return next((file.resolve() for file in candidates if file.is_file()), None)


def _download_name(net: str) -> str:
    """The name of torchvision's file of the whole network."""
    import torchvision

    url = torchvision.models.get_model_weights(BACKBONES[net].builder).IMAGENET1K_V1.url
    return Path(urlparse(url).path).name


@functools.lru_cache(maxsize=4)
def _network(net: str, file: Path, device: str) -> nn.Module:
    """Load LPIPS with the package's heads and the backbone's weights from ``file``."""
    import lpips

    # The package draws random weights, which are overwritten, and triggers a deprecation warning of torchvision.
    with torch.random.fork_rng(devices=[]), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        network = lpips.LPIPS(net=net, version="0.1", pnet_rand=True, verbose=False)
    weights = _weights(file)
    expected = {name: name.split(".", 1)[1] for name in network.net.state_dict()}  # slice2.3.weight -> 3.weight
    missing = [key for key in expected.values() if key not in weights]
    if missing:
        received = f"does not hold the {BACKBONES[net].builder} backbone (no {missing[0]})"
        raise InputError(file, received, "give the file of that network")
    try:
        network.net.load_state_dict({name: weights[key] for name, key in expected.items()})
    except RuntimeError as error:
        received = f"does not hold the {BACKBONES[net].builder} backbone ({str(error).splitlines()[-1].strip()})"
        raise InputError(file, received, "give the file of that network") from None
    return network.requires_grad_(False).eval().to(device)


def _weights(file: Path) -> dict[str, Any]:
    """Read a state dict and return its ``features`` part, with keys relative to it."""
    refuse_larger_archive(file)
    try:
        state = torch.load(file, map_location="cpu", weights_only=True)
    except (OSError, RuntimeError, EOFError, pickle.UnpicklingError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(file, f"cannot be read as weights ({reason})", "download it again") from None
    if not isinstance(state, dict):
        raise InputError(file, f"holds a {type(state).__name__}", "give a state dict")
    return {key.removeprefix("features."): value for key, value in state.items() if not key.startswith("classifier.")}
