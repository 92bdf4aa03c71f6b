"""The enhance job: a fitted run, a splat with its capture, or a folder of renders, to enhanced images."""

import copy
import os
import shutil
import statistics
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import torch
from omegaconf import DictConfig, open_dict
from rich.console import Console
from rich.progress import track

from gaussian_enhancer.align.alignment import Reprojected
from gaussian_enhancer.align.depth_search import SEARCHES, DepthKind
from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import whole_file
from gaussian_enhancer.infer.enhancer import Enhanced, Enhancer
from gaussian_enhancer.infer.plan import Plan
from gaussian_enhancer.infer.preload import file_reads
from gaussian_enhancer.infer.tiles import check_tiles
from gaussian_enhancer.infer.time_budget import within_budget
from gaussian_enhancer.infer.validated_inputs import ValidatedInputs, validate_inputs
from gaussian_enhancer.infer.weights import Pretrained, load_weights
from gaussian_enhancer.metrics.records import Record, write_records
from gaussian_enhancer.network.pyramid import upsampled
from gaussian_enhancer.runs.inputs import Task, read_task
from gaussian_enhancer.runs.instantiate import build
from gaussian_enhancer.runs.run import open_run
from gaussian_enhancer.runs.runtime import choose_device, start
from gaussian_enhancer.scene.image_files import write_image
from gaussian_enhancer.scene.photos import read_header
from gaussian_enhancer.scene.posed import ReadPhoto
from gaussian_enhancer.scene.rendered import RenderedSet


def run(cfg: DictConfig) -> float | None:
    """Enhance and write images of the same names.

    With ``output`` the images alone are written there. Otherwise a run's folder is made in the layout that ``measure
    run=`` reads: renders, enhanced images and photos side by side, the cost in records, and the plan.

    Returns:
        Median milliseconds an image took in the network; None where the plan alone was asked for.
    """
    console = Console(stderr=True)
    if cfg.output and Path(cfg.output).is_file():
        raise InputError(cfg.output, "cannot be written: it is a file", "name a folder")
    count = _processes(cfg)
    cfg = within_budget(cfg, ready, start(cfg.runtime), console)
    enhancer, task, found = ready(cfg, start(cfg.runtime))
    count = min(count, max(1, len(task.rendered.targets)))
    rules, scale = build(cfg.plan), enhancer.network.scale
    planner = found.planner(rules)
    hidden = not (cfg.runtime.progress and console.is_terminal)
    reads = file_reads(found, not cfg.output, planner, cfg.dry_run)
    for read in track(reads, "reading", console=console, disable=hidden):
        read()
    plan = Plan(task.rendered.name, rules, found.parts, () if planner is None else tuple(planner.known.values()))
    for line in (task.note, *(found.lacks if rules.full and not cfg.dry_run else (plan.table(),))):
        if line:
            (Console() if cfg.dry_run else console).print(line, highlight=False, soft_wrap=True, markup=False)
    if cfg.dry_run:
        return None

    def written_to(folder: Path) -> list[Enhanced]:
        if count > 1:
            from gaussian_enhancer.train.processes import launch

            every: list[Enhanced] = launch(_share, cfg, enhancer.device.type, count, folder, plan, count)
            return every
        total = len(task.rendered.targets)
        images = enhancer(task.rendered, planner, found.pool)
        return _write(track(images, "enhancing", total=total, console=console, disable=hidden), folder)

    if cfg.output:
        return _tell(written_to(Path(cfg.output)), Path(cfg.output), console)
    job = open_run(with_effect(cfg), "enhance", task.rendered.name)
    side = job.folder / "test" / f"ours_{task.step}"
    written = written_to(side / "enhanced")
    if scale == 1:
        _keep_sources(task.rendered, side)
    else:
        _keep_fine_sources(task.rendered, side, scale)
    write_records(job.folder / "records.jsonl", [_cost(one, job.folder.name, task) for one in written])
    decided = tuple(one.plan for one in written if one.plan is not None)  # none come back from several processes
    replace(plan, views=decided or plan.views).to_file(job.folder / "plan.json")
    job.finish()
    return _tell(written, job.folder, console)


def with_effect(cfg: DictConfig) -> DictConfig:
    """The configuration without what changes no image: a plan that leaves nothing out, and how much is shown of it.

    Runs from before there were plans are found again by ``plan=full``. Views that are not steadied are as before, too.
    """
    kept = copy.deepcopy(cfg)
    with open_dict(kept):
        unset = {name: not kept.get(name) for name in ("budget_ms", "temporal_smoothing")}
        for name, idle in {"dry_run": True, **unset, "plan": build(cfg.plan).full}.items():
            if idle:
                kept.pop(name, None)
    return kept


