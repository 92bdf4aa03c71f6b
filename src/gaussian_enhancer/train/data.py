"""Lightning data module of both trainings: samples of fitted runs, and photos with simulated renders."""

from collections.abc import Sequence
from dataclasses import dataclass
from multiprocessing import current_process
from typing import Any

from lightning import LightningDataModule
from lightning.pytorch.overrides.distributed import UnrepeatedDistributedSampler
from rich.progress import MofNCompleteColumn, TimeRemainingColumn
from torch.utils.data import DataLoader

from gaussian_enhancer.console import progress_bar
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.frozen import refuse_frozen, refuse_untrained
from gaussian_enhancer.train.augment import Augmentation
from gaussian_enhancer.train.crops import BalancedDraw, Collate, Crops, SharedCollate, never_simulated
from gaussian_enhancer.train.non_finite import refuse_bad
from gaussian_enhancer.train.run_samples import RunSamples, find_runs
from gaussian_enhancer.train.samples import Sample, make_batch
from gaussian_enhancer.train.share import SharedBatches, SharedCrops
from gaussian_enhancer.train.simulated import Simulation
from gaussian_enhancer.types import Batch


@dataclass(frozen=True)
class Loading:
    """How crops are drawn and loaded.

    Args:
        batch_size: crops per step, over all processes together.
        workers: processes that load crops, per training process; also the number of threads that prepare samples, at
            least one. A daemonic process, such as one of the suite's, may not start processes: it loads the same crops
            itself.
        seed: seed of the crops and their order.
    """

    batch_size: int = 4
    workers: int = 0
    seed: int = 0


