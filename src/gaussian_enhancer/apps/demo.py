"""``gaussian-enhancer demo``: one procedural scene, start to finish, by the same jobs that a user would run.

A sparse splat is fitted, its held-out views are enhanced with the weights that come with the package, measured, and
shown as a table and a page. The fit is taken from the runs' folder where it was done before.
"""

import time
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, open_dict
from rich.console import Console

from gaussian_enhancer.apps import enhance, fit
from gaussian_enhancer.apps.measure import write_measurement
from gaussian_enhancer.apps.report import open_measured, write_page
from gaussian_enhancer.apps.run import Run, find_run, open_run
from gaussian_enhancer.measure.compare import compare, paired
from gaussian_enhancer.report.terminal import comparison_table, reasons


def run(cfg: DictConfig) -> float | None:
    """Run the demo.

    Args:
        cfg: see ``conf/demo.yaml``.

    Returns:
        Mean gain in colour-aligned PSNR, dB.
    """
    begun = time.monotonic()
    console = Console(stderr=True)
    fitted = _fit(cfg, console)
    enhanced = _enhance(cfg, fitted, console)
    console.rule("3 of 3  measure and show", align="left")
    measuring = _job("measure", cfg, run=str(enhanced), lpips=cfg.lpips, backbones=cfg.backbones)
    measuring.scene_name, measuring.splat_name = _names(fitted)
    records, folder = write_measurement(measuring)
    measured = open_measured(folder)
    own = open_run(cfg, "demo", measuring.scene_name)
    page = own.folder / "report.html"
    title = f"{measuring.scene_name}: sparse {measuring.splat_name}, enhanced"
    write_page(page, measured, title=title)
    own.finish()
    Console().print(comparison_table(measured.views, title))
    if missing := reasons(measured.views):
        Console().print(missing, highlight=False, soft_wrap=True)
    console.print(f"{page.resolve().as_uri()}\n{time.monotonic() - begun:.0f} s", highlight=False, soft_wrap=True)
    return compare(paired(records), "psnr_aligned").gain


def _fit(cfg: DictConfig, console: Console) -> Path:
    """Fit the splat, or find it fitted."""
    job = _job("fit", cfg, scene=cfg.scene, splat=cfg.splat)
    with open_dict(job):  # settings that fit.yaml leaves at their defaults may be given, too
        job.settings.update(cfg.settings)
    before = find_run(job, "fit")
    again = "  (done before)" if before is not None and before.done else ""
    console.rule(f"1 of 3  fit a splat to a sparse capture{again}", align="left")
    fit.run(job)
    return _made(job, "fit").folder


def _enhance(cfg: DictConfig, fitted: Path, console: Console) -> Path:
    """Enhance the held-out views."""
    console.rule("2 of 3  enhance the held-out views", align="left")
    job = _job("enhance", cfg, run=str(fitted), weights=cfg.weights)
    enhance.run(job)
    return _made(job, "enhance").folder


def _job(name: str, cfg: DictConfig, **values: Any) -> DictConfig:
    """The configuration of another job with this one's runs and runtime."""
    from hydra import compose

    job = compose(name)
    with open_dict(job):
        for key, value in {"runs": cfg.runs, "runtime": cfg.runtime, **values}.items():
            job[key] = value
    return job


def _made(job: DictConfig, name: str) -> Run:
    made = find_run(job, name)
    if made is None:
        raise RuntimeError(f"the job {name} left no run behind")
    return made


def _names(fitted: Path) -> tuple[str, str]:
    """Scene and method of a fit, as its folder is called: scene-method-digest."""
    scene, method, _ = fitted.name.rsplit("-", 2)
    return scene, method
