"""Random numbers for batches, in which each sample has its own generator.

Numbers are drawn in single precision on the CPU and then converted, so that a seed gives the same numbers on every
device and for every dtype. Axes: b batch, then the requested shape.
"""

import hashlib
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor


def spawn(count: int, generator: torch.Generator) -> tuple[torch.Generator, ...]:
    """Make generators for the samples of a batch, seeded from one generator.

    Args:
        count: size of the batch.
        generator: source of the seeds, on the CPU.
    """
    seeds = torch.randint(2**62, (count,), generator=generator).tolist()
    return tuple(torch.Generator().manual_seed(seed) for seed in seeds)


def named_generator(name: str, seed: int) -> torch.Generator:
    """Make a generator from a name and a seed, independent of the generators of other names.

    Args:
        name: purpose of the random numbers, for instance a type of artefact.
        seed: seed of the sample.
    """
    digest = hashlib.sha256(f"{name} {seed}".encode()).digest()
    return torch.Generator().manual_seed(int.from_bytes(digest[:8], "big"))


def uniform(
    low: float, high: float, shape: Sequence[int], generators: Sequence[torch.Generator], like: Tensor
) -> Float[Tensor, "b ..."]:
    """Independent random numbers, uniform in [low, high).

    Args:
        low: lower limit, included.
        high: upper limit, excluded.
        shape: shape of the numbers of one sample.
        generators: one for each sample.
        like: a tensor with the dtype and device of the result.
    """
    values = torch.stack([torch.rand(tuple(shape), generator=generator) for generator in generators])
    return low + (high - low) * values.to(like)


def normal(shape: Sequence[int], generators: Sequence[torch.Generator], like: Tensor) -> Float[Tensor, "b ..."]:
    """Independent random numbers from the standard normal distribution.

    Args:
        shape: shape of the numbers of one sample.
        generators: one for each sample.
        like: a tensor with the dtype and device of the result.
    """
    return torch.stack([torch.randn(tuple(shape), generator=generator) for generator in generators]).to(like)


def whole_numbers(low: int, high: int, generators: Sequence[torch.Generator]) -> list[int]:
    """A random whole number for each sample, from ``low`` to ``high``, both included."""
    return [int(torch.randint(low, high + 1, (), generator=generator)) for generator in generators]
