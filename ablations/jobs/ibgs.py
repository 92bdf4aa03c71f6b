"""``gaussian-enhancer ibgs``: train the residual network of IBGS, a peer, on the training views of a finished fit.

The fit is not changed. A killed training resumes. The job ``convergence`` can measure the result as a method.
"""

from collections.abc import Sequence
from pathlib import Path

from omegaconf import DictConfig
from rich.console import Console
from rich.progress import Progress

from ablations.ibgs.network import IBGSResidual
from ablations.ibgs.training import ResidualSettings, TrainedResidual, TrainingView, train_residual, training_views
from ablations.study.fits import finished_fits, scene_of
from ablations.study.processor import refuse_gpu
from gaussian_enhancer.checkpoint import WEIGHTS
from gaussian_enhancer.console import print_line
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.weights import count_parameters
from gaussian_enhancer.runs.instantiate import build
from gaussian_enhancer.runs.run import Run, open_run
from gaussian_enhancer.runs.runtime import start
from gaussian_enhancer.scene.renders import read_run, run_steps
from gaussian_enhancer.splat.fit.checkpoint import NAME


def run(cfg: DictConfig) -> None:
    """Train, unless the same training has finished before.

    Args:
        cfg: see ``conf/ibgs.yaml``.

    Raises:
        InputError: the fit is not finished or lacks what is needed, or a file cannot be written.
    """
    refuse_gpu(start(cfg.runtime))
    fit = _only(finished_fits([cfg.fit]), cfg.fit)
    cfg.step = run_steps(fit)[-1] if cfg.step is None else cfg.step
    settings, choice = build(cfg.settings), build(cfg.choice)
    rendered = read_run(fit, cfg.step)
    job = open_run(cfg, "ibgs", f"{scene_of(fit)}-{cfg.step}")
    console, weights = Console(stderr=True), job.folder / WEIGHTS
    if job.done:
        print_line(console, f"trained already: {weights}")
        return
    views = training_views(rendered, choice, settings.exposure)
    network = _trained(views, settings, job, console, cfg.runtime.progress)
    TrainedResidual(network, fit.resolve().name, cfg.step, settings, choice).save(weights)
    (job.folder / NAME).unlink(missing_ok=True)
    job.finish()
    summary = f"{count_parameters(network)} parameters, {len(views)} views, {settings.steps} steps"
    print_line(console, f"{weights}: {summary}")


def _only(fits: Sequence[Path], pattern: str) -> Path:
    if len(fits) > 1:
        raise InputError("fit", f"is {pattern!r}, which names {len(fits)} fits", "name one; sweep over several with -m")
    return fits[0]


def _trained(
    views: Sequence[TrainingView], settings: ResidualSettings, job: Run, console: Console, shown: bool
) -> IBGSResidual:
    with Progress(console=console, transient=True, disable=not shown) as bar:
        task = bar.add_task("train", total=settings.steps)
        return train_residual(views, settings, job.folder, lambda step: bar.update(task, completed=step))
