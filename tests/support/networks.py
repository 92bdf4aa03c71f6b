"""Small networks, random views to enhance, and what modules read: in which order and of which shape."""

from collections.abc import Callable, Mapping
from contextlib import contextmanager
from typing import TypeVar

import torch
from torch import nn

from gaussian_enhancer.network.sif import SIF
from gaussian_enhancer.types import NetworkInput

N = TypeVar("N", bound=nn.Module)


def views(
    height: int = 24,
    width: int = 40,
    references: int = 2,
    batch: int = 1,
    seed: int = 0,
    *,
    visible: bool = False,
    renders: bool = False,
    fine: bool = False,
) -> NetworkInput:
    """Random views.

    Args:
        height: of the targets, in pixels.
        width: of the targets, in pixels.
        references: how many each target has.
        batch: how many targets there are.
        seed: of the random numbers.
        visible: whether references are visible everywhere; their visibility is random otherwise.
        renders: whether the references' renders are known.
        fine: whether references are known at four times the resolution, too.
    """
    generator = torch.Generator().manual_seed(seed)

    def rand(*shape: int) -> torch.Tensor:
        return torch.rand(batch, *shape, generator=generator)

    return NetworkInput(
        rand(3, height, width),
        rand(references, 3, height, width),
        torch.ones(batch, references, 1, height, width) if visible else rand(references, 1, height, width),
        1 + rand(1, height, width),
        rand(1, height, width),
        reference_renders=rand(references, 3, height, width) if renders else None,
        fine_references=rand(references, 3, 4 * height, 4 * width) if fine else None,
    )


def visible_views(height: int = 32, width: int = 64, *, fine: bool = False) -> NetworkInput:
    """Random views whose references are visible everywhere."""
    return views(height, width, visible=True, fine=fine)


def small_sif(**choices: object) -> SIF:
    return SIF(widths=(16, 16, 24), blocks=(1, 1, 1), **choices)


def trained(make: Callable[..., N] = small_sif, *args: object, **choices: object) -> N:
    """A network, made from the given choices, whose zero-initialised layers have been moved."""
    torch.manual_seed(1)
    network = make(*args, **choices)
    for parameter in network.parameters():
        parameter.data += 0.05 * torch.randn_like(parameter)
    return network.eval()


@contextmanager
def recorded(named: Mapping[str, nn.Module]):
    """Calls of modules in their order: each its name, the shapes that it reads, and the shape that it gives."""
    calls: list[tuple[str, tuple[tuple[int, ...], ...], tuple[int, ...]]] = []

    def hook(name: str) -> Callable[..., None]:
        def note(_, inputs, output):
            calls.append((name, tuple(tuple(one.shape) for one in inputs if one is not None), tuple(output.shape)))

        return note

    handles = [module.register_forward_hook(hook(name)) for name, module in named.items()]
    try:
        yield calls
    finally:
        for handle in handles:
            handle.remove()