def ready(cfg: DictConfig, device: torch.device) -> tuple[Enhancer, Task, ValidatedInputs]:
    """What enhances, what is enhanced of what was given, and what of it is used."""
    pretrained = load_weights(cfg.weights)
    task = read_task(cfg, device.type, pretrained.reference_config.fine)
    asked = _asked(pretrained, cfg, task.depth)
    found = validate_inputs(task.rendered, asked, build(cfg.plan), pretrained.network.scale)
    strength = pretrained.strength if cfg.strength is None else float(cfg.strength)
    enhancer = Enhancer(
        pretrained.network,
        found.reference_config,
        device,
        cfg.precision,
        cfg.tile,
        strength=strength,
        temporal_smoothing=float(cfg.temporal_smoothing),
        colour_clamping=int(cfg.colour_clamping),
    )
    check_tiles(enhancer.tile, enhancer.halo)
    return enhancer, replace(task, rendered=found.rendered), found


def _share(cfg: DictConfig, folder: Path, plan: Plan, count: int) -> list[Enhanced]:
    """One process's part of the views, by the plan that was made; all of them are returned, in their order."""
    from gaussian_enhancer.cli.distributed_enhance import predicted

    device = start(cfg.runtime)
    device = torch.device("cuda", int(os.environ["LOCAL_RANK"])) if device.type == "cuda" else device
    enhancer, task, found = ready(cfg, device)
    planner = found.planner(plan.rules, plan.views)
    return predicted(enhancer, task.rendered, folder, count, cfg.runtime.progress, planner)


def _processes(cfg: DictConfig) -> int:
    """How many processes share the views.

    Raises:
        InputError: the number is not positive, there are fewer graphics cards, or frames depend on those before.
    """
    count = cfg.runtime.get("processes", 1)
    if not isinstance(count, int) or count < 1:
        raise InputError("runtime.processes", f"is {count!r}", "give a positive number")
    if count > 1 and cfg.temporal_smoothing:
        raise InputError(
            "runtime.processes",
            f"is {count} with temporal_smoothing={cfg.temporal_smoothing}",
            "enhance a path by one process",
        )
    if count > 1 and choose_device(cfg.runtime.device).type == "cuda" and count > torch.cuda.device_count():
        received = f"is {count} on {torch.cuda.device_count()} graphics cards"
        raise InputError("runtime.processes", received, "give at most one process a card")
    return count


def _asked(pretrained: Pretrained, cfg: DictConfig, depth: DepthKind) -> ReferenceConfig:
    """The preparation that the network was trained with, for the depth and the number of references that there are.

    Args:
        pretrained: the weights.
        cfg: the job's configuration.
        depth: what the input's depth is where the user does not tell.

    Raises:
        InputError: the user names no kind of depth.
    """
    kind = depth if cfg.depth_kind == "auto" else cfg.depth_kind
    if kind not in SEARCHES:
        raise InputError("depth_kind", f"is {kind!r}", f"choose auto, {', '.join(SEARCHES)}")
    reference_config = pretrained.reference_config
    if isinstance(reference_config.warp, Reprojected):
        reference_config = replace(reference_config, warp=replace(reference_config.warp, depth=kind))
    if cfg.max_references is None:
        return reference_config
    count = cfg.max_references
    return replace(reference_config, references=count, candidates=max(count, reference_config.candidates))


def _write(views: Iterable[Enhanced], folder: Path) -> list[Enhanced]:
    """Write each image as it comes; what was written is returned without its pixels."""
    written = []
    for one in views:
        write_image(folder / one.name, one.image)
        written.append(replace(one, image=one.image[:, :0, :0]))
    return written


def _keep_sources(rendered: RenderedSet, side: Path) -> None:
    """Put renders and photos beside the enhanced images: copies of their files where they have one."""
    for view in rendered.targets:
        for part, read in (("renders", view.read), ("gt", view.read_photo)):
            if read is None:
                continue
            path = side / part / view.name
            if isinstance(read, ReadPhoto) and _as_stored(read) and read.path.suffix == path.suffix:
                with whole_file(path) as temporary:
                    shutil.copyfile(read.path, temporary)
            else:
                write_image(path, read())


def _keep_fine_sources(rendered: RenderedSet, side: Path, scale: int) -> None:
    """Put renders, enlarged bicubically, and photos that are as fine beside images that are finer than the renders."""
    for view in rendered.targets:
        if view.read is not None:
            write_image(side / "renders" / view.name, upsampled(view.read()[None], scale)[0])
        if view.read_fine_photo is not None:
            write_image(side / "gt" / view.name, view.read_fine_photo())


def _as_stored(read: ReadPhoto) -> bool:
    """Whether what is read is what the file holds."""
    header = read_header(read.path)
    return read.lens is None and not header.has_alpha and (header.height, header.width) == (read.height, read.width)


def _cost(one: Enhanced, run_name: str, task: Task) -> Record:
    values: dict[str, float | None] = {"milliseconds": one.enhancing}
    splat = f"ours_{task.step}"
    return Record("cost", run_name, task.rendered.name, splat, one.name, "enhanced", values)


def _tell(written: list[Enhanced], folder: Path, console: Console) -> float:
    network = statistics.median(one.enhancing for one in written)
    preparing = statistics.median(one.preparing for one in written)
    console.print(
        f"{folder}: {len(written)} images, {network:.0f} ms each (median) and {preparing:.0f} ms for its references",
        highlight=False,
        soft_wrap=True,
    )
    return network
