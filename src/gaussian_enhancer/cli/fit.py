"""The job ``fit``: fit a splat to a scene; write the splat, its renders and their quality."""

import statistics
import time
from pathlib import Path

from omegaconf import DictConfig
from rich.console import Console

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.metrics.pair import PROTOCOL, measure_pair
from gaussian_enhancer.metrics.records import Record, write_records
from gaussian_enhancer.runs import status
from gaussian_enhancer.runs.instantiate import build
from gaussian_enhancer.runs.run import Run, open_run
from gaussian_enhancer.runs.runtime import start
from gaussian_enhancer.scene.renders import read_run
from gaussian_enhancer.scene.scene import Scene
from gaussian_enhancer.splat.fit.fit import fit
from gaussian_enhancer.splat.fit.progress import waiting
from gaussian_enhancer.splat.fit.settings import FitSettings
from gaussian_enhancer.splat.fit.stopwatch import Stopwatch
from gaussian_enhancer.splat.methods import Method


def run(cfg: DictConfig) -> float | None:
    """Fit a splat, unless the same fit is done already.

    Args:
        cfg: see ``conf/fit.yaml``.

    Returns:
        Mean PSNR of the held-out views in dB, for sweeps; None where no view is held out.

    Raises:
        InputError: the scene cannot be read, a setting is out of range, or a file cannot be written.
    """
    device = start(cfg.runtime)
    with waiting("scene", cfg.runtime.progress):
        scene: Scene = build(cfg.scene)
    method: Method = build(cfg.splat)
    settings: FitSettings = build(cfg.settings)
    job = open_run(cfg, "fit", f"{scene.name}-{method.name}")
    console = Console(stderr=True)
    if not job.done:
        watch = Stopwatch(bool(cfg.profile))
        begun = time.monotonic()
        try:
            gaussians = fit(
                scene, method, job.folder, settings, device=device, progress=cfg.runtime.progress, stopwatch=watch
            )
        except (InputError, OSError):
            if status.holds_no_result(job.folder):
                status.discard_marks(job.folder)
            raise
        seconds = time.monotonic() - begun
        _measure(job, scene, method, settings, seconds, len(gaussians))
        job.finish()
        if cfg.profile:
            console.print(watch.table(), highlight=False)
    mean = _held_out(job.folder)
    quality = "no view held out" if mean is None else f"held-out PSNR {mean:.2f} dB"
    console.print(f"{job.folder}: {quality}", highlight=False, soft_wrap=True)
    return mean


def _measure(job: Run, scene: Scene, method: Method, settings: FitSettings, seconds: float, count: int) -> None:
    """Write the quality of every held-out render, as stored in 8 bits, and the cost of the fit."""
    records = []
    for step in settings.snapshot_steps() if scene.test else ():
        rendered = read_run(job.folder, step, background=scene.background)
        for view in rendered.targets:
            if view.read is None or view.read_photo is None:
                continue
            image, photo = view.read(), view.read_photo()
            found = measure_pair(image, photo)
            size = (image.shape[2], image.shape[1])
            what = (job.folder.name, scene.name, f"{method.name}/{step}", view.name, "raw")
            records.append(Record("quality", *what, found.metrics, found.reasons, size, PROTOCOL))
    cost: dict[str, float | None] = {"milliseconds": 1e3 * seconds, "gaussians": float(count)}
    records.append(Record("cost", job.folder.name, scene.name, method.name, "", "raw", cost))
    write_records(job.folder / "records.jsonl", records)


def _held_out(folder: Path) -> float | None:
    """Mean PSNR of the held-out renders of the last step, from the records."""
    from gaussian_enhancer.metrics.records import read_records

    quality = [record for record in read_records(folder / "records.jsonl") if record.kind == "quality"]
    if not quality:
        return None
    values = [record.metrics["psnr"] for record in quality if record.splat == quality[-1].splat]
    return statistics.fmean(value for value in values if value is not None)
