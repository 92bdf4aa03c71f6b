"""The job ``enhance``: enhance the renders of a fitted run, of a splat with its capture, or of a folder."""

import statistics
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from omegaconf import DictConfig
from rich.console import Console
from rich.progress import track

from gaussian_enhancer.console import hides_progress, print_line
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.enhancer import EnhancedView
from gaussian_enhancer.infer.plan import Plan
from gaussian_enhancer.infer.preload import validation_reads
from gaussian_enhancer.metrics.records import write_records
from gaussian_enhancer.runs.compose import compose_job
from gaussian_enhancer.runs.earlier_step import resolve_earlier_step
from gaussian_enhancer.runs.enhancement import (
    load_enhancement,
    load_options,
    lost_references,
    mismatch_warnings,
    naming_configuration,
    process_count,
)
from gaussian_enhancer.runs.inputs import Task
from gaussian_enhancer.runs.instantiate import build
from gaussian_enhancer.runs.output import cost_records, remove_other_files, write_enhanced, write_sources
from gaussian_enhancer.runs.run import open_run
from gaussian_enhancer.runs.runtime import start
from gaussian_enhancer.runs.second_splat import averaged_with, refuse_other_views, second_configuration
from gaussian_enhancer.runs.status import track_runs
from gaussian_enhancer.runs.time_budget import apply_budget


def output_path(cfg: DictConfig) -> Path | None:
    """The folder ``output``, which is not a run; None if a run's folder is created, or nothing is written.

    Raises:
        InputError: it is a file.
    """
    if cfg.output and Path(cfg.output).is_file():
        raise InputError(cfg.output, "cannot be written: it is a file", "name a folder")
    return Path(cfg.output) if cfg.output and not cfg.dry_run else None


def run(cfg: DictConfig) -> float | None:
    """Enhance renders and write the images under the renders' names.

    With ``output``, only the images are written, to that folder. Otherwise a run's folder is created in the layout that
    ``measure run=`` reads: renders, enhanced images and photos in parallel folders, the cost in records, and the plan.
    The same command enhances everything again, in the same folder.

    Args:
        cfg: see ``conf/enhance.yaml``.

    Returns:
        Median run time of the network per image, in milliseconds; None with ``dry_run``.

    Raises:
        InputError: the input cannot be used, an option is out of range, or an image cannot be written.
    """
    console = Console(stderr=True)
    count, device = process_count(cfg), start(cfg.runtime)
    cfg = resolve_earlier_step(cfg)
    second_cfg = None if cfg.second is None else second_configuration(cfg)
    if cfg.distil:
        load_options(cfg, device)
        cfg = _with_distilled_splat(cfg)
    cfg = apply_budget(cfg, load_enhancement, device, console)
    enhancer, task, validated = load_enhancement(cfg, device)
    second = None if second_cfg is None else load_enhancement(second_cfg, device)
    if second is not None:
        refuse_other_views(task.rendered, second[1].rendered)
    rules = build(cfg.plan)
    planner = validated.planner(rules)
    progress_hidden = hides_progress(cfg, console)
    reads = validation_reads(validated, planner, keep_photos=not cfg.output, render_splat=cfg.dry_run)
    reads += task.earlier_files
    for read_file in track(reads, "reading", console=console, disable=progress_hidden):
        read_file()
    plan = Plan(task.rendered.name, rules, validated.parts, () if planner is None else tuple(planner.plans.values()))
    notes = validated.missing_references if rules.full and not cfg.dry_run else (plan.table(),)
    if task.earlier:
        notes = *notes, f"The renders of step {cfg.earlier_step} are used as well (earlier_step=null leaves them out)."
    for line in filter(None, (task.note, *notes)):
        print_line(Console() if cfg.dry_run else console, line)
    warnings = *mismatch_warnings(validated), *lost_references(enhancer, task, validated)
    for warning in (*warnings, *(() if second is None else mismatch_warnings(second[2]))):
        console.print(f"WARNING: {warning}", style="bold red", highlight=False, soft_wrap=True, markup=False)
    if cfg.dry_run:
        return None

    def write_enhanced_to(folder: Path) -> list[EnhancedView]:
        total = len(task.rendered.targets)
        if min(count, total) > 1:
            from gaussian_enhancer.cli.distributed_enhance import enhance_in_processes  # loads lightning

            return enhance_in_processes(folder, plan, cfg, enhancer.device.type, min(count, total))
        images = enhancer(task.rendered, planner, validated.pool)
        if second is not None:
            images = averaged_with(images, second, rules)
        tracked = track(images, "enhancing", total=total, console=console, disable=progress_hidden)
        return write_enhanced(tracked, folder, task.rendered, enhancer.network.scale)

    if cfg.output:
        return _print_summary(write_enhanced_to(Path(cfg.output)), Path(cfg.output), console)
    return _print_summary(*_write_run(cfg, task, plan, enhancer.network.scale, write_enhanced_to), console)


