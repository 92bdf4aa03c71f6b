"""``gaussian-enhancer convergence``: gain against the age of a splat.

Every snapshot of the fits is enhanced and measured, frame by frame and block by block. A run is a folder of the job
``fit`` with several snapshots (``settings.snapshots``). Runs of test scenes are named apart (``tests``) and have a
section of their own, since no choice may be based on them. New rows replace recorded rows of the same method, scene and
step. Without methods, the page is made from the records alone. Blocks are 16x16 pixels; a block is harmed if it loses
more than 0.5 dB. A peer and two controls are measured in the same way: ``ibgs``, ``average`` and ``two_fits``;
``two_fits:enhanced`` averages the views of both fits, enhanced by ``lr_tiny``. ``two_steps`` combines views enhanced by
``lr_tiny`` with those of an earlier step, as the job ``enhance`` does by default.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import pandas as pd
import torch
import torch.nn.functional as F
from jaxtyping import Float
from omegaconf import DictConfig
from PIL import Image
from torch import Tensor

from ablations.ibgs.method import IBGS
from ablations.scripts.before_after import DESCRIPTION, Compared, harmed_block, strip, worst_block, write_picture
from ablations.study.engine import Study, job
from ablations.study.enhanced_views import MeasuredView, enhanced_views
from ablations.study.fits import finished_fits, fits_by_scene, refuse_frozen_fits, scene_of
from ablations.study.methods import Method, average, load_enhancer, name_of, two_fits, two_steps
from ablations.study.plots import STYLE
from ablations.study.roles import ROLES, role_of, with_roles
from ablations.study.row_table import TableLayout, section_tables
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.infer.options import EnhancementOptions
from gaussian_enhancer.infer.plan import AUTO
from gaussian_enhancer.metrics.lpips import PerceptualDistance, requested_distances
from gaussian_enhancer.runs.instantiate import plain_values
from gaussian_enhancer.scene.renders import read_run, run_steps
from gaussian_enhancer.types import quantise_8_bit

BLOCK = 16
HARM = 0.5
"""Decibels that a block must lose to count as harmed."""
WITHOUT = {
    "": EnhancementOptions(),
    "without_confidence": EnhancementOptions(confidence=False),
    "plain": EnhancementOptions(confidence=False, colour_completion=False),
    "one_pass": EnhancementOptions(ensemble=False),
}
"""What a method may leave out: the confidence, or colour completion as well, or the second enhancement."""
CREDITS = {
    "plush": "noname0310, MIT licence",
    "banana": "Piero Toffanin, MIT licence",
    "cyprus": "Luca Morelli and Francesco Ioli, BSD 3-clause licence",
    "copr": "Michele M. Tobias and Alex Mandel, CC BY-SA 4.0, as this picture",
    "flowerpot": "Natowi, CC BY-SA 4.0, as this picture",
}
"""Photographer of each capture. Photos of other captures are not shown."""


def block_errors(image: Float[Tensor, "3 h w"], photo: Float[Tensor, "3 h w"]) -> Float[Tensor, "i j"]:
    """Mean squared error by block."""
    return F.avg_pool2d((image - photo).square().mean(0)[None, None], BLOCK)[0, 0]


def harm(
    render: Float[Tensor, "3 h w"], enhanced: Float[Tensor, "3 h w"], photo: Float[Tensor, "3 h w"]
) -> dict[str, float]:
    """The share of blocks that are harmed, and the squared error removed and added, as shares of the render's."""
    before, after = (
        block_errors(quantise_8_bit(image), quantise_8_bit(photo)).clamp_min(1e-7) for image in (render, enhanced)
    )
    harmed = (10 * torch.log10(after / before) > HARM).float().mean()
    removed, added = ((s * (before - after)).clamp_min(0).sum() / before.sum() for s in (1, -1))
    return {"blocks_harmed": float(harmed), "error_removed": float(removed), "error_added": float(added)}


def parse_method(method: str, device: torch.device | None = None) -> tuple[str, str, SetEnhancer]:
    """Name of a method, digest of its weights, and its enhancer.

    Args:
        method: names weights, then optionally ``@`` and a strength, then a colon and a key of `WITHOUT`.
        device: where the network runs; None is the processor.

    Raises:
        InputError: weights cannot be read, or a strength is no share.
    """
    chosen, _, extra = method.partition(":")
    if extra not in WITHOUT:
        raise InputError(method, f"ends in :{extra}", f"leave it out, or write :{' or :'.join(filter(None, WITHOUT))}")
    weights, _, strength = chosen.partition("@")
    options = replace(WITHOUT[extra], strength=share_of(method, strength) if strength else None)
    digest, enhancer = load_enhancer(weights, options, device)
    unlimited = enhancer.confidence is not None and enhancer.strength == 1
    left_out = extra.replace("_", " ")
    name = " ".join(filter(None, (f"{name_of(weights)}{'' if unlimited else f'@{enhancer.strength:g}'}", left_out)))
    return name, digest, enhancer


