"""Sections of the simulator's page: the view, each type of artefact, each gate, stage 2, samples.

Axes: b batch, h height, w width.
"""

import inspect
from collections.abc import Mapping, Sequence

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.degrade.artefact_types import ARTEFACTS
from gaussian_enhancer.degrade.artefacts.rng import spawn
from gaussian_enhancer.degrade.artefacts.view import View
from gaussian_enhancer.degrade.gates.gate import ArtefactStep, Gate
from gaussian_enhancer.degrade.manual import degrade
from gaussian_enhancer.degrade.simulator import NoSecondStage, Simulator
from gaussian_enhancer.report.figures import apply_colour_map
from gaussian_enhancer.report.simulation import EDGE, ImageRow, Section
from gaussian_enhancer.scene.photos import resize

STRENGTHS = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Strengths of artefacts, which are the columns of the sheet of artefact types."""


def shrink_view(view: View) -> View:
    """Copy of a view whose longer side has at most `EDGE` pixels.

    Depth is resampled by nearest neighbour: no values are interpolated, and pixels without depth remain without depth.
    """
    height, width = view.image.shape[-2:]
    factor = min(1.0, EDGE / max(height, width))
    size = max(1, round(height * factor)), max(1, round(width * factor))
    if size == (height, width):
        return view
    image, alpha = (
        None if plane is None else torch.stack([resize(channels, *size) for channels in plane])
        for plane in (view.image, view.alpha)
    )
    depth = None if view.depth is None else F.interpolate(view.depth, size=size, mode="nearest-exact")
    return View(view.image if image is None else image, depth, alpha)


def view_section(view: View, real_render: Float[Tensor, "1 3 h w"] | None) -> Section:
    """The input of the simulator: photo, real render, depth and opacity.

    Args:
        view: one sample, reduced in size.
        real_render: the splat's render of the view at any size; None if there is none.
    """
    images = {"photo": view.image[0]}
    if real_render is not None:
        images["real render"] = shrink_view(View(real_render)).image[0]
    if view.depth is not None:
        images["depth: near is light"] = depth_colours(view.depth[0], view.depth[0])
    if view.alpha is not None:
        images["opacity"] = view.alpha[0].expand(3, -1, -1)
    return Section("View", "Input of the simulator.", (ImageRow("", tuple(images.values()), tuple(images)),))


def type_sections(view: View, seed: int) -> tuple[Section, ...]:
    """Each type of artefact at five strengths: colours and, if it is known, depth.

    The random draws are the same within a row.

    Args:
        view: one sample.
        seed: seed of the draws.
    """
    strength = view.image.new_tensor(STRENGTHS)
    copies = view[torch.zeros(len(STRENGTHS), dtype=torch.long, device=view.image.device)]
    captions = tuple(f"{value:g}" for value in STRENGTHS)
    colours, depths = [], []
    for name, artefact in ARTEFACTS.items():
        degraded = artefact(copies, strength, [torch.Generator().manual_seed(seed) for _ in STRENGTHS])
        description = (inspect.getdoc(artefact) or "").partition("\n")[0]
        colours.append(ImageRow(name, tuple(degraded.image), captions, description))
        if degraded.depth is not None and view.depth is not None:
            depths.append(
                ImageRow(name, tuple(depth_colours(depth, view.depth[0]) for depth in degraded.depth), captions)
            )
    text = "From strength 0 (the photo) to 1 (the worst case in splat renders); each row has the same random draw."
    sections = [Section("Types", text, tuple(colours), "types")]
    if depths:
        text = "Effect of each type on the depth: light: near, dark: far, black: no surface."
        sections.append(Section("Types: depth", text, tuple(depths), "types_depth"))
    return tuple(sections)


def gate_section(view: View, gates: Mapping[str, Gate | str], seed: int, draws: int = 10) -> Section:
    """Random draws of each gate, with stage 1 only.

    Args:
        view: one sample.
        gates: gates by name; a text instead of a gate states why there are no draws of it.
        seed: seed of the draws, the same for all gates.
        draws: number of draws of each gate.
    """
    copies = view[torch.zeros(draws, dtype=torch.long, device=view.image.device)]
    rows = []
    for name, gate in gates.items():
        if isinstance(gate, str):
            rows.append(ImageRow(name, note=f"not drawn: {gate}"))
            continue
        generators = spawn(draws, torch.Generator().manual_seed(seed))
        steps = [gate.draw(generator) for generator in generators]
        degraded = degrade(copies, steps, generators)
        rows.append(ImageRow(name, tuple(degraded.image), tuple(map(describe_artefacts, steps))))
    text = "Random draws of each gate, stage 1 only. Below: the chosen types in their order, with strengths."
    return Section("Gates", text, tuple(rows), "gates")


def generator_section(
    view: View, simulator: Simulator, seed: int, real_render: Float[Tensor, "1 3 h w"] | None, draws: int = 4
) -> Section:
    """Stage 2 beside the real render of the same view, at full size: photo, M, L for several seeds, real render.

    Args:
        view: one sample.
        simulator: both stages.
        seed: seed of stage 1; stage 2 uses this one and the following ones.
        real_render: the splat's render of the view; None if there is none.
        draws: number of draws of stage 2.

    Raises:
        InputError: stage 2 requires a real render and there is none.
    """
    if isinstance(simulator.second_stage, NoSecondStage):
        return Section("Generator", "Stage 2 is switched off (generator=none): the images are stage 1's output.")
    generator = torch.Generator().manual_seed(seed)
    steps = simulator.gate.draw(generator)
    manual = degrade(view, [steps], [generator])
    views = {"photo": view, "M, stage 1": manual}
    for stage_seed in range(seed, seed + draws):
        views[f"L, stage 2, seed {stage_seed}"] = simulator.second_stage(
            manual, [torch.Generator().manual_seed(stage_seed)], real_render
        )
    if real_render is not None:
        views["real render"] = View(real_render)
    images = tuple(shrink_view(shown_view).image[0] for shown_view in views.values())
    note = "" if real_render is not None else " There is no real render of a photo without its run."
    text = f"Stage 2 (L) learns to bring stage 1 (M) closer to real renders.{note}"
    row = ImageRow(f"stage 1: {describe_artefacts(steps)}", images, tuple(views))
    return Section("Generator", text, (row,), "generator")


def sample_section(samples: Sequence[tuple[str, Sequence[ArtefactStep], View]], count: int) -> Section:
    """Samples of the chosen gate and generator.

    Args:
        samples: file, steps and reduced image of each sample shown.
        count: number of samples written.
    """
    captions = tuple(f"{file}: {describe_artefacts(steps)}" for file, steps, _ in samples)
    text = f"{count} written at full size" + ("." if count == len(samples) else f", the first {len(samples)} shown.")
    return Section("Samples", text, (ImageRow("", tuple(view.image[0] for *_, view in samples), captions),))


def describe_artefacts(steps: Sequence[ArtefactStep]) -> str:
    """Text of a sample's artefacts, with their strengths."""
    phrases = [f"{step.type} {step.strength:.2f}{' in a region' if step.regional else ''}" for step in steps]
    return " · ".join(phrases) if phrases else "nothing"


def depth_colours(depth: Float[Tensor, "1 h w"], undegraded: Float[Tensor, "1 h w"]) -> Float[Tensor, "3 h w"]:
    """Inverse depth as colours, near light and far dark, black where nothing was hit.

    Args:
        depth: the depth to show.
        undegraded: the undegraded depth, whose range sets the scale.
    """
    valid = undegraded[undegraded > 0]
    limits = valid.reciprocal().quantile(valid.new_tensor([0.01, 0.99])).tolist() if len(valid) else [0.0, 1.0]
    low, high = limits if limits[1] > limits[0] else (0.0, 2 * limits[1])
    nearness = (depth.clamp(min=1e-9).reciprocal() - low) / (high - low)
    # The undegraded range maps to the middle of the colours, so that nearer and farther depths remain distinguishable.
    share = torch.where(depth > 0, 0.2 + 0.6 * nearness, 0.0).clamp(0, 1)
    return torch.where(depth > 0, apply_colour_map(share[0].cpu()).to(depth), 0.0)