class RunsData(LightningDataModule):
    """Held-out views of fitted runs: random crops to train on, whole images to validate on.

    Where several processes train together, each takes its part of every batch and of the validation images.

    Args:
        train: patterns of run folders. Each pattern is one source. Sources are drawn equally often, however many runs
            and views they have, so that a large source does not dominate.
        validation: patterns of run folders used for validation only.
        samples: how a run becomes samples.
        loading: batch size, worker processes and seed; None takes the defaults.
        augmentation: augmentation of the crops; None takes the defaults.
        simulation: simulation of renders from photos; None for no simulation.
        steps_per_epoch: steps between two validations.
        validation_views: maximum number of validation images, spread evenly over the available ones.
    """

    def __init__(
        self,
        train: Sequence[str],
        validation: Sequence[str],
        samples: RunSamples,
        loading: Loading | None = None,
        augmentation: Augmentation | None = None,
        simulation: Simulation | None = None,
        steps_per_epoch: int = 500,
        validation_views: int = 24,
    ) -> None:
        super().__init__()
        self.patterns = {"train": list(train), "validation": list(validation)}
        self.samples, self.simulation = samples, simulation
        self.loading = Loading() if loading is None else loading
        self.augmentation = Augmentation() if augmentation is None else augmentation
        self.steps_per_epoch, self.validation_views = steps_per_epoch, validation_views
        self.sources: list[list[Sample]] = []
        self.held_out: list[Sample] = []

    def prepare_data(self) -> None:
        """Prepare all samples that are not yet in the cache: warp their references."""
        self.setup()

    def setup(self, stage: str | None = None) -> None:
        """Prepare the samples or read them from the cache.

        Raises:
            InputError: a pattern matches no run, a run is used for both training and validation, or too many samples
                are not finite.
        """
        if not self.sources:
            self._collect()

    def train_dataloader(self) -> DataLoader[Any]:
        """Random crops, different in every epoch. They depend on the seed only, even if training is resumed."""
        crops = Crops([sample for source in self.sources for sample in source], self.augmentation)
        held_out_counts = [sum(sample.held_out for sample in source) for source in self.sources]
        training_view_counts = [sum(not sample.held_out for sample in source) for source in self.sources]
        simulated = never_simulated if self.simulation is None else self.simulation.is_simulated
        batch_size, workers = self.loading.batch_size, 0 if current_process().daemon else self.loading.workers
        count = batch_size * self.steps_per_epoch
        sampler = BalancedDraw(
            held_out_counts, count, self.loading.seed, training_view_counts, simulated, self._used_crops
        )
        collate = Collate(self.samples.reference_config.references, self.augmentation, self.simulation)
        rank, ranks = self._rank_and_world_size()
        if ranks > 1:
            batches = SharedBatches(sampler, batch_size, rank, ranks)
            shared_collate = SharedCollate(collate, crops.samples)
            return DataLoader(SharedCrops(crops), batch_sampler=batches, collate_fn=shared_collate, num_workers=workers)
        return DataLoader(crops, batch_size, sampler=sampler, collate_fn=collate, num_workers=workers, drop_last=True)

    def val_dataloader(self) -> DataLoader[Any]:
        """Whole images, in batches of one."""
        stride = max(1, -(-len(self.held_out) // max(1, self.validation_views)))
        chosen = self.held_out[::stride]
        references = self.samples.reference_config.references
        simulation = self.simulation if self.simulation is not None and self.simulation.validation else None

        def collate(items: list[tuple[int, Sample]]) -> Batch:
            ((seed, sample),) = items
            batch = make_batch([sample.planes()], [sample], references, [sample.fine_planes()])
            return batch if simulation is None else simulation(batch, [sample], [seed])

        rank, ranks = self._rank_and_world_size()
        views: Any = list(enumerate(chosen))
        # Torch's DistributedSampler would repeat views until all processes have equally many, which changes the mean.
        sampler = UnrepeatedDistributedSampler(views, ranks, rank, shuffle=False)
        return DataLoader(views, batch_size=1, sampler=sampler, collate_fn=collate)

    def _used_crops(self) -> int:
        """Number of crops that the training has used so far."""
        return 0 if self.trainer is None else int(self.trainer.global_step) * self.loading.batch_size

    def _rank_and_world_size(self) -> tuple[int, int]:
        """Rank of this process, and the number of training processes."""
        return (0, 1) if self.trainer is None else (self.trainer.global_rank, self.trainer.world_size)

    def _collect(self) -> None:
        """Prepare the samples of all runs, and remove those that are not finite."""
        runs = {side: [find_runs(pattern) for pattern in patterns] for side, patterns in self.patterns.items()}
        train_runs, validation_runs = (
            {run for group in runs[side] for run in group} for side in ("train", "validation")
        )
        refuse_untrained(sorted(train_runs))
        refuse_frozen(sorted(validation_runs))
        if train_runs & validation_runs:
            shared_run = sorted(train_runs & validation_runs)[0]
            raise InputError(shared_run, "is both trained and validated on", "name disjoint runs")
        training_views = self.simulation is not None and self.simulation.training_views
        with progress_bar(MofNCompleteColumn(), TimeRemainingColumn(), hidden=not self.samples.progress) as bar:
            task = bar.add_task("warping references", total=None)
            options = max(1, self.loading.workers), lambda: bar.advance(task)
            for group in runs["train"]:
                source = [sample for run in group for sample in self.samples.held_out(run, *options)]
                if training_views:
                    source += [sample for run in group for sample in self.samples.training_views(run, *options)]
                self.sources.append(source)
            validated = [run for group in runs["validation"] for run in group]
            self.held_out = [sample for run in validated for sample in self.samples.held_out(run, *options)]
        self._remove_non_finite()

    def _remove_non_finite(self) -> None:
        """Remove the samples that are not finite.

        Raises:
            InputError: too many samples are not finite, or all of a source or of the validation.
        """
        samples = [sample for source in (*self.sources, self.held_out) for sample in source]
        bad = [f"{sample.name}: its {sample.bad} is not finite" for sample in samples if sample.bad]
        refuse_bad(bad, len(samples), self.samples.bad_share)
        for source in (*self.sources, self.held_out):
            held_out = [sample for sample in source if sample.held_out]
            if held_out and all(sample.bad for sample in held_out):
                raise InputError(held_out[0].name, "and all others of its runs are not finite", "leave these runs out")
        self.sources = [[sample for sample in source if not sample.bad] for source in self.sources]
        self.held_out = [sample for sample in self.held_out if not sample.bad]
