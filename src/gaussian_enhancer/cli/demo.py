"""The job ``demo``: fit, enhance, measure and report one procedural scene, with the jobs that a user would run.

A splat is fitted to a sparse capture. Its held-out views are enhanced with the weights that come with the package and
measured. The results are shown as tables and a page. A finished fit in the folder of runs is reused.
"""

import time
from pathlib import Path

from omegaconf import DictConfig, open_dict
from rich.console import Console

from gaussian_enhancer.checkpoint import find_checkpoint
from gaussian_enhancer.cli.measure import write_measurement
from gaussian_enhancer.cli.pipeline import enhance_run, fit_run
from gaussian_enhancer.console import print_line
from gaussian_enhancer.metrics.comparison import compare, gain_table, pair_records, view_table
from gaussian_enhancer.report.measured_run import open_measured, write_page
from gaussian_enhancer.runs.compose import compose_job
from gaussian_enhancer.runs.run import find_run, open_run


def run(cfg: DictConfig) -> float | None:
    """Run the demo.

    Args:
        cfg: see ``conf/demo.yaml``.

    Returns:
        Mean gain in colour-aligned PSNR, dB.
    """
    started = time.monotonic()
    console = Console(stderr=True)
    find_checkpoint(cfg.weights)  # refuses unknown weights before minutes of fitting
    fit_folder = _fit(cfg, console)
    console.rule("2 of 3  enhance the held-out views", align="left")
    folder = enhance_run(compose_job("enhance", cfg, run=str(fit_folder), weights=cfg.weights))
    console.rule("3 of 3  measure and show", align="left")
    scene_name, splat_name, _ = fit_folder.name.rsplit("-", 2)
    values = {"run": str(folder), "scene_name": scene_name, "splat_name": splat_name}
    measure_job = compose_job("measure", cfg, lpips=cfg.lpips, backbones=cfg.backbones, **values)
    records, folder = write_measurement(measure_job)
    measured_run = open_measured(folder)
    demo_run = open_run(cfg, "demo", scene_name)
    page = demo_run.folder / "report.html"
    write_page(page, measured_run, title=f"{scene_name}: sparse {splat_name}, enhanced")
    demo_run.finish()
    pairs = pair_records(records)
    print(gain_table(pairs).markdown(), view_table(pairs).markdown(), sep="\n", end="")
    print_line(console, f"{page.resolve().as_uri()}\n{time.monotonic() - started:.0f} s")
    return compare(pairs, "psnr_aligned").gain


def _fit(cfg: DictConfig, console: Console) -> Path:
    """Fit the splat, or reuse a finished fit; return the run's folder."""
    job = compose_job("fit", cfg, scene=cfg.scene, splat=cfg.splat)
    with open_dict(job):  # cfg.settings may add keys that fit.yaml leaves at their defaults
        job.settings.update(cfg.settings)
    previous = find_run(job, "fit")
    note = "  (done before)" if previous is not None and previous.done else ""
    console.rule(f"1 of 3  fit a splat to a sparse capture{note}", align="left")
    return fit_run(job).folder
