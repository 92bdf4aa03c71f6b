"""The job ``enhance``: enhance the renders of a fitted run, of a splat with its capture, or of a folder."""

import statistics
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from omegaconf import DictConfig
from rich.console import Console
from rich.progress import track

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.enhancer import Enhanced
from gaussian_enhancer.infer.plan import Plan
from gaussian_enhancer.infer.preload import file_reads
from gaussian_enhancer.infer.time_budget import within_budget
from gaussian_enhancer.metrics.records import write_records
from gaussian_enhancer.runs.compose import compose_job
from gaussian_enhancer.runs.enhancement import lost_references, process_count, ready, with_effect
from gaussian_enhancer.runs.instantiate import build
from gaussian_enhancer.runs.output import cost_records, keep_sources, write_enhanced
from gaussian_enhancer.runs.run import open_run
from gaussian_enhancer.runs.runtime import start


def written(cfg: DictConfig) -> Path | None:
    """The folder of images without a run; None where a run's folder is made, or nothing is written."""
    return Path(cfg.output) if cfg.output and not cfg.dry_run else None


def run(cfg: DictConfig) -> float | None:
    """Enhance and write images of the same names.

    With ``output`` the images alone are written there. Otherwise a run's folder is made, in the layout that ``measure
    run=`` reads: renders, enhanced images and photos side by side, the cost in records, and the plan.

    Args:
        cfg: see ``conf/enhance.yaml``.

    Returns:
        Median milliseconds an image took in the network; None where only the plan was asked for.

    Raises:
        InputError: the input cannot be used, an option is out of range, or an image cannot be written.
    """
    console = Console(stderr=True)
    if cfg.output and Path(cfg.output).is_file():
        raise InputError(cfg.output, "cannot be written: it is a file", "name a folder")
    count = process_count(cfg)
    if cfg.distil:
        cfg = _of_distilled(cfg)
    cfg = within_budget(cfg, ready, start(cfg.runtime), console)
    enhancer, task, found = ready(cfg, start(cfg.runtime))
    rules = build(cfg.plan)
    planner = found.planner(rules)
    hidden = not (cfg.runtime.progress and console.is_terminal)
    reads = file_reads(found, not cfg.output, planner, cfg.dry_run)
    for read in track(reads, "reading", console=console, disable=hidden):
        read()
    plan = Plan(task.rendered.name, rules, found.parts, () if planner is None else tuple(planner.known.values()))
    notes = found.lacks if rules.full and not cfg.dry_run else (plan.table(),)
    _print([task.note, *notes], Console() if cfg.dry_run else console)
    for lost in lost_references(enhancer, task, found):
        console.print(f"WARNING: {lost}", style="bold red", highlight=False, soft_wrap=True, markup=False)
    if cfg.dry_run:
        return None

    def written_to(folder: Path) -> list[Enhanced]:
        total = len(task.rendered.targets)
        if min(count, total) > 1:
            from gaussian_enhancer.cli.distributed_enhance import enhanced_together  # loads lightning

            return enhanced_together(folder, plan, cfg, enhancer.device.type, min(count, total))
        images = enhancer(task.rendered, planner, found.pool)
        tracked = track(images, "enhancing", total=total, console=console, disable=hidden)
        return write_enhanced(tracked, folder, task.rendered, enhancer.network.scale)

    if cfg.output:
        return _summarised(written_to(Path(cfg.output)), Path(cfg.output), console)
    job = open_run(with_effect(cfg), "enhance", task.rendered.name)
    side = job.folder / "test" / f"ours_{task.step}"
    written = written_to(side / "enhanced")
    keep_sources(task.rendered, side, enhancer.network.scale)
    write_records(job.folder / "records.jsonl", cost_records(written, job.folder.name, task))
    decided = tuple(one.plan for one in written if one.plan is not None)  # none come back from several processes
    replace(plan, views=decided or plan.views).to_file(job.folder / "plan.json")
    job.finish()
    return _summarised(written, job.folder, console)


def _of_distilled(cfg: DictConfig) -> DictConfig:
    """The configuration with the distilled splat, made where it is missing, in the given one's place.

    Raises:
        InputError: there is no splat to distil, options contradict it, or it cannot be made.
    """
    from gaussian_enhancer.cli.distil import distilled  # learns, which nothing else here does

    if cfg.run is None and cfg.gaussians is None:
        raise InputError("distil", "is asked for without a splat", "give run=FOLDER, or gaussians=FILE with scene=...")
    for name, given in (("dry_run", cfg.dry_run), ("step", cfg.step is not None)):
        if given:
            raise InputError(name, "comes with distil=true, which makes another splat", f"leave out {name} or distil")
    same = {name: cfg[name] for name in ("run", "gaussians", "invalid", "method")}
    scene = {"scene": cfg.scene} if "scene" in cfg else {}
    folder = distilled(compose_job("distil", cfg, **same, **scene)).folder
    made = cfg.copy()
    if cfg.run is not None:
        made.run = str(folder)
    else:
        made.gaussians = str(folder / "splat.ply")
    return made


def _print(lines: Sequence[str], console: Console) -> None:
    for line in filter(None, lines):
        console.print(line, highlight=False, soft_wrap=True, markup=False)


def _summarised(written: Sequence[Enhanced], folder: Path, console: Console) -> float:
    """Print where the images are and what they cost; return the network's median time in milliseconds."""
    network = statistics.median(one.enhancing for one in written)
    preparing = statistics.median(one.preparing for one in written)
    kept = sum(one.unchanged for one in written)
    if kept:
        why = "no photo shows anything of them, or the splat was fitted to them and is nearer to their photos"
        told = f"{kept} of {len(written)} views are as they were rendered: {why}"
        console.print(told, highlight=False, soft_wrap=True)
    times = f"{network:.0f} ms each (median) and {preparing:.0f} ms for its references"
    console.print(f"{folder}: {len(written)} images, {times}", highlight=False, soft_wrap=True)
    return network