def _write_run(
    cfg: DictConfig, task: Task, plan: Plan, scale: int, write_enhanced_to: Callable[[Path], list[EnhancedView]]
) -> tuple[list[EnhancedView], Path]:
    """Write the folder of a run: enhanced images, renders, photos, records of the cost, and the plan."""
    job = open_run(naming_configuration(cfg), "enhance", task.rendered.name, reused=False)
    step_folder = job.folder / "test" / f"ours_{task.step}"
    enhanced_views = write_enhanced_to(step_folder / "enhanced")
    sources = write_sources(task.rendered, step_folder, scale)
    remove_other_files(step_folder, [*sources, *(step_folder / "enhanced" / view.name for view in enhanced_views)])
    write_records(job.folder / "records.jsonl", cost_records(enhanced_views, job.folder.name, task))
    view_plans = tuple(view.plan for view in enhanced_views if view.plan is not None)
    replace(plan, views=view_plans or plan.views).to_file(job.folder / "plan.json")  # several processes return no plans
    job.finish()
    return enhanced_views, job.folder


def _with_distilled_splat(cfg: DictConfig) -> DictConfig:
    """Distil the splat of a configuration, or reuse a finished result; return the configuration with the new splat.

    Raises:
        InputError: there is no splat to distil, options contradict ``distil``, or the splat cannot be distilled.
    """
    from gaussian_enhancer.cli.distil import distil_run  # imports training, which nothing else here needs

    if cfg.run is None and cfg.gaussians is None:
        raise InputError("distil", "is asked for without a splat", "give run=FOLDER, or gaussians=FILE with scene=...")
    for name, is_set in (("dry_run", cfg.dry_run), ("step", cfg.step is not None)):
        if is_set:
            raise InputError(name, "comes with distil=true, which makes another splat", f"leave out {name} or distil")
    shared = {name: cfg[name] for name in ("run", "gaussians", "invalid", "method")}
    scene = {"scene": cfg.scene} if cfg.run is None and "scene" in cfg else {}  # beside a run: its finer photos
    with track_runs(discard=True):  # unlocks the folder of the distilled splat before the enhancement
        folder = distil_run(compose_job("distil", cfg, **shared, **scene)).folder
    distilled_cfg = cfg.copy()
    if cfg.run is not None:
        distilled_cfg.run = str(folder)
        distilled_cfg.merge_with({"invalid": "refuse", "method": "auto"})  # options of the given splat
    else:
        distilled_cfg.gaussians = str(folder / "splat.ply")
    return distilled_cfg


def _print_summary(views: Sequence[EnhancedView], folder: Path, console: Console) -> float:
    """Print the images' folder and the run times; return the network's median time in milliseconds."""
    network_ms = statistics.median(view.enhancing for view in views)
    preparation_ms = statistics.median(view.preparing for view in views)
    unchanged = sum(view.unchanged for view in views)
    if unchanged:
        reason = "no photo shows anything of them, or the splat was fitted to them and is nearer to their photos"
        print_line(console, f"{unchanged} of {len(views)} views are as they were rendered: {reason}")
    times = f"{network_ms:.0f} ms each (median) and {preparation_ms:.0f} ms for its references"
    print_line(console, f"{folder}: {len(views)} images, {times}")
    return network_ms
