"""Dataset of seeded crops, their collation into batches, and the sampler that draws them."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import torch
from torch.utils.data import Dataset, Sampler

from gaussian_enhancer.train.augment import Augmentation
from gaussian_enhancer.train.samples import PLANES_PER_FINE_IMAGE, Sample, make_batch
from gaussian_enhancer.train.share import ProcessShare
from gaussian_enhancer.train.simulated import Simulation
from gaussian_enhancer.types import Batch


class Crops(Dataset[tuple]):
    """Crops by (sample, seed): the same pair always gives the same crop.

    Args:
        samples: samples that crops are cut from.
        augmentation: how they are cut, and which references are kept.
    """

    def __init__(self, samples: Sequence[Sample], augmentation: Augmentation) -> None:
        self.samples, self.augmentation = samples, augmentation

    def __len__(self) -> int:
        return len(self.samples)

    def __getitem__(self, index: tuple[int, int]) -> tuple:
        """Planes of a crop, its sample, its seed, and the same crop of the fine planes if the sample has them."""
        position, seed = index
        generator = torch.Generator().manual_seed(seed)
        sample = self.samples[position]
        planes = self.augmentation.random_crop(sample.planes(), generator)
        item = self.augmentation.drop_references(planes, generator), sample, seed
        fine_planes = sample.fine_planes()
        if fine_planes is None:
            return item
        generator.manual_seed(seed)
        fine_planes = self.augmentation.random_crop(fine_planes, generator, finer=4)
        return *item, self.augmentation.drop_references(
            fine_planes, generator, PLANES_PER_FINE_IMAGE, PLANES_PER_FINE_IMAGE
        )


@dataclass(frozen=True)
class Collate:
    """Collates crops into a batch: renders are simulated where chosen, then light and exposure are varied.

    Args:
        references: number of references per sample; missing ones are filled with zeros.
        augmentation: how light and exposure are varied.
        simulation: chooses the crops whose renders are simulated, and simulates them; None for no simulation.
    """

    references: int
    augmentation: Augmentation
    simulation: Simulation | None = None

    def __call__(self, items: list[tuple], share: ProcessShare | None = None, has_renders: bool = True) -> Batch:
        """A whole batch, or one process's share of it.

        Args:
            items: planes, sample, seed and, where all have them, fine planes of each crop, as `Crops` returns them.
            share: position of these crops in the whole batch; None if they are the whole batch.
            has_renders: whether the splat's renders of the references' views are known for the whole batch.
        """
        planes, samples, seeds, *fine = zip(*items, strict=True)
        batch = make_batch(planes, samples, self.references, *fine)
        if not has_renders:
            batch = replace(batch, views=replace(batch.views, reference_renders=None))
        if self.simulation is not None:
            batch = self.simulation(batch, samples, seeds)
        if share is None:
            return self.augmentation.relight(batch, torch.Generator().manual_seed(seeds[0]))
        generator = torch.Generator().manual_seed(share.crops[0][1])
        return self.augmentation.relight(batch, generator, share.start, len(share.crops))


@dataclass(frozen=True)
class SharedCollate:
    """Collates one process's share of a batch, so that it equals this part of the whole batch.

    Args:
        collate: collates whole batches.
        samples: all samples that crops are cut from.
    """

    collate: Collate
    samples: Sequence[Sample]

    def __call__(self, items: list[tuple[tuple, ProcessShare]]) -> Batch:
        """The share as a batch.

        Args:
            items: crops, as `SharedCrops` returns them.
        """
        crops, (share, *_) = zip(*items, strict=True)
        has_renders = all(self.samples[position].has_reference_renders for position, _ in share.crops)
        return self.collate(list(crops), share, has_renders)


def never_simulated(seed: int) -> bool:
    """Return False for every seed: no crop is simulated."""
    return False


class BalancedDraw(Sampler[tuple[int, int]]):
    """Draws a source, one of its samples, and a seed for the crop. Every source is drawn equally often on average.

    Args:
        sizes: number of samples of each source; the dataset holds the sources one after another.
        count: draws per epoch.
        seed: seed of the first epoch; each later epoch adds 1.
        extra_sizes: number of additional samples of each source, stored after its ordinary ones and drawn for simulated
            crops only; 0 by default.
        simulated: whether the crop of a seed is simulated.
        count_used: returns the number of crops used before the current epoch, so that a resumed training
            continues with the next crop; None counts completed epochs instead.
    """

    def __init__(
        self,
        sizes: Sequence[int],
        count: int,
        seed: int,
        extra_sizes: Sequence[int] = (),
        simulated: Callable[[int], bool] = never_simulated,
        count_used: Callable[[], int] | None = None,
    ) -> None:
        self.sizes, self.count, self.seed, self.passes, self.count_used = list(sizes), count, seed, 0, count_used
        self.extra_sizes = list(extra_sizes) or [0] * len(self.sizes)
        self.simulated = simulated

    def __len__(self) -> int:
        return self.count

    def __iter__(self) -> Iterator[tuple[int, int]]:
        epoch, used = divmod(self.count_used() if self.count_used is not None else self.passes * self.count, self.count)
        generator = torch.Generator().manual_seed(1_000_003 * (self.seed + epoch))
        self.passes += 1
        starts = [sum(self.sizes[:i]) + sum(self.extra_sizes[:i]) for i in range(len(self.sizes))]
        for position in range(self.count):
            source, seed = torch.randint(2**31, (2,), generator=generator).tolist()
            choice = int(torch.randint(2**31, (), generator=generator))
            source %= len(self.sizes)
            size = self.sizes[source] + (self.extra_sizes[source] if self.simulated(seed) else 0)
            if position >= used:
                yield starts[source] + choice % size, seed
