"""``gaussian-enhancer distil_study``: gain of distilling.

The study compares a fit, the same number of further steps without and with enhanced views, and each of them enhanced. A
run is named CAPTURE/SPLAT:RUN. SPLAT is the name of the run's splat: raw (the fit), further (``distil
settings.share=0``), distilled, or a variant. New rows replace recorded rows of the same capture and splat. Without
runs, the page is made from the records alone.
"""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
import torch
from omegaconf import DictConfig

from ablations.scripts.convergence import parse_method
from ablations.study.engine import Study, job
from ablations.study.enhanced_views import enhanced_views
from ablations.study.fits import refuse_without_views
from ablations.study.roles import role_of
from ablations.study.rows import RowFile, with_gains
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.infer.plan import AUTO
from gaussian_enhancer.metrics.lpips import PerceptualDistance, requested_distances
from gaussian_enhancer.metrics.records import read_records
from gaussian_enhancer.scene.renders import read_run

BASE = "raw"
COLUMNS = ("role", "seconds", "gaussians", "view", "image", "psnr_aligned")
KEYS = ("scene", "splat")


@dataclass(frozen=True)
class StudiedRun:
    """A run that is measured.

    Args:
        capture: the scene's name.
        splat: name of the run's splat.
        run: folder of the job ``fit`` or ``distil``.
        seconds: duration of the run; None if it was interrupted.
        gaussians: of its splat.
    """

    capture: str
    splat: str
    run: Path
    seconds: float | None
    gaussians: float


def measure_distilled(
    studied: StudiedRun, method: str, digest: str, enhancer: SetEnhancer, distances: Sequence[PerceptualDistance]
) -> Iterator[dict[str, object]]:
    """Two rows a held-out view: the splat's render, and the render enhanced.

    Args:
        studied: the run.
        method: name of the enhancer.
        digest: of its weights.
        enhancer: enhances the views.
        distances: LPIPS distances to measure as well.

    Raises:
        InputError: the run's views cannot be read.
    """
    about: dict[str, object] = {"role": role_of(studied.capture), "scene": studied.capture, "splat": studied.splat}
    about |= {"seconds": studied.seconds, "gaussians": studied.gaussians}
    for view in enhanced_views(read_run(studied.run), {method: enhancer}, distances, rules=AUTO):
        row_key = {**about, "view": view.view.name}
        yield {**row_key, "image": "render", "weights": "", **view.raw.metrics}
        yield {**row_key, "image": method, "weights": digest, **view.results[method].measured.metrics}


def gains_over_render(frame: pd.DataFrame) -> pd.DataFrame:
    """The rows with their gains over the raw render of the same capture and view."""
    return with_gains(frame, {"splat": BASE, "image": "render"}, ("scene", "view"))


def parse_run(word: str) -> StudiedRun:
    """Parse the name of a run.

    Args:
        word: CAPTURE/SPLAT:RUN.

    Raises:
        InputError: it has another form, the capture has no role, or the run has no held-out views or no record of cost.
    """
    label, _, folder = word.partition(":")
    capture, _, splat = label.partition("/")
    if not (capture and splat and folder):
        raise InputError(word, "names no run", "write CAPTURE/SPLAT:RUN")
    role_of(capture)
    run = Path(folder)
    refuse_without_views(run)
    cost = next((record.metrics for record in read_records(run / "records.jsonl") if record.kind == "cost"), None)
    if cost is None:
        raise InputError(run / "records.jsonl", "holds no record of cost", "name a run of the job fit or distil")
    milliseconds = cost.get("milliseconds")
    seconds = None if milliseconds is None else milliseconds / 1e3
    return StudiedRun(capture, splat, run, seconds, cost.get("gaussians") or 0.0)


def choose_runs(words: Sequence[str], recorded: Collection[tuple[str, str]]) -> list[StudiedRun]:
    """Parse the names of runs and check them before any is measured.

    Args:
        words: see `parse_run`.
        recorded: captures and splats in the records.

    Raises:
        InputError: a word names no such run, two name the same splat, or a capture's raw splat is not there.
    """
    runs = [parse_run(word) for word in words]
    pairs = [(studied.capture, studied.splat) for studied in runs]
    for capture, splat in pairs:
        if pairs.count((capture, splat)) > 1:
            raise InputError("runs", f"name {capture}/{splat} twice", "name one run of each splat")
        if (capture, BASE) not in {*pairs, *recorded}:
            raise InputError(capture, f"has no splat {BASE} to compare with", f"add {capture}/{BASE}:FIT to runs")
    return runs


def study(cfg: DictConfig, device: torch.device) -> Study[StudiedRun]:
    """The renders of every run, raw and enhanced.

    Raises:
        InputError: weights, runs or records cannot be read.
    """
    if not cfg.runs:
        return Study((), lambda studied: (), KEYS, COLUMNS, derived=gains_over_render)
    recorded = RowFile(Path(cfg.records), KEYS, COLUMNS).read_or_empty()
    runs = choose_runs(cfg.runs, set(zip(recorded["scene"], recorded["splat"], strict=True)))
    distances = requested_distances(cfg.lpips, cfg.backbones, device)
    method, digest, enhancer = parse_method(cfg.weights, device)
    return Study(
        runs,
        lambda studied: measure_distilled(studied, method, digest, enhancer, distances),
        KEYS,
        COLUMNS,
        derived=gains_over_render,
    )


run = job(study)
