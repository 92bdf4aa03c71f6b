"""The share of a training for each of several processes, whose sum equals a training in one process.

A step's crops are drawn for all; each process makes its own part of them. What is drawn for a batch as a whole (the
light of its samples, whether references' renders are known) follows from the whole batch in every process. Torch's
``DistributedSampler`` would give each process other crops than one process has, and a batch's light to each share.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import torch
from torch.utils.data import Dataset, Sampler

from gaussian_enhancer.errors import InputError

T = TypeVar("T")


@dataclass(frozen=True)
class ProcessShare:
    """The position of a part in its whole batch.

    Args:
        crops: sample and seed of every crop of the whole batch.
        start: the first of them that is in this part.
    """

    crops: tuple[tuple[int, int], ...]
    start: int


class SharedBatches(Sampler[list[tuple[int, int, ProcessShare]]]):
    """One process's part of every batch: sample, seed and share of each crop.

    Args:
        draw: sample and seed of all crops, the same in every process.
        size: of a whole batch.
        rank: the process.
        ranks: how many there are.

    Raises:
        InputError: a batch cannot be split evenly, so that crops would weigh differently.
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
        part, batch = self.size // self.ranks, []
        for crop in self.draw:
            batch.append(crop)
            if len(batch) == self.size:
                share = ProcessShare(tuple(batch), self.rank * part)
                yield [(*own, share) for own in batch[share.start : share.start + part]]
                batch = []


class SharedCrops(Dataset[tuple[tuple, ProcessShare]]):
    """Crops by (sample, seed, share), with the share passed on.

    Args:
        crops: by (sample, seed).
    """

    def __init__(self, crops: Dataset[tuple]) -> None:
        self.crops = crops

    def __getitem__(self, index: tuple[int, int, ProcessShare]) -> tuple[tuple, ProcessShare]:
        number, seed, share = index
        return self.crops[number, seed], share


def gather(own: Sequence[T]) -> list[T]:
    """Gather a value from all processes in each of them; with one process, its own value."""
    if not (torch.distributed.is_available() and torch.distributed.is_initialized()):
        return list(own)
    every: list[Any] = [None] * torch.distributed.get_world_size()
    torch.distributed.all_gather_object(every, list(own))
    return [one for part in every for one in part]
