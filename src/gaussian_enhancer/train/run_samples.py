"""Preparation of training samples from fitted runs: selection of their renders, and cached warping of references."""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import matching_paths
from gaussian_enhancer.runs.status import DONE
from gaussian_enhancer.scene.rendered import RenderedSet
from gaussian_enhancer.scene.renders import read_run, run_steps
from gaussian_enhancer.train.non_finite import BAD_SHARE
from gaussian_enhancer.train.samples import Sample, prepare_samples, training_targets

AttachFinePhotos = Callable[[Path, RenderedSet], RenderedSet]


@dataclass(frozen=True)
class RunSamples:
    """How a fitted run becomes samples.

    Args:
        reference_config: how references are aligned; each (target, reference) pair is warped once and cached.
        cache: folder for prepared samples.
        snapshots: use the renders of all snapshots of a run (weak fits are the most useful ones to train on), or of the
            last one only.
        match_exposure: match each held-out photo to the exposure of its render, because no network input tells the
            photo's exposure.
        views_per_run: maximum number of held-out views of each run, spread evenly; None takes all.
        finer: adds photos 4 times as fine to the views of a run; required if the reference configuration uses them.
        bad_share: share of all samples that may be left out because they are not finite.
        progress: show a progress bar while samples are prepared.

    Raises:
        InputError: fine photos are required but ``finer`` is None, or the number of views is not positive.
    """

    reference_config: ReferenceConfig
    cache: str | Path
    snapshots: bool = True
    match_exposure: bool = False
    views_per_run: int | None = None
    finer: AttachFinePhotos | None = None
    bad_share: float = BAD_SHARE
    progress: bool = True

    def __post_init__(self) -> None:
        if self.reference_config.fine and self.finer is None:
            raise InputError(
                "reference_config.fine", "requires high-resolution photos", "pass finer=, which provides them"
            )
        if self.views_per_run is not None and self.views_per_run < 1:
            raise InputError("views_per_run", f"is {self.views_per_run}", "give at least 1")

    def held_out(self, run: Path, threads: int, advance: Callable[[], None]) -> list[Sample]:
        """Samples of the held-out views of a run.

        Args:
            run: the run's folder.
            threads: number of threads that prepare samples.
            advance: called after each sample.
        """
        steps, samples = run_steps(run), []
        for step in steps if self.snapshots else steps[-1:]:
            views, identity = self._limit_views(self._read(run, step), _identity(run, step))
            samples += self._prepare(views, identity, True, threads, advance)
        return samples

    def training_views(self, run: Path, threads: int, advance: Callable[[], None]) -> list[Sample]:
        """Samples of the training views, with the depth of the last snapshot; all snapshots have the same photos."""
        step = run_steps(run)[-1]
        views = training_targets(self._read(run, step))
        return self._prepare(views, _identity(run, step), False, threads, advance)

    def _read(self, run: Path, step: int) -> RenderedSet:
        views = read_run(run, step)
        return self.finer(run, views) if self.reference_config.fine and self.finer is not None else views

    def _limit_views(self, views: RenderedSet, identity: str) -> tuple[RenderedSet, str]:
        """At most ``views_per_run`` of the views, and the identity of this selection for the cache."""
        count, limit = len(views.targets), self.views_per_run
        if limit is None or count <= limit:
            return views, identity
        chosen = tuple(views.targets[(2 * i + 1) * count // (2 * limit)] for i in range(limit))
        return dataclasses.replace(views, targets=chosen), f"{identity} {limit} views"

    def _prepare(
        self, views: RenderedSet, identity: str, held_out: bool, threads: int, advance: Callable[[], None]
    ) -> list[Sample]:
        matched = held_out and self.match_exposure
        cache = Path(self.cache)
        return prepare_samples(views, self.reference_config, cache, identity, threads, advance, held_out, matched)


def _identity(run: Path, step: int) -> str:
    """A snapshot's folder, and when the last of its files was written: renders may be made again in place."""
    paths = [path for side in ("test", "train") for path in (run / side / f"ours_{step}").rglob("*")]
    newest = max(path.stat().st_mtime_ns for path in paths)
    return f"{run.resolve()} {step} {newest}"


def find_runs(pattern: str) -> list[Path]:
    """The run folders with held-out renders that match a pattern, sorted.

    Raises:
        InputError: no folder matches, or one is of an unfinished fit.
    """
    runs = sorted(folder for folder in matching_paths(pattern) if run_steps(folder))
    if not runs:
        raise InputError(pattern, "names no run with held-out renders", "fit scenes first, or correct the pattern")
    for run in runs:
        if (run / "config.yaml").is_file() and not (run / DONE).is_file():
            raise InputError(run, "is a fit that was not finished", "start the same fit again, or delete the folder")
    return runs
