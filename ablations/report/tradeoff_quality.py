"""Enhancement's part of the page of error over run time: diagrams by error and difficulty, choices, what is missing."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import pandas as pd

from ablations.study.markdown import frame, markdown
from ablations.study.plots import Mark, Panel, work_precision
from ablations.tradeoff.summary import SettingSummary, summarised
from gaussian_enhancer.metrics.comparison import written
from gaussian_enhancer.metrics.records import Record
from gaussian_enhancer.metrics.tradeoff import Point, best_within, beyond_best, cheapest_within, front

ALL = "all"
BASELINES = ("raw", "bicubic")
"""Curves that take next to no time: drawn as a line across."""

ERRORS = {
    "mse": "mean squared error",
    "dissimilarity": "1 - SSIM",
    "lpips_alex": "LPIPS (alex)",
    "lpips_vgg": "LPIPS (vgg)",
}
TIME_AXIS = "time, ms per megapixel of output"


@dataclass(frozen=True)
class TradeoffLimits:
    """What the page chooses for.

    Args:
        decibels: below the best PSNR that is put up with.
        milliseconds: an image may take.
    """

    decibels: float
    milliseconds: float


READING = """Times are those of choosing and aligning references and of the network, views in memory, per megapixel
of what comes out: median over views of the median over repeats, and so the quartiles. Mean squared error is that of the
mean PSNR over views, so that 0.1 dB is 2.3 % anywhere on its axis. Choices are made on validation scenes; test scenes
are shown.
"""


def quality_parts(
    records: Sequence[Record], titles: Mapping[str, str], asked: TradeoffLimits
) -> Iterator[tuple[str, str, str]]:
    """Text, a diagram's name and the diagram, by study and side.

    Args:
        records: of the kind quality.
        titles: of the studies.
        asked: what is chosen for.
    """
    yield READING, "", ""
    for (study, side), own in by_side(records).items():
        groups = {group: summarised(found) for group, found in grouped(own).items()}
        title = titles.get(study, study)
        yield f"### {title}: {side} scenes\n\n{_scenes(own)}\n", "", ""
        drawing = work_precision(f"{title}, {side} scenes", list(_panels(groups)), len(groups))
        yield _choices(groups, asked), f"{study}_{side}", drawing
        found, reasons = groups[ALL]
        heading = "Settings, all scenes, fastest first (**on the front** of mean squared error):"
        yield f"{heading}\n\n{markdown(setting_table(found))}", "", ""
        yield _missing(reasons), "", ""


def by_side(records: Sequence[Record]) -> dict[tuple[str, str], list[Record]]:
    """Records by study and by the side of their scenes, "validation" or "test"; variants without the study's name."""
    found: dict[tuple[str, str], list[Record]] = {}
    for record in records:
        study, _, variant = record.variant.partition("/")
        found.setdefault((study, record.scene.split("/")[0]), []).append(replace(record, variant=variant))
    return found


def grouped(records: Sequence[Record]) -> dict[str, list[Record]]:
    """Records by difficulty, "side/difficulty/scene" being their scenes, and all of them where there are several."""
    found: dict[str, list[Record]] = {}
    for record in records:
        found.setdefault(record.scene.split("/")[1], []).append(record)
    return {**found, ALL: list(records)} if len(found) > 1 else {ALL: list(records)}


def _panels(groups: Mapping[str, tuple[tuple[SettingSummary, ...], dict[str, str]]]) -> Iterator[Panel]:
    """One row of panels an error that was measured, one column a group."""
    for metric, title in ERRORS.items():
        if not any(one.error(metric) is not None for one in groups[ALL][0]):
            continue
        for group, (found, _) in groups.items():
            curves: dict[str, list[Mark]] = {}
            baseline = None
            for one in found:
                error = one.error(metric)
                if error is None:
                    continue
                if one.curve in BASELINES:
                    baseline = (f"{one.curve} {one.setting}, {one.milliseconds:.0f} ms/MP", error)
                else:
                    curves.setdefault(one.curve, []).append(
                        Mark(one.setting, one.milliseconds, error, one.low, one.high)
                    )
            named = "all scenes" if group == ALL else f"{group} scenes"
            drawn = {name: tuple(marks) for name, marks in curves.items()}
            yield Panel(f"{title}, {named}", TIME_AXIS, title, drawn, baseline)


def _choices(groups: Mapping[str, tuple[tuple[SettingSummary, ...], dict[str, str]]], asked: TradeoffLimits) -> str:
    """What is cheapest within an error, and best within a time, by group."""
    rows = []
    for group, (found, _) in groups.items():
        if not found:
            continue
        by_name = {one.name: one for one in found}
        points = points_of(found)
        cheapest = cheapest_within(points, beyond_best(points, asked.decibels))
        budget = asked.milliseconds / found[0].megapixels
        best = best_within(points, budget)
        size = f"{found[0].megapixels:.3f} MP"
        for question, chosen in (
            (f"cheapest within {asked.decibels:g} dB of the best", cheapest),
            (f"best within {asked.milliseconds:g} ms an image of {size}", best),
        ):
            if chosen is None:
                rows.append((group, question, "none", "", ""))
            else:
                one = by_name[chosen.name]
                rows.append((group, question, one.name, f"{one.milliseconds:.0f}", written("psnr", one.psnr)))
    return markdown(frame(("scenes", "asked", "setting", "ms/MP", "PSNR, dB"), rows))


def points_of(found: Sequence[SettingSummary]) -> tuple[Point, ...]:
    """Mean squared error over time."""
    return tuple(Point(one.name, one.milliseconds, one.error("mse") or 0.0) for one in found)


def setting_table(found: Sequence[SettingSummary]) -> pd.DataFrame:
    """One line a setting, fastest first, those on the front of mean squared error in bold.

    Args:
        found: settings, each over the same views.
    """
    best = {point.name for point in front(points_of(found))}
    distances = list(dict.fromkeys(name for one in found for name in one.perceptual))
    rows = []
    for one in sorted(found, key=lambda one: one.milliseconds):
        name = f"**{one.name}**" if one.name in best else one.name
        compiling = "" if one.compiling is None else f"{one.compiling:.0f}"
        memory = "" if one.memory is None else f"{one.memory:.0f}"
        errors = [written("psnr", one.psnr), written("ssim", one.dssim)]
        errors += [written(key, one.perceptual.get(key)) for key in distances]
        rows.append((name, f"{one.milliseconds:.0f}", f"{one.low:.0f} to {one.high:.0f}", memory, compiling, *errors))
    heads = ("setting", "ms/MP", "quartiles", "peak MB", "compiling, s", "PSNR, dB", "1 - SSIM")
    return frame((*heads, *(ERRORS.get(name, name) for name in distances)), rows)


def _missing(reasons: Mapping[str, str]) -> str:
    if not reasons:
        return "Missing: nothing.\n"
    lines = "".join(f"- `{name}`: {reason}\n" for name, reason in reasons.items())
    return f"Missing:\n\n{lines}"


def _scenes(records: Sequence[Record]) -> str:
    """The scenes with the number of views, and the size of what comes out."""
    scenes: dict[str, set[str]] = {}
    for record in records:
        scenes.setdefault(record.scene.partition("/")[2], set()).update({record.view} - {""})
    sizes = sorted({record.size for record in records if any(record.size)})
    places = ", ".join(f"{scene} ({len(views)} views)" for scene, views in scenes.items())
    return f"{places}; {', '.join(f'{w}x{h}' for w, h in sizes)} pixels."
