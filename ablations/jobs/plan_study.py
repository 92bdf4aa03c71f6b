"""``gaussian-enhancer plan_study``: what plans leave out of each scene, the time saved, and the cost in quality.

Every plan enhances the same views in the same process, in turn, with the steps of the job enhance: read and validate
files, make the plan, warp references, run the network. Images are not written.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import torch
from omegaconf import DictConfig
from rich.console import Console

from ablations.report.plan_study import KIND, RATIOS, PlanAims, PlanScenes, plan_plot, plan_study_page
from ablations.study.cost import deviation, peak_memory, times_faster
from ablations.study.engine import Study, job
from ablations.study.missing import missing_record
from ablations.suite.evaluation import StudyCell, compose_checked, fitted_cell
from gaussian_enhancer.console import print_line
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import write_text
from gaussian_enhancer.infer.enhancer import EnhancedView
from gaussian_enhancer.infer.options import EnhancementOptions
from gaussian_enhancer.infer.plan import Plan, Rules
from gaussian_enhancer.infer.preload import validation_reads
from gaussian_enhancer.infer.validated_inputs import validate_inputs
from gaussian_enhancer.infer.weights import Pretrained, load_weights
from gaussian_enhancer.metrics.cost import Timing, time_interleaved
from gaussian_enhancer.metrics.lpips import PerceptualDistance, requested_distances
from gaussian_enhancer.metrics.pair import PROTOCOL, measure_pair
from gaussian_enhancer.metrics.records import Record, read_records
from gaussian_enhancer.runs.instantiate import build
from gaussian_enhancer.runs.runtime import start
from gaussian_enhancer.scene.rendered import RenderedSet
from gaussian_enhancer.scene.renders import read_run

WORLDS = {
    "test": "Scenes by which nothing of the plan was chosen",
    "training": "Training worlds, by which the thresholds were chosen",
}


PlanOutcome = tuple[Plan, tuple[EnhancedView, ...]]
"""A plan with the decision of every view of a scene, and the enhanced views."""


def output_path(cfg: DictConfig) -> Path:
    """The file of records."""
    return Path(cfg.results) / f"leaving_out_{cfg.worlds.name}.jsonl"


def study(cfg: DictConfig, device: torch.device) -> Study[str]:
    """Every plan on every scene.

    Raises:
        InputError: the configuration names an unknown plan, or there is no fit.
    """
    for name in (cfg.baseline, cfg.shown):
        if name not in cfg.worlds.plans:
            raise InputError("worlds.plans", f"names no {name!r}", "give the plans that are compared")
    if not (cfg.records_only or cfg.fit_missing or (Path(cfg.runs) / "fit").is_dir()):  # every scene would be missing
        received = f"is {cfg.runs}, which holds no fit"
        raise InputError("runs", received, "name the folder of runs, or add fit_missing=true")
    scenes = () if cfg.records_only else tuple(map(str, cfg.worlds.cells))
    console = Console(stderr=True)
    return Study(
        scenes,
        lambda scene: _cell(cfg, scene, console),
        ("scene",),
        option="worlds",
        records=output_path(cfg),
        report=lambda: _reported(cfg, console),
    )


run = job(study)


def _reported(cfg: DictConfig, console: Console) -> float | None:
    """Write diagram and page; return the least speed-up of the shown plan over scenes, None without one."""
    results, aims = Path(cfg.results), aims_of(cfg)
    files = {name: results / f"leaving_out_{name}.jsonl" for name in WORLDS}
    sets = [
        PlanScenes(title, name, read_records(files[name]) if files[name].is_file() else (), aims)
        for name, title in WORLDS.items()
    ]
    page, drawing = Path(cfg.markdown), results / "leaving_out.svg"
    write_text(drawing, plan_plot(sets[0]))
    already_good = results / "already_good.jsonl"
    good = read_records(already_good) if already_good.is_file() else ()
    write_text(page, plan_study_page(cfg.title, cfg.about, sets, good, drawing, page))
    print_line(console, f"{page}, {drawing}")
    ratios = [cost.ratio for cost in sets[0].costs() if cost.ratio is not None]
    return min(ratios, default=None)


def aims_of(cfg: DictConfig) -> PlanAims:
    """The aims of the shown plan; see ``conf/plan_study.yaml``."""
    return PlanAims(cfg.baseline, cfg.shown, cfg.faster, cfg.slower, cfg.allowed)


def enhanced_by(rules: Rules, pretrained: Pretrained, rendered: RenderedSet, device: torch.device) -> PlanOutcome:
    """Enhance a set's views as the job enhance does, by one set of rules.

    Args:
        rules: what may be left out.
        pretrained: the network with its reference_config.
        rendered: targets, whose depth is the surface's, and references.
        device: where the network runs.
    """
    validated = validate_inputs(rendered, pretrained.reference_config, rules, pretrained.network.scale)
    enhancer = EnhancementOptions().enhancer(pretrained, validated.reference_config, device)
    planner = validated.planner(rules)
    for read_file in validation_reads(validated, planner):
        read_file()
    images = tuple(enhancer(validated.rendered, planner, validated.pool))
    views = tuple(enhanced.plan for enhanced in images if enhanced.plan is not None)
    return Plan(rendered.name, rules, validated.parts, views), images


def _cell(cfg: DictConfig, name: str, console: Console) -> Iterator[Record]:
    """The records of one scene, or the one that says why there are none."""
    choice = cfg.worlds.cells[name]
    splat = "3dgs/sparse"
    console.print(f"{cfg.worlds.name}: {name}", highlight=False)
    try:
        cell = StudyCell(name, splat, (*choice.fit, *cfg.worlds.fit), choice.every)
        yield from _measured(cfg, cell, bool(choice.get("background")))
    except InputError as error:
        print_line(console, f"{name} is missing: {error}")
        yield missing_record(cfg.baseline, str(error), scene=name, splat=splat)


def _measured(cfg: DictConfig, cell: StudyCell, background: bool) -> Iterator[Record]:
    fit = fitted_cell(cfg, cell)
    rendered = read_run(fit)
    rendered = replace(rendered, targets=rendered.targets[:: cell.every])
    device, pretrained = start(cfg.runtime), load_weights(cfg.weights)
    rules = {
        str(name): build(compose_checked("enhance", cfg, overrides).plan)
        for name, overrides in cfg.worlds.plans.items()
    }
    outcomes: dict[str, PlanOutcome] = {}

    def enhance(name: str) -> None:
        outcomes[name] = enhanced_by(rules[name], pretrained, rendered, device)

    calls: dict[str, Callable[[], object]] = {name: partial(enhance, name) for name in rules}
    times = time_interleaved(calls, cfg.repeats, 1, device)
    first_view = replace(rendered, targets=rendered.targets[:1])
    distances = requested_distances(cfg.lpips, cfg.backbones, device)
    for name, (plan, images) in outcomes.items():
        peak = peak_memory(partial(enhanced_by, plan.rules, pretrained, first_view, device), device)
        record = _scene_record(fit.name, cell, name, outcomes[name], times[name], peak, background)
        ratios = dict(zip(RATIOS, times_faster(times[name], times[cfg.baseline]), strict=True))
        yield replace(record, metrics={**record.metrics, **ratios})
        for record in _view_records(rendered, images, distances):
            yield replace(record, run=fit.name, scene=cell.scene, splat=cell.splat, variant=name)


def _scene_record(
    fit: str, cell: StudyCell, name: str, outcome: PlanOutcome, timing: Timing, peak: int, background: bool
) -> Record:
    """Time, memory and what was left out of a scene."""
    plan, images = outcome
    count = len(images)
    left_out_shares = [share for view in plan.views for share in view.left_out.values()]
    metrics: dict[str, float | None] = {
        "milliseconds": timing.milliseconds / count,
        "milliseconds_deviation": deviation(timing) / count,
        "peak_memory_mb": peak / 1e6,
        "views": count,
        "background": float(background),
        "passed": plan.passed_share,
        "candidates_taken": sum(len(view.references or ()) for view in plan.views),
        "candidates_left_out": len(left_out_shares),
        "candidates_unseeing": sum(share < plan.rules.share for share in left_out_shares),
    }
    metrics |= {f"part {part.name}": float(part.used) for part in plan.parts}
    reasons = {f"part {part.name}": part.why for part in plan.parts}
    height, width = images[0].image.shape[-2:]
    rounds = f"{len(timing.repeats)} interleaved repeats of reading, planning and enhancing {count} views"
    protocol = f"{rounds}, median; times faster: median of the repeats' own ratios"
    return Record(KIND, fit, cell.scene, cell.splat, "", name, metrics, reasons, (width, height), protocol)


def _view_records(
    rendered: RenderedSet, images: Sequence[EnhancedView], distances: list[PerceptualDistance]
) -> Iterator[Record]:
    """Error of every view against its photo."""
    for view, enhanced in zip(rendered.targets, images, strict=True):
        if view.read_photo is None:
            raise InputError(view.name, "has no photo to be measured against", "give a run with its photos")
        quality = measure_pair(enhanced.image, view.read_photo(), distances)
        height, width = enhanced.image.shape[-2:]
        yield Record("quality", "", "", "", view.name, "", quality.metrics, quality.reasons, (width, height), PROTOCOL)
