"""Fitted runs as training data, and photos whose renders are simulated."""

import dataclasses
import glob
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from lightning import LightningDataModule
from lightning.pytorch.overrides.distributed import UnrepeatedDistributedSampler
from torch.utils.data import DataLoader

from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.degrade.simulator import Simulator
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.frozen import refuse_frozen
from gaussian_enhancer.scene.rendered import RenderedSet
from gaussian_enhancer.scene.renders import read_run, run_steps
from gaussian_enhancer.train.augment import Augmentation
from gaussian_enhancer.train.crops import BalancedDraw, Collate, Crops, SharedCollate, never
from gaussian_enhancer.train.non_finite import BAD_SHARE, refuse_bad
from gaussian_enhancer.train.samples import Sample, batch_of, prepare_samples, training_targets
from gaussian_enhancer.train.share import SharedBatches, SharedCrops
from gaussian_enhancer.train.simulated import Simulation
from gaussian_enhancer.types import Batch


class RunsData(LightningDataModule):
    """Held-out views of fitted runs: random crops to train on, whole images to validate on.

    Where several processes train together, each takes its part of every batch and of the whole images.

    Args:
        train: patterns of run folders. Each pattern is one source and is drawn from equally often, however many
            runs and views it names, so that a large source does not drown the others.
        validation: patterns of run folders that are only measured on.
        reference_config: how references are aligned; each (target, reference) pair is warped once and cached.
        cache: folder for prepared samples.
        augmentation: what training varies.
        batch_size: crops in a step, of all processes together.
        steps_per_epoch: steps between two validations.
        snapshots: take the renders of all of a run's snapshots (weak fits teach most), or of the last alone.
        validation_views: at most so many whole images, spread evenly over those that there are.
        workers: processes that load crops, for each that trains; threads that prepare samples, at least one.
        seed: of crops and their order.
        progress: show a bar while samples are prepared.
        simulator: makes renders from photos; None where none are made.
        simulated: share of the samples whose render is made by the simulator instead of the fit, from 0 to 1.
        training_views: simulate on the runs' training views too. Their own renders are never used: they were fitted
            to the photos. Without effect where nothing is simulated.
        simulate_validation: validate on simulated renders as well, as the training of a simulator does.
        views_per_run: at most so many held-out views of each run, spread evenly; None takes all.
        finer: gives the views of a run their photos 4 times as fine, where the preparation asks for them.
        bad_share: share of all samples that may be left out for not being finite.

    Raises:
        InputError: the share is out of range, or there is nothing to simulate with.
    """

    def __init__(
        self,
        train: Sequence[str],
        validation: Sequence[str],
        reference_config: ReferenceConfig,
        cache: str | Path,
        augmentation: Augmentation | None = None,
        batch_size: int = 4,
        steps_per_epoch: int = 500,
        snapshots: bool = True,
        validation_views: int = 24,
        workers: int = 0,
        seed: int = 0,
        progress: bool = True,
        simulator: Simulator | None = None,
        simulated: float = 0.0,
        training_views: bool = False,
        simulate_validation: bool = False,
        views_per_run: int | None = None,
        finer: Callable[[Path, RenderedSet], RenderedSet] | None = None,
        bad_share: float = BAD_SHARE,
    ) -> None:
        super().__init__()
        self.patterns = {"train": list(train), "validation": list(validation)}
        self.reference_config, self.cache = reference_config, Path(cache)
        self.augmentation = Augmentation() if augmentation is None else augmentation
        self.batch_size, self.steps_per_epoch = batch_size, steps_per_epoch
        self.snapshots, self.validation_views = snapshots, validation_views
        self.workers, self.seed, self.progress = workers, seed, progress
        self.simulation: Simulation | None = None
        if simulated != 0:
            if simulator is None:
                raise InputError("simulated", f"is {simulated} without a simulator", "give a simulator, or the share 0")
            self.simulation = Simulation(simulator, simulated)
        self.training_views = training_views and self.simulation is not None
        if simulate_validation and training_views:
            # Their own renders were fitted to their photos: no real degradation can be learnt from the pair.
            raise InputError("training_views", "are asked for by a simulator's training", "use held-out views alone")
        self.validated = self.simulation if simulate_validation else None
        if reference_config.fine and finer is None:
            raise InputError("reference_config.fine", "is asked for", "tell with finer= where fine photos come from")
        if views_per_run is not None and views_per_run < 1:
            raise InputError("views_per_run", f"is {views_per_run}", "give at least 1")
        self.views_per_run, self.finer, self.bad_share = views_per_run, finer, bad_share
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
        """Random crops; every epoch's differ, and are the same for the same seed, however often training was killed."""
        crops = Crops([sample for source in self.sources for sample in source], self.augmentation)
        pairs = [sum(sample.held_out for sample in source) for source in self.sources]
        photos = [len(source) - count for source, count in zip(self.sources, pairs, strict=True)]
        simulated = never if self.simulation is None else self.simulation.drawn
        count = self.batch_size * self.steps_per_epoch
        draw = BalancedDraw(pairs, count, self.seed, photos, simulated, self._drawn)
        collate = Collate(self.reference_config.references, self.augmentation, self.simulation)
        rank, ranks = self._place()
        if ranks > 1:
            shares = SharedBatches(draw, self.batch_size, rank, ranks)
            several = SharedCollate(collate, crops.samples)
            return DataLoader(SharedCrops(crops), batch_sampler=shares, collate_fn=several, num_workers=self.workers)
        return DataLoader(
            crops, self.batch_size, sampler=draw, collate_fn=collate, num_workers=self.workers, drop_last=True
        )

    def val_dataloader(self) -> DataLoader[Any]:
        """Whole images, one by one."""
        every = max(1, -(-len(self.held_out) // max(1, self.validation_views)))
        chosen = self.held_out[::every]
        references, simulation = self.reference_config.references, self.validated

        def collate(items: list[tuple[int, Sample]]) -> Batch:
            ((seed, sample),) = items
            batch = batch_of([sample.planes()], [sample], references, [sample.fine_planes()])
            return batch if simulation is None else simulation(batch, [sample], [seed])

        rank, ranks = self._place()
        views: Any = list(enumerate(chosen))
        # Torch's own sampler would repeat views until all processes have as many, and so change the mean.
        own = UnrepeatedDistributedSampler(views, ranks, rank, shuffle=False)
        return DataLoader(views, batch_size=1, sampler=own, collate_fn=collate)

    def _drawn(self) -> int:
        """How many crops the training has had."""
        return 0 if self.trainer is None else int(self.trainer.global_step) * self.batch_size

    def _place(self) -> tuple[int, int]:
        """This process's number and how many train together."""
        return (0, 1) if self.trainer is None else (self.trainer.global_rank, self.trainer.world_size)

    def _collect(self) -> None:
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

        runs = {side: [find_runs(pattern) for pattern in patterns] for side, patterns in self.patterns.items()}
        train, held_out = ({run for group in runs[side] for run in group} for side in ("train", "validation"))
        refuse_frozen(sorted(train), "trained on")
        refuse_frozen(sorted(held_out), "chosen by")
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
            self.sources = [
                self._samples(group, bar, task) + (self._photos(group, bar, task) if self.training_views else [])
                for group in runs["train"]
            ]
            self.held_out = [sample for group in runs["validation"] for sample in self._samples(group, bar, task)]
        self._leave_out()

    def _leave_out(self) -> None:
        """Leave out the samples that are not finite.

        Raises:
            InputError: they are too many.
        """
        every = [sample for source in (*self.sources, self.held_out) for sample in source]
        bad = [f"{sample.name}: its {sample.bad} is not finite" for sample in every if sample.bad]
        refuse_bad(bad, len(every), self.bad_share)
        self.sources = [[sample for sample in source if not sample.bad] for source in self.sources]
        self.held_out = [sample for sample in self.held_out if not sample.bad]

    def _samples(self, runs: Sequence[Path], bar, task) -> list[Sample]:  # type: ignore[no-untyped-def]
        found: list[Sample] = []
        for run in runs:
            steps = run_steps(run)
            for step in steps if self.snapshots else steps[-1:]:
                views, identity = self._thinned(self._read(run, step), _identity(run, step))
                found += self._prepared(views, identity, True, lambda: bar.advance(task))
        return found

    def _photos(self, runs: Sequence[Path], bar, task) -> list[Sample]:  # type: ignore[no-untyped-def]
        """Training views with the depth of the last snapshot; the photos of all snapshots are the same."""
        found: list[Sample] = []
        for run in runs:
            step = run_steps(run)[-1]
            views = training_targets(self._read(run, step))
            found += self._prepared(views, _identity(run, step), False, lambda: bar.advance(task))
        return found

    def _read(self, run: Path, step: int) -> RenderedSet:
        views = read_run(run, step)
        return self.finer(run, views) if self.reference_config.fine and self.finer is not None else views

    def _thinned(self, views: RenderedSet, identity: str) -> tuple[RenderedSet, str]:
        """The views that a run gives, and what tells them from another choice of them."""
        count, most = len(views.targets), self.views_per_run
        if most is None or count <= most:
            return views, identity
        chosen = tuple(views.targets[(2 * i + 1) * count // (2 * most)] for i in range(most))
        return dataclasses.replace(views, targets=chosen), f"{identity} {most} views"

    def _prepared(
        self, views: RenderedSet, identity: str, held_out: bool, progress: Callable[[], None]
    ) -> list[Sample]:
        return prepare_samples(
            views, self.reference_config, self.cache, identity, max(1, self.workers), progress, held_out
        )


def _identity(run: Path, step: int) -> str:
    return f"{run.resolve()} {step} {(run / f'test/ours_{step}/renders').stat().st_mtime_ns}"


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
