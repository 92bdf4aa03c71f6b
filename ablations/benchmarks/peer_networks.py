"""Our networks and published ones on the same input, in the same number type, memory format and number of threads.

Published architectures come from spandrel (the dependency group ``bench``), with random weights: time and memory do not
depend on them. Two ways of computing in bfloat16 are measured for them, autocast and weights cast beforehand, because
neither is faster for all.

Axes: b batch, h height, w width.
"""

import copy
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import torch
from jaxtyping import Float
from omegaconf import DictConfig
from torch import Tensor, nn
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from ablations.benchmarks.networks import counted, example
from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.options import EnhancementOptions
from gaussian_enhancer.infer.planner import Planner
from gaussian_enhancer.infer.weights import Pretrained, load_weights
from gaussian_enhancer.network.network import Network
from gaussian_enhancer.runs.compose import compose_job
from gaussian_enhancer.runs.instantiate import build
from gaussian_enhancer.scene.rendered import RenderedSet

CAST = "bfloat16 weights"
"""Weights and input in bfloat16, without autocast; the other number types are autocast's."""
DTYPES = {"float32": torch.float32, "bfloat16": torch.bfloat16, CAST: torch.bfloat16}

SMALL = 64
"""Side of the input by which a published network's scale is determined."""

Call = Callable[[], Tensor]


@dataclass(frozen=True)
class Peer:
    """A measured network.

    Args:
        name: in the table.
        network: in evaluation mode, channels-last.
        scale: size of the image over that of the input.
        pretrained: our network with its reference configuration; None for published networks.
    """

    name: str
    network: nn.Module
    scale: int
    pretrained: Pretrained | None = None


def names(cfg: DictConfig) -> tuple[str, ...]:
    """The networks that a configuration requests, ours first.

    Args:
        cfg: conf/peers.yaml, composed.

    Raises:
        InputError: one is unknown.
    """
    known_names = (*cfg.ours, *cfg.published)
    for name in cfg.networks or ():
        if name not in known_names:
            raise InputError("networks", f"names {name!r}", f"choose among {', '.join(known_names)}")
    return tuple(name for name in known_names if cfg.networks is None or name in cfg.networks)


