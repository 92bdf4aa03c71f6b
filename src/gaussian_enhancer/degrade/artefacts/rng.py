"""Random numbers for batches: each sample has a generator of its own.

Numbers are drawn in single precision on the CPU and moved, so that a seed means the same on every device and for every
type. Axes: b batch, then whatever shape was asked for.
"""

import hashlib
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor


def spawn(count: int, generator: torch.Generator) -> tuple[torch.Generator, ...]:
    """Generators for the samples of a batch, seeded from one.

    Args:
        count: size of the batch.
        generator: source of the seeds, on the CPU.
    """
    seeds = torch.randint(2**62, (count,), generator=generator).tolist()
    return tuple(torch.Generator().manual_seed(seed) for seed in seeds)


def named_generator(name: str, seed: int) -> torch.Generator:
    """A generator derived from a name and a seed, independent of those of other names.

    Args:
        name: of what is drawn, for instance a type of artefact.
        seed: of the sample.
    """
    digest = hashlib.sha256(f"{name} {seed}".encode()).digest()
    return torch.Generator().manual_seed(int.from_bytes(digest[:8], "big"))


def uniform(
    low: float, high: float, shape: Sequence[int], generators: Sequence[torch.Generator], like: Tensor
) -> Float[Tensor, "b ..."]:
    """Independent numbers, uniform in [low, high).

    Args:
        low: lower end.
        high: upper end.
        shape: of one sample's numbers.
        generators: one for each sample.
        like: a tensor whose type and device the result has.
    """
    values = torch.stack([torch.rand(tuple(shape), generator=generator) for generator in generators])
    return low + (high - low) * values.to(like)


def normal(shape: Sequence[int], generators: Sequence[torch.Generator], like: Tensor) -> Float[Tensor, "b ..."]:
    """Independent numbers from the standard normal distribution.

    Args:
        shape: of one sample's numbers.
        generators: one for each sample.
        like: a tensor whose type and device the result has.
    """
    return torch.stack([torch.randn(tuple(shape), generator=generator) for generator in generators]).to(like)


def whole_numbers(low: int, high: int, generators: Sequence[torch.Generator]) -> list[int]:
    """A whole number for each sample, from ``low`` to ``high``, both included."""
    return [int(torch.randint(low, high + 1, (), generator=generator)) for generator in generators]