OTHERS = ("ibgs", "ibgs:without_exposure", "average", "two_fits", "two_fits:enhanced", "two_steps")
"""Methods that are not given by weights: a peer, two controls, and two fits and two steps enhanced by `lr_tiny`."""


def requested_methods(cfg: DictConfig, device: torch.device | None = None) -> dict[str, Method]:
    """The methods of a configuration, by name.

    Args:
        cfg: conf/convergence.yaml, composed.
        device: where networks run; None is the processor.

    Raises:
        InputError: see `parse_method`; a method's trainings or fits are missing; or two have the same name.
    """
    methods: dict[str, Method] = {}
    for method in cfg.methods:
        name, requested = _requested_method(cfg, method, device)
        if name in methods:
            raise InputError(method, f"is the second method {name}", "name each once, and label trainings differently")
        methods[name] = requested
    return methods


def _requested_method(cfg: DictConfig, method: str, device: torch.device | None) -> tuple[str, Method]:
    if method == "average":
        return "average of render and references", average()
    if method == "two_fits":
        return "average of two fits", two_fits(cfg.second)
    if method == "two_fits:enhanced":
        enhancer = load_enhancer("lr_tiny", EnhancementOptions(), device)[1]
        return "average of two enhanced fits", two_fits(cfg.second, enhancer)
    if method == "two_steps":
        return "lr_tiny two steps", two_steps("lr_tiny", device)
    if method in OTHERS:
        exposure = method == "ibgs"
        return "ibgs" if exposure else "ibgs without exposure", IBGS.from_patterns(cfg.ibgs, exposure)
    name, digest, enhancer = parse_method(method, device)
    return name, lambda fit, step: (digest, enhancer)


def share_of(method: str, strength: str) -> float:
    """The share of the change that a method applies.

    Raises:
        InputError: it is none.
    """
    try:
        share = float(strength)
    except ValueError:
        share = -1.0
    if not 0 <= share <= 1:
        raise InputError(method, f"has the strength {strength!r}", "give a number from 0 to 1 after the @")
    return share


def steps_of(fit: Path, last: bool = False) -> tuple[int, ...]:
    """The snapshots of a fit that are measured: all, or the last alone."""
    return run_steps(fit)[-1:] if last else run_steps(fit)


def measure_fit(
    methods: Mapping[str, Method], fit: Path, distances: Sequence[PerceptualDistance], last: bool = False
) -> Iterator[dict[str, object]]:
    """One row a snapshot, view and method.

    Args:
        methods: what `requested_methods` returns.
        fit: its folder.
        distances: LPIPS distances to measure as well.
        last: measure the last snapshot alone.

    Raises:
        InputError: a view has no photo.
    """
    scene = scene_of(fit)
    for step in steps_of(fit, last):
        applied = {name: method(fit, step) for name, method in methods.items()}
        enhance = {name: enhancer for name, (_, enhancer) in applied.items()}
        for view in enhanced_views(read_run(fit, step), enhance, distances, rules=AUTO):
            raw = {"raw_psnr": view.raw.metrics["psnr"], "raw_psnr_aligned": view.raw.metrics["psnr_aligned"]}
            for name, (weights, _) in applied.items():
                keys = {"method": name, "weights": weights, "scene": scene, "step": step, "view": view.view.name}
                gains = {f"gain_{metric}": value for metric, value in view.gains(name).items()}
                yield {**keys, **raw, **gains, **harm(view.render, view.results[name].image, view.photo)}


def extreme_views(methods: Mapping[str, Method], fit: Path) -> Iterator[tuple[str, Image.Image, str]]:
    """Name, picture and caption of a fit's worst and best view at its last step, by the first method.

    The worst view's crop is where enhancement adds the most error, the best view's where the raw render is worst.

    Args:
        methods: what `requested_methods` returns.
        fit: its folder.
    """
    method, first_method = next(iter(methods.items()))
    scene, step = scene_of(fit), run_steps(fit)[-1]
    photos = (
        f"Photos: {CREDITS[scene]}." if scene in CREDITS else "The photos are exact images of the procedural scene."
    )
    enhanced = enhanced_views(read_run(fit, step), {method: first_method(fit, step)[1]}, rules=AUTO)
    views = sorted(enhanced, key=lambda view: _gain(view, method))
    for word, view, crop in (("worst", views[0], harmed_block), ("best", views[-1], worst_block)):
        images = (quantise_8_bit(image) for image in (view.render, view.results[method].image, view.photo))
        shown = Compared(Path(view.view.name).stem, step, *images)
        text = (
            f"{scene} ({role_of(scene)}), {step:,} steps, view {shown.name}: the {word} of {len(views)}, "
            f"{_gain(view, method):+.2f} dB colour-aligned by {method}. The crop is where "
            f"{'enhancement adds the most error' if word == 'worst' else 'the raw render is worst'}. {photos}"
        )
        yield f"{scene}_{word}", strip(shown, crop(shown)), text


