"""Crops by seed, batches of them, and the order in which they are drawn."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import torch
from torch.utils.data import Dataset, Sampler

from gaussian_enhancer.train.augment import Augmentation
from gaussian_enhancer.train.samples import FINE, Sample, batch_of
from gaussian_enhancer.train.share import ProcessShare
from gaussian_enhancer.train.simulated import Simulation
from gaussian_enhancer.types import Batch


class Crops(Dataset[tuple]):
    """Crops by (sample, seed): the same pair always gives the same crop.

    Args:
        samples: what is cut from.
        augmentation: how.
    """

    def __init__(self, samples: Sequence[Sample], augmentation: Augmentation) -> None:
        self.samples, self.augmentation = samples, augmentation

    def __len__(self) -> int:
        return len(self.samples)

    def __getitem__(self, index: tuple[int, int]) -> tuple:
        """Planes of a crop, its sample and its seed, and the same crop of the fine planes where it has them."""
        number, seed = index
        generator = torch.Generator().manual_seed(seed)
        sample = self.samples[number]
        planes = self.augmentation.cut(sample.planes(), generator)
        item = self.augmentation.drop(planes, generator), sample, seed
        fine = sample.fine_planes()
        if fine is None:
            return item
        generator.manual_seed(seed)
        fine = self.augmentation.cut(fine, generator, finer=4)
        return *item, self.augmentation.drop(fine, generator, FINE, FINE)


@dataclass(frozen=True)
class Collate:
    """Crops to a batch: simulated where they are to be, then relit.

    Args:
        references: places for references.
        augmentation: how samples are relit.
        simulation: which crops' renders are simulated, and by what; None for none.
    """

    references: int
    augmentation: Augmentation
    simulation: Simulation | None = None

    def __call__(self, items: list[tuple], share: ProcessShare | None = None, has_renders: bool = True) -> Batch:
        """A batch, or a share of one.

        Args:
            items: planes, sample, seed and, where all have them, fine planes of each crop, as `Crops` gives them.
            share: the whole batch that the crops are a share of; None where they are all of it.
            has_renders: whether the splat's renders of the references' views are known for the whole batch.
        """
        planes, samples, seeds, *fine = zip(*items, strict=True)
        batch = batch_of(planes, samples, self.references, *fine)
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
    """Batch one process's share of crops as the whole batch would be, cut to the share.

    Args:
        collate: of whole batches.
        samples: all that crops are cut from.
    """

    collate: Collate
    samples: Sequence[Sample]

    def __call__(self, items: list[tuple[tuple, ProcessShare]]) -> Batch:
        """A batch.

        Args:
            items: crops, as `SharedCrops` gives them.
        """
        crops, (share, *_) = zip(*items, strict=True)
        has_renders = all(self.samples[number].has_reference_renders for number, _ in share.crops)
        return self.collate(list(crops), share, has_renders)


def never(seed: int) -> bool:
    """No crop is simulated."""
    return False


class BalancedDraw(Sampler[tuple[int, int]]):
    """Draws a source, then one of its samples, then a seed for the crop.

    Args:
        sizes: samples of each source, which lie one after another.
        count: draws of an epoch.
        seed: of the first epoch; each epoch takes the next.
        further: samples of each source that follow its own and are drawn for simulated crops alone; none by default.
        simulated: whether the crop of a seed is simulated.
        drawn: how many crops training has had when a pass begins, so that a resumed one goes on with those that it
            has not seen; None counts whole passes.
    """

    def __init__(
        self,
        sizes: Sequence[int],
        count: int,
        seed: int,
        further: Sequence[int] = (),
        simulated: Callable[[int], bool] = never,
        drawn: Callable[[], int] | None = None,
    ) -> None:
        self.sizes, self.count, self.seed, self.passes, self.drawn = list(sizes), count, seed, 0, drawn
        self.further = list(further) or [0] * len(self.sizes)
        self.simulated = simulated

    def __len__(self) -> int:
        return self.count

    def __iter__(self) -> Iterator[tuple[int, int]]:
        epoch, seen = divmod(self.drawn() if self.drawn is not None else self.passes * self.count, self.count)
        generator = torch.Generator().manual_seed(1_000_003 * (self.seed + epoch))
        self.passes += 1
        starts = [sum(self.sizes[:i]) + sum(self.further[:i]) for i in range(len(self.sizes))]
        for number in range(self.count):
            source, seed = torch.randint(2**31, (2,), generator=generator).tolist()
            inside = int(torch.randint(2**31, (), generator=generator))
            source %= len(self.sizes)
            size = self.sizes[source] + (self.further[source] if self.simulated(seed) else 0)
            if number >= seen:
                yield starts[source] + inside % size, seed
