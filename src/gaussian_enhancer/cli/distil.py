"""The job ``distil``: improve a splat by training on enhanced views, by pruning, or by both."""

import time
from functools import partial

from omegaconf import DictConfig
from rich.console import Console

from gaussian_enhancer.console import print_line
from gaussian_enhancer.distil.task import (
    DistilTask,
    improve_splat,
    naming_configuration,
    read_distil_task,
    read_enhancer,
)
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.runs.fit_records import held_out_psnr, write_fit_records
from gaussian_enhancer.runs.run import Run, open_run
from gaussian_enhancer.runs.runtime import start
from gaussian_enhancer.splat.fit.checkpoint import discard_checkpoint, holds_checkpoint
from gaussian_enhancer.splat.fit.export import export_splat, export_views
from gaussian_enhancer.splat.io.small_files import ENDINGS, write_compressed


def run(cfg: DictConfig) -> float | None:
    """Distil, unless a finished run of the same configuration exists.

    Args:
        cfg: see ``conf/distil.yaml``.

    Returns:
        Mean PSNR of the held-out views in dB, for sweeps; None where no view is held out.

    Raises:
        InputError: the input cannot be read, an option is out of range, or a file cannot be written.
    """
    return held_out_psnr(distil_run(cfg).folder)[1]


def distil_run(cfg: DictConfig) -> Run:
    """Return the finished run; compute it if it does not exist.

    Its folder has the layout of a fit's folder. Step 0 is the input splat.

    Args:
        cfg: see ``conf/distil.yaml``.

    Raises:
        InputError: as `run`.
    """
    device = start(cfg.runtime)
    task = read_distil_task(cfg, device)
    enhancer = read_enhancer(cfg, task, device)
    job = open_run(naming_configuration(cfg, task), "distil", task.capture.name)
    console = Console(stderr=True)
    if not job.done:
        for warning in task.mismatch_warnings():
            print_line(console, f"WARNING: {warning}")
        _run_distillation(job, task, enhancer, cfg, console)
    psnr_before, psnr_after = held_out_psnr(job.folder)
    quality = "no view held out" if psnr_after is None else f"held-out PSNR {psnr_before:.2f} -> {psnr_after:.2f} dB"
    print_line(console, f"{job.folder}: {quality}")
    return job


def _run_distillation(
    job: Run, task: DistilTask, enhancer: SetEnhancer | None, cfg: DictConfig, console: Console
) -> None:
    resumed, started = holds_checkpoint(job.folder), time.monotonic()
    gaussians = improve_splat(
        task,
        enhancer,
        job.folder,
        progress=cfg.runtime.progress,
        on_pruned=partial(print_line, console),
    )
    seconds = None if resumed else time.monotonic() - started
    step = 1 if task.settings is None else task.settings.steps
    for number, splat in ((0, task.renderer.gaussians), (step, gaussians)):
        export_views(job.folder, task.capture, splat, task.renderer.method, number)
    export_splat(job.folder, task.capture, gaussians)
    if cfg.format != "ply":
        write_compressed(job.folder / f"splat{ENDINGS[cfg.format]}", gaussians, cfg.format)
    write_fit_records(job, task.capture, task.renderer.method.name, (0, step), seconds, len(gaussians))
    discard_checkpoint(job.folder)
    job.finish()