def _gain(view: MeasuredView, method: str) -> float:
    return view.gains(method)["psnr_aligned"]


def draw_curves(frame: pd.DataFrame, path: Path) -> None:
    """Draw mean aligned gain against the raw renders' aligned PSNR, one line a capture, for the first method."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    method = frame["method"].iloc[0]
    groups = frame[frame["method"] == method].groupby(["role", "scene", "step"])
    table = groups.agg(raw=("raw_psnr_aligned", "mean"), gain=("gain_psnr_aligned", "mean")).reset_index()
    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.subplots()
    marks = {"training": "o", "validation": "s", "test": "D", "procedural": "^"}
    for (role, scene), curve in table.groupby(["role", "scene"]):
        curve = curve.sort_values("step")
        axes.plot(curve["raw"], curve["gain"], marker=marks[role], label=f"{scene} ({role})")
        for _, point in curve.iterrows():
            axes.annotate(
                f"{point['step']}", (point["raw"], point["gain"]), fontsize=7, xytext=(3, 3), textcoords="offset points"
            )
    axes.axhline(0, color="grey", linewidth=0.8)
    axes.set(xlabel="raw render, colour-aligned PSNR, dB", ylabel="gain, dB", title=f"{method}; points: steps")
    axes.legend(fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    with rc_context({"svg.hashsalt": STYLE["svg.hashsalt"]}):  # equal records give an equal file
        figure.savefig(path, format="svg", metadata={"Date": None})


def find_fits(patterns: Sequence[str], tests: Sequence[str] = ()) -> list[Path]:
    """The finished fits that patterns name, one a scene. Fits of test scenes are named apart, since none may choose.

    Args:
        patterns: fits of scenes that choices may be based on.
        tests: fits of test scenes, which are reported in a section of their own.

    Raises:
        InputError: there are none, two are of one scene, a scene has no role, or a fit is named on the wrong side.
    """
    finished = finished_fits([*patterns, *tests])
    for scene in fits_by_scene(finished):
        role_of(scene)
    refuse_frozen_fits(finished_fits(patterns) if patterns else [], "chosen by")
    for fit in finished_fits(tests) if tests else []:
        if role_of(scene_of(fit)) != "test":
            raise InputError(fit, f"is of {scene_of(fit)}, which is no test scene", "name it in runs=")
    return finished


COLUMNS = ("view", "raw_psnr_aligned", "gain_psnr_aligned")
KEYS = ("method", "scene", "step")


def shown_views(page: Path) -> dict[str, str]:
    """Captions of the pictures in the page's folder, by their address on the page."""
    captions = {}
    for path in sorted(page.with_suffix("").glob("*.jpg")):
        with Image.open(path) as image:
            captions[path.relative_to(page.parent).as_posix()] = str(image.getexif()[DESCRIPTION])
    return captions


def diagram_section(frame: pd.DataFrame, page: Path) -> list[str]:
    """The section with the diagram; the diagram's file is written next to the page."""
    drawing = page.with_suffix(".svg")
    draw_curves(frame, drawing)
    return [f"![gain against raw PSNR, by capture]({drawing.name})"]


def picture_section(page: Path) -> list[str]:
    """The part of the page with single views."""
    views = shown_views(page)
    parts = [f"![raw render, enhanced view and photo]({address})\n\n{text}" for address, text in views.items()]
    return ["## The worst and the best view of each fit", *parts] if views else []


def study(cfg: DictConfig, device: torch.device) -> Study[Path]:
    """Measure every snapshot of fits, or only the last one, with every method; on request, write pictures.

    If only the last snapshots are measured, the page has means over all views in place of the diagram.

    Raises:
        InputError: weights or fits cannot be read, or a method's trainings or fits are missing.
    """
    chosen = find_fits(cfg.runs, cfg.tests) if cfg.methods else []
    methods = requested_methods(cfg, device)
    for fit, method in ((fit, method) for fit in chosen for method in methods.values()):
        for step in steps_of(fit, cfg.last):
            method(fit, step)  # missing inputs are refused before anything is measured
    distances = requested_distances(cfg.lpips, cfg.backbones, device) if chosen else []

    def measure(fit: Path) -> Iterator[dict[str, object]]:
        yield from measure_fit(methods, fit, distances, cfg.last)
        if cfg.pictures and scene_of(fit) in (*CREDITS, *ROLES["procedural"]):
            for name, picture, text in extreme_views(methods, fit):
                write_picture(Path(cfg.pictures) / f"{name}.jpg", picture, text)

    def above(frame: pd.DataFrame, page: Path) -> list[str]:
        if cfg.last:
            layout = TableLayout(**plain_values(cfg.row_table))
            return section_tables(frame, replace(layout, by={"method": "method"}), ": all views")
        return diagram_section(frame, page)

    return Study(
        chosen, measure, KEYS, COLUMNS, option="methods", derived=with_roles, above=above, below=picture_section
    )


run = job(study)
