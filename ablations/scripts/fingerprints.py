"""``gaussian-enhancer fingerprints``: ratio of errors of held-out to training views, for the gate.

For every run and snapshot, the job measures the fingerprints of the training views and of the held-out views.
`gaussian_enhancer.degrade.gates.adaptive.HELD_OUT_GROWTH` is the line fitted to both in the logarithms.
``gates=FOLDER`` also calibrates a gate on the held-out views of each snapshot and writes it to the folder; the training
of the second stage uses these gates as its stage 1 (``gate=adaptive 'gate.file=FOLDER/*.json'``). Runs must be training
runs (docs/data.md).
"""

import math
import statistics
from collections.abc import Sequence
from pathlib import Path

import pandas as pd
import torch
from omegaconf import DictConfig
from torch import Tensor

from ablations.study.engine import Study, job
from ablations.study.fits import finished_fits
from ablations.study.processor import refuse_gpu
from gaussian_enhancer.degrade.gates.adaptive import calibrate_gate
from gaussian_enhancer.degrade.gates.fingerprint import ENERGIES, Fingerprint, measure_fingerprint
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.frozen import refuse_untrained
from gaussian_enhancer.scene.rendered import RenderedView
from gaussian_enhancer.scene.renders import read_run, run_steps
from gaussian_enhancer.scene.splits import evenly_spaced

Images = list[Tensor]
PHOTOS = 3
"""Number of photos on which the artefact types' responses are measured."""


def spread(views: Sequence[RenderedView], count: int) -> tuple[Images, Images]:
    """Renders and photos of at most so many views, evenly spaced."""
    renders, photos = [], []
    for view in evenly_spaced(views, count):
        if view.read is None or view.read_photo is None:
            raise InputError(view.name, "has no render or no photo", "give runs with both, training views included")
        renders.append(view.read())
        photos.append(view.read_photo())
    return renders, photos


def measured(views: Sequence[RenderedView], count: int) -> Fingerprint:
    """The fingerprint of at most so many views, evenly spaced."""
    return measure_fingerprint(*spread(views, count))


def calibrate(run: Path, folder: Path, count: int) -> None:
    """Write a gate for each snapshot of a run, calibrated on its held-out views."""
    for step in run_steps(run):
        targets = read_run(run, step).targets
        photos = spread(targets, PHOTOS)[1]
        generator = torch.Generator().manual_seed(0)
        # Held-out views are measured directly, so no correction is needed.
        gate = calibrate_gate(measured(targets, count), photos, generator, held_out={}, draws=1)
        gate.to_file(folder / f"{run.name}-{step}.json")


def rows(run: Path, count: int) -> list[dict[str, object]]:
    """One record for each of a run's snapshots: energies of both sides."""
    records = []
    for step in run_steps(run):
        rendered = read_run(run, step)
        training, held_out = measured(rendered.references, count), measured(rendered.targets, count)
        record: dict[str, object] = {"run": run.name, "step": step, "last": step == run_steps(run)[-1]}
        record |= {"training_views": training.views, "held_out_views": held_out.views}
        for name in ENERGIES:
            record[name] = {"training": getattr(training, name), "held_out": getattr(held_out, name)}
        records.append(record)
    return records


def by_energy(frame: pd.DataFrame) -> pd.DataFrame:
    """One row a snapshot and energy: the ratio at each run's last step, factor and power over all snapshots."""
    tables = []
    for name in ENERGIES:
        table = pd.DataFrame({"energy": name, "step": frame["step"]})
        before, after = frame[f"{name} training"], frame[f"{name} held_out"]
        table["ratio at the end"] = (after / before).where(frame["last"] & (before > 0))
        table["factor"], table["power"] = growth(list(zip(before, after, strict=True)))
        tables.append(table)
    return pd.concat(tables, ignore_index=True)


def growth(pairs: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Factor and power of held-out energies as a function of training energies: least squares in the logarithms.

    NaN where fewer than two energies are positive.
    """
    logarithms = [(math.log(before), math.log(after)) for before, after in pairs if before > 0 and after > 0]
    if len({before for before, _ in logarithms}) < 2:
        return math.nan, math.nan
    power, logarithm = statistics.linear_regression(*zip(*logarithms, strict=True))
    return math.exp(logarithm), power


def study(cfg: DictConfig, device: torch.device) -> Study[Path]:
    """The fingerprints of both sides of every snapshot, and gates where they are asked for.

    Raises:
        InputError: runs cannot be used.
    """
    refuse_gpu(device)

    def measure(fit: Path) -> list[dict[str, object]]:
        if cfg.gates:
            calibrate(fit, Path(cfg.gates), cfg.views)
        return rows(fit, cfg.views)

    fits = finished_fits(cfg.runs)
    refuse_untrained(fits)
    return Study(fits, measure, ("run", "step"), derived=by_energy)


run = job(study)
