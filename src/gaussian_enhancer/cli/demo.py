"""The job ``demo``: fit, enhance, measure and report one procedural scene, with the jobs that a user would run.

A sparse splat is fitted, its held-out views are enhanced with the weights that come with the package, measured, and
shown as a table and a page. The fit is taken from the runs' folder where it was done before.
"""

import time
from pathlib import Path

from omegaconf import DictConfig, open_dict
from rich.console import Console

from gaussian_enhancer.cli.pipeline import enhanced, finished_fit, measured
from gaussian_enhancer.metrics.comparison import compare, paired
from gaussian_enhancer.report.measured_run import open_measured, write_page
from gaussian_enhancer.report.terminal import comparison_table, reasons
from gaussian_enhancer.runs.compose import compose_job
from gaussian_enhancer.runs.run import find_run, open_run


def run(cfg: DictConfig) -> float | None:
    """Run the demo.

    Args:
        cfg: see ``conf/demo.yaml``.

    Returns:
        Mean gain in colour-aligned PSNR, dB.
    """
    begun = time.monotonic()
    console = Console(stderr=True)
    fit_folder = _fit(cfg, console)
    console.rule("2 of 3  enhance the held-out views", align="left")
    folder = enhanced(compose_job("enhance", cfg, run=str(fit_folder), weights=cfg.weights))
    console.rule("3 of 3  measure and show", align="left")
    measuring = compose_job("measure", cfg, run=str(folder), lpips=cfg.lpips, backbones=cfg.backbones)
    records, folder = measured(measuring, fit_folder)
    shown = open_measured(folder)
    own = open_run(cfg, "demo", measuring.scene_name)
    page = own.folder / "report.html"
    title = f"{measuring.scene_name}: sparse {measuring.splat_name}, enhanced"
    write_page(page, shown, title=title)
    own.finish()
    Console().print(comparison_table(shown.views, title))
    if missing := reasons(shown.views):
        Console().print(missing, highlight=False, soft_wrap=True)
    console.print(f"{page.resolve().as_uri()}\n{time.monotonic() - begun:.0f} s", highlight=False, soft_wrap=True)
    return compare(paired(records), "psnr_aligned").gain


def _fit(cfg: DictConfig, console: Console) -> Path:
    """Fit the splat, or find it fitted."""
    job = compose_job("fit", cfg, scene=cfg.scene, splat=cfg.splat)
    with open_dict(job):  # settings that fit.yaml leaves at their defaults may be given, too
        job.settings.update(cfg.settings)
    before = find_run(job, "fit")
    again = "  (done before)" if before is not None and before.done else ""
    console.rule(f"1 of 3  fit a splat to a sparse capture{again}", align="left")
    return finished_fit(job).folder
