"""Splitting of training batches over several processes, with the same result as training in one process.

Every process draws the crops of the whole batch and loads its own part of them. Choices for a whole batch (the light
of its samples, whether it has the references' renders) are the same in every process. Torch's
``DistributedSampler`` would draw other crops than a single process, and would choose the light for each part anew.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, islice
from typing import Any, TypeVar

import torch
from torch.utils.data import Dataset, Sampler

from gaussian_enhancer.errors import InputError

T = TypeVar("T")


@dataclass(frozen=True)
class ProcessShare:
    """Position of a process's part in the whole batch.

    Args:
        crops: sample and seed of every crop of the whole batch.
        start: index of the first crop of this part.
    """

    crops: tuple[tuple[int, int], ...]
    start: int


class SharedBatches(Sampler[list[tuple[int, int, ProcessShare]]]):
    """One process's part of every batch: sample, seed and share of each crop.

    Args:
        draw: sampler of sample and seed of all crops, the same in every process.
        size: size of a whole batch.
        rank: rank of this process.
        ranks: number of processes.

    Raises:
        InputError: a batch cannot be split evenly, so that crops would have unequal weights.
    """

    def __init__(self, draw: Sampler[tuple[int, int]], size: int, rank: int, ranks: int) -> None:
        if size % ranks:
            raise InputError(
                "data.loading.batch_size", f"is {size} for {ranks} processes", "give a multiple of the processes"
            )
        self.draw, self.size, self.rank, self.ranks = draw, size, rank, ranks

    def __len__(self) -> int:
        return len(self.draw) // self.size  # type: ignore[arg-type]

    def __iter__(self) -> Iterator[list[tuple[int, int, ProcessShare]]]:
        share_size, crops = self.size // self.ranks, iter(self.draw)
        while len(batch := tuple(islice(crops, self.size))) == self.size:
            share = ProcessShare(batch, self.rank * share_size)
            yield [(*crop, share) for crop in batch[share.start : share.start + share_size]]


class SharedCrops(Dataset[tuple[tuple, ProcessShare]]):
    """Dataset of crops by (sample, seed, share), which also returns the share.

    Args:
        crops: dataset of crops by (sample, seed).
    """

    def __init__(self, crops: Dataset[tuple]) -> None:
        self.crops = crops

    def __getitem__(self, index: tuple[int, int, ProcessShare]) -> tuple[tuple, ProcessShare]:
        position, seed, share = index
        return self.crops[position, seed], share


def gather(items: Sequence[T]) -> list[T]:
    """Concatenate the lists of all processes, in every process; with one process, return its own list."""
    if not (torch.distributed.is_available() and torch.distributed.is_initialized()):
        return list(items)
    lists: list[Any] = [None] * torch.distributed.get_world_size()
    torch.distributed.all_gather_object(lists, list(items))
    return list(chain.from_iterable(lists))