def built(cfg: DictConfig, name: str, device: torch.device) -> Peer:
    """A network of the configuration. Hydra must be initialised with the project's configurations.

    Args:
        cfg: conf/peers.yaml, composed.
        name: a key of its ``ours`` or ``published``.
        device: where it runs.

    Raises:
        InputError: it cannot be built, for instance because spandrel is missing.
    """
    if name in cfg.published:
        try:
            network = _prepared(build(cfg.published[name]), device)
        except InputError as error:
            remedy = "install the dependency group `bench` (nox -s bench), or name other networks="
            raise InputError(name, f"cannot be built ({error})", remedy) from error
        with torch.inference_mode():
            return Peer(name, network, network(torch.zeros(1, 3, SMALL, SMALL, device=device)).shape[-1] // SMALL)
    entry = cfg.ours[name]
    pretrained = load_weights(entry.weights) if "weights" in entry else _untrained(cfg, list(entry.train))
    return Peer(name, _prepared(pretrained.network, device), pretrained.network.scale, pretrained)


def _untrained(cfg: DictConfig, train: list[str]) -> Pretrained:
    job = compose_job("train", cfg, train)
    network: Network = build(job.fusion)
    config: ReferenceConfig = build(job.reference_config)
    return Pretrained(network, config, {})


def _prepared(network: nn.Module, device: torch.device) -> nn.Module:
    prepared: nn.Module = network.eval().to(device, memory_format=torch.channels_last)  # type: ignore[call-overload]
    return prepared


def number_types(peer: Peer, dtypes: Mapping[str, torch.dtype]) -> tuple[str, ...]:
    """The number types in which a network is measured; ours supports autocast only."""
    return tuple(name for name in dtypes if name != CAST or peer.pretrained is None)


@dataclass(frozen=True)
class Forward:
    """A network's forward pass on an input.

    Args:
        network: ours or a published one.
        input: its input.
        dtype: one of `DTYPES`.
        device: where it runs.
    """

    network: nn.Module
    input: Any
    dtype: str
    device: torch.device

    @torch.inference_mode()
    def __call__(self) -> Float[Tensor, "b 3 _ _"]:
        """The image."""
        return self.image()

    def image(self) -> Float[Tensor, "b 3 _ _"]:
        """The same in the mode of the caller."""
        autocast = torch.autocast(self.device.type, torch.bfloat16, enabled=self.dtype == "bfloat16")
        with autocast:
            image: Tensor = self.network(self.input)
            return image


def forward(peer: Peer, dtype: str, height: int, width: int, references: int) -> Forward:
    """The forward pass of the network alone, on noise, with references on the target's grid.

    Args:
        peer: the network; for `CAST` the call keeps a copy of it in bfloat16.
        dtype: one of `DTYPES`.
        height: of the input.
        width: of the input.
        references: of each view at most, for ours.
    """
    device = next(peer.network.parameters()).device
    if peer.pretrained is not None:
        count = min(references, peer.pretrained.reference_config.references)  # the paper's fuse two
        return Forward(peer.network, example(height, width, count).to(device), dtype, device)
    image = torch.rand(1, 3, height, width, generator=torch.Generator().manual_seed(0)).to(device)
    image = image.contiguous(memory_format=torch.channels_last)
    if dtype == CAST:
        return Forward(copy.deepcopy(peer.network).bfloat16(), image.bfloat16(), dtype, device)
    return Forward(peer.network, image, dtype, device)


def enhancement(peer: Peer, dtype: str, views: RenderedSet, device: torch.device) -> Call:
    """A whole enhancement of decoded images: planning, alignment, network, limits to the change.

    Args:
        peer: one of ours.
        dtype: "bfloat16" or "float32".
        views: one target and its references, in memory.
        device: where it runs.
    """
    if peer.pretrained is None:
        raise ValueError(f"{peer.name} is not ours")
    options = EnhancementOptions(precision=dtype)
    config = options.reference_config(peer.pretrained, "surface")
    enhancer = options.enhancer(replace(peer.pretrained, network=peer.network), config, device)  # type: ignore[arg-type]

    def enhanced() -> Tensor:
        planner = Planner(options.rules, config, views)  # anew: nothing is kept from the call before
        return next(iter(enhancer(views, planner))).image

    return enhanced


class BytesMoved(TorchDispatchMode):
    """Counts the bytes that operations read and write: each tensor of an operation once, without views.

    Caches and compilers save some of these transfers, so the count is an upper bound of the memory traffic.
    """

    def __init__(self) -> None:
        super().__init__()
        self.count = 0

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = kwargs or {}
        result = func(*args, **kwargs)
        if not func.is_view:
            tensors = [leaf for leaf in tree_leaves((args, kwargs, result)) if isinstance(leaf, Tensor)]
            self.count += sum(tensor.numel() * tensor.element_size() for tensor in tensors)
        return result


@torch.no_grad()
def bytes_moved(call: Call) -> int:
    """Bytes that the operations of a call read and write.

    Args:
        call: must not use inference mode, in which composite operations are not decomposed.
    """
    with BytesMoved() as counter:
        call()
    return counter.count


def work(peer: Peer, dtype: str, references: int, side: int = 128) -> tuple[float, float]:
    """Multiply-adds, and bytes read and written by operations, for each pixel of the image.

    Args:
        peer: the network, not compiled.
        dtype: one of `DTYPES`.
        references: of each view at most, for ours.
        side: of the input.
    """
    call = forward(peer, dtype, side, side, references)
    pixels = (side * peer.scale) ** 2
    return counted(forward(peer, "float32", side, side, references)), bytes_moved(call.image) / pixels


def yardsticks(device: torch.device) -> Iterator[tuple[str, Callable[[], object], float, str]]:
    """Fixed workloads that times are compared with: name, call, amount of work and its unit.

    A convolution of 64 to 64 channels in each number type measures the machine's arithmetic, a copy of 256 MB its
    memory.
    """
    side, channels, repeats = 256, 64, 4
    for name in ("bfloat16", "float32"):
        layer = nn.Conv2d(channels, channels, 3, padding=1).to(device, DTYPES[name], memory_format=torch.channels_last)  # type: ignore[call-overload]
        image = torch.rand(1, channels, side, side, device=device).to(DTYPES[name], memory_format=torch.channels_last)
        giga = repeats * 9 * channels**2 * side**2 / 1e9
        yield f"convolution, {name}", partial(_repeated, layer, image, repeats), giga, "10^9 multiply-adds"
    source = torch.ones(2**26, device=device)
    target = torch.empty_like(source)
    yield "copy", partial(target.copy_, source), 2 * source.numel() * 4 / 1e9, "GB"


@torch.inference_mode()
def _repeated(layer: nn.Module, image: Tensor, repeats: int) -> Tensor:
    for _ in range(repeats):
        result: Tensor = layer(image)
    return result
