"""What a network reads, in which order and of which shape."""

from collections.abc import Callable, Mapping
from contextlib import contextmanager
from typing import TypeVar

import torch
from torch import nn

from gaussian_enhancer.types import NetworkInput

N = TypeVar("N", bound=nn.Module)


def views(height: int = 32, width: int = 64, references: int = 2, fine: bool = False, seed: int = 0) -> NetworkInput:
    generator = torch.Generator().manual_seed(seed)

    def rand(*shape):
        return torch.rand(*shape, generator=generator)

    return NetworkInput(
        rand(1, 3, height, width),
        rand(1, references, 3, height, width),
        torch.ones(1, references, 1, height, width),
        1 + rand(1, 1, height, width),
        rand(1, 1, height, width),
        fine_references=rand(1, references, 3, 4 * height, 4 * width) if fine else None,
    )


def trained(make: Callable[[], N]) -> N:
    """A network whose zero-initialised layers have been moved."""
    torch.manual_seed(1)
    network = make()
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
