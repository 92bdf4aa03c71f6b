"""The job ``fit``: fit a splat to a scene; write the splat, its renders and their quality."""

import time

from omegaconf import DictConfig
from rich.console import Console

from gaussian_enhancer.console import print_line
from gaussian_enhancer.runs.fit_records import held_out_psnr, write_fit_records
from gaussian_enhancer.runs.instantiate import build
from gaussian_enhancer.runs.run import open_run
from gaussian_enhancer.runs.runtime import start
from gaussian_enhancer.scene.scene import Scene
from gaussian_enhancer.splat.fit.checkpoint import holds_checkpoint
from gaussian_enhancer.splat.fit.fit import fit
from gaussian_enhancer.splat.fit.progress import waiting_bar
from gaussian_enhancer.splat.fit.settings import FitSettings
from gaussian_enhancer.splat.fit.stopwatch import Stopwatch
from gaussian_enhancer.splat.methods import Method


def run(cfg: DictConfig) -> float | None:
    """Fit a splat, unless a finished fit of the same configuration exists.

    Args:
        cfg: see ``conf/fit.yaml``.

    Returns:
        Mean PSNR of the held-out views in dB, for sweeps; None where no view is held out.

    Raises:
        InputError: the scene cannot be read, a setting is out of range, or a file cannot be written.
    """
    device = start(cfg.runtime)
    with waiting_bar("scene", cfg.runtime.progress):
        scene: Scene = build(cfg.scene)
    method: Method = build(cfg.splat)
    settings: FitSettings = build(cfg.settings)
    job = open_run(cfg, "fit", f"{scene.name}-{method.name}")
    console = Console(stderr=True)
    earlier = "; made by an earlier call, delete the folder to fit again" if job.done else ""
    if not job.done:
        stopwatch = Stopwatch(bool(cfg.profile))
        resumed, started = holds_checkpoint(job.folder), time.monotonic()
        gaussians = fit(
            scene, method, job.folder, settings, device=device, progress=cfg.runtime.progress, stopwatch=stopwatch
        )
        seconds = None if resumed else time.monotonic() - started
        write_fit_records(job, scene, method.name, settings.snapshot_steps(), seconds, len(gaussians))
        job.finish()
        if cfg.profile:
            console.print(stopwatch.table(), highlight=False)
    _, mean_psnr = held_out_psnr(job.folder)
    quality = "no view held out" if mean_psnr is None else f"held-out PSNR {mean_psnr:.2f} dB"
    print_line(console, f"{job.folder}: {quality}{earlier}")
    return mean_psnr
