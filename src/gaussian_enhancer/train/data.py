"""Fitted runs as training data."""

import glob
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import torch
from lightning import LightningDataModule
from torch.utils.data import DataLoader, Dataset, Sampler

from gaussian_enhancer.enhance.prepare import Preparation
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.renders import read_run, run_steps
from gaussian_enhancer.train.augment import Augmentation
from gaussian_enhancer.train.samples import Sample, batch_of, prepare_samples
from gaussian_enhancer.types import Batch


class RunsData(LightningDataModule):
    """Held-out views of fitted runs: random crops to train on, whole images to validate on.

    Args:
        train: patterns of run folders. Each pattern is one source and is drawn from equally often, however many
            runs and views it names, so that a large source does not drown the others.
        validation: patterns of run folders that are only measured on.
        preparation: how references are aligned; each (target, reference) pair is warped once and cached.
        cache: folder for prepared samples.
        augmentation: what training varies.
        batch_size: crops in a step.
        steps_per_epoch: steps between two validations.
        snapshots: take the renders of all of a run's snapshots (weak fits teach most), or of the last alone.
        validation_views: at most so many whole images, spread evenly over those that there are.
        workers: processes that load crops; threads that prepare samples, at least one.
        seed: of crops and their order.
        progress: show a bar while samples are prepared.
    """

    def __init__(
        self,
        train: Sequence[str],
        validation: Sequence[str],
        preparation: Preparation,
        cache: str | Path,
        augmentation: Augmentation | None = None,
        batch_size: int = 4,
        steps_per_epoch: int = 500,
        snapshots: bool = True,
        validation_views: int = 24,
        workers: int = 0,
        seed: int = 0,
        progress: bool = True,
    ) -> None:
        super().__init__()
        self.patterns = {"train": list(train), "validation": list(validation)}
        self.preparation, self.cache = preparation, Path(cache)
        self.augmentation = Augmentation() if augmentation is None else augmentation
        self.batch_size, self.steps_per_epoch = batch_size, steps_per_epoch
        self.snapshots, self.validation_views = snapshots, validation_views
        self.workers, self.seed, self.progress = workers, seed, progress
        self.sources: list[list[Sample]] = []
        self.held_out: list[Sample] = []

    def prepare_data(self) -> None:
        """Warp all references of all samples, unless the cache has them."""
        self.setup()

    def setup(self, stage: str | None = None) -> None:
        """List the samples.

        Raises:
            InputError: a pattern names no run.
        """
        if not self.sources:
            self._collect()

    def train_dataloader(self) -> DataLoader[Any]:
        """Random crops; every epoch's differ, and are the same for the same seed."""
        crops = Crops([sample for source in self.sources for sample in source], self.augmentation)
        epoch = self.trainer.current_epoch if self.trainer is not None else 0
        draw = BalancedDraw([len(s) for s in self.sources], self.batch_size * self.steps_per_epoch, self.seed + epoch)

        def collate(items: list[tuple]) -> Batch:
            planes, samples, seeds = zip(*items, strict=True)
            batch = batch_of(planes, samples, self.preparation.references)
            return self.augmentation.relight(batch, torch.Generator().manual_seed(seeds[0]))

        return DataLoader(
            crops, self.batch_size, sampler=draw, collate_fn=collate, num_workers=self.workers, drop_last=True
        )

    def val_dataloader(self) -> DataLoader[Any]:
        """Whole images, one by one."""
        every = max(1, -(-len(self.held_out) // max(1, self.validation_views)))
        chosen = self.held_out[::every]
        references = self.preparation.references
        return DataLoader(
            chosen,  # type: ignore[arg-type]
            batch_size=1,
            collate_fn=lambda items: batch_of([items[0].planes()], items, references),
        )

    def _collect(self) -> None:
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

        runs = {side: [find_runs(pattern) for pattern in patterns] for side, patterns in self.patterns.items()}
        train, held_out = ({run for group in runs[side] for run in group} for side in ("train", "validation"))
        if train & held_out:
            both = sorted(train & held_out)[0]
            raise InputError(both, "is both trained and validated on", "name disjoint runs")
        bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            disable=not self.progress,
        )
        with bar:
            task = bar.add_task("warping references", total=None)
            self.sources = [self._samples(group, bar, task) for group in runs["train"]]
            self.held_out = [sample for group in runs["validation"] for sample in self._samples(group, bar, task)]

    def _samples(self, runs: Sequence[Path], bar, task) -> list[Sample]:  # type: ignore[no-untyped-def]
        found: list[Sample] = []
        for run in runs:
            steps = run_steps(run)
            for step in steps if self.snapshots else steps[-1:]:
                rendered = read_run(run, step)
                identity = f"{run.resolve()} {step} {(run / f'test/ours_{step}/renders').stat().st_mtime_ns}"
                found += prepare_samples(
                    rendered, self.preparation, self.cache, identity, max(1, self.workers), lambda: bar.advance(task)
                )
        return found


def find_runs(pattern: str) -> list[Path]:
    """The run folders with held-out renders that a pattern names, sorted.

    Raises:
        InputError: there is none, or one of them is a fit that was not finished.
    """
    runs = sorted(Path(found) for found in glob.glob(pattern, recursive=True) if run_steps(Path(found)))
    if not runs:
        raise InputError(pattern, "names no run with held-out renders", "fit scenes first, or correct the pattern")
    for run in runs:
        if (run / "config.yaml").is_file() and not (run / "done").is_file():
            raise InputError(run, "is a fit that was not finished", "start the same fit again, or delete the folder")
    return runs


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
        """Planes of a crop, its sample and its seed."""
        number, seed = index
        generator = torch.Generator().manual_seed(seed)
        sample = self.samples[number]
        planes = self.augmentation.cut(sample.planes(), generator)
        return self.augmentation.drop(planes, generator), sample, seed


class BalancedDraw(Sampler[tuple[int, int]]):
    """Draws a source, then one of its samples, then a seed for the crop.

    Args:
        sizes: samples of each source, which lie one after another.
        count: draws of an epoch.
        seed: of the first epoch; each pass takes the next.
    """

    def __init__(self, sizes: Sequence[int], count: int, seed: int) -> None:
        self.sizes, self.count, self.seed, self.passes = list(sizes), count, seed, 0

    def __len__(self) -> int:
        return self.count

    def __iter__(self) -> Iterator[tuple[int, int]]:
        generator = torch.Generator().manual_seed(1_000_003 * (self.seed + self.passes))
        self.passes += 1
        starts = [sum(self.sizes[:i]) for i in range(len(self.sizes))]
        for _ in range(self.count):
            source, seed = torch.randint(2**31, (2,), generator=generator).tolist()
            inside = int(torch.randint(2**31, (), generator=generator))
            source %= len(self.sizes)
            yield starts[source] + inside % self.sizes[source], seed
