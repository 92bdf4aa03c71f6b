"""Makes the part on enhancement of the page of error over run time: diagrams by error and difficulty, best settings."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import pandas as pd

from ablations.study.markdown import frame, markdown
from ablations.study.pareto import cheapest_within, error_above_best, pareto_front
from ablations.study.plots import Mark, Panel, work_precision
from ablations.study.sections import missing_section
from ablations.tradeoff.summary import SettingSummary, summarise
from gaussian_enhancer.metrics.comparison import format_value
from gaussian_enhancer.metrics.records import Record
from gaussian_enhancer.metrics.tradeoff import Point, best_within

ALL = "all"
BASELINES = ("raw", "bicubic")
"""Curves of negligible time, drawn as a horizontal line."""

ERRORS = {
    "mse": "mean squared error",
    "dissimilarity": "1 - SSIM",
    "lpips_alex": "LPIPS (alex)",
    "lpips_vgg": "LPIPS (vgg)",
}
TIME_AXIS = "time, ms per megapixel of output"


@dataclass(frozen=True)
class TradeoffLimits:
    """Limits by which the page chooses settings.

    Args:
        decibels: largest loss below the best PSNR.
        milliseconds: largest time per image.
    """

    decibels: float
    milliseconds: float


READING = """Times are those of choosing and aligning references and of the network, views in memory, per
megapixel of what comes out. Each view is timed several times and its median taken; the table gives the median and the
quartiles over views. Mean squared error is that of the mean PSNR over views; 0.1 dB is 2.3 % anywhere on its axis.
Choices are made on validation scenes; test scenes, which are of the second validation ([data](../data.md)), are shown.
All are procedural and in-distribution, with fits of 1,000 steps. `GE` and `GE++` have the paper's simulators and
fusions in our networks, as the rows `ours` of [table 10](tables/desk/table_10.md).
"""


def quality_parts(
    records: Sequence[Record], titles: Mapping[str, str], limits: TradeoffLimits
) -> Iterator[tuple[str, str, str]]:
    """Yield parts of the page, by study and side: text, name of a diagram, and the diagram; both may be empty.

    Args:
        records: of the kind quality.
        titles: of the studies.
        limits: limits by which settings are chosen.
    """
    yield READING, "", ""
    for (study, side), study_records in group_by_side(records).items():
        groups = {group: summarise(settings) for group, settings in group_by_difficulty(study_records).items()}
        title = titles.get(study, study)
        yield f"### {title}: {side} scenes\n\n{_scenes(study_records)}\n", "", ""
        diagram = work_precision(f"{title}, {side} scenes", list(_panels(groups)), len(groups))
        yield _choices(groups, limits), f"{study}_{side}", diagram
        settings, reasons = groups[ALL]
        heading = "Settings, all scenes, fastest first (**on the front** of mean squared error):"
        yield f"{heading}\n\n{markdown(setting_table(settings))}", "", ""
        yield missing_section((f"`{name}`", reason) for name, reason in reasons.items()), "", ""


def group_by_side(records: Sequence[Record]) -> dict[tuple[str, str], list[Record]]:
    """Records by study and by side of their scene, "validation" or "test"; the study is removed from variants."""
    records_by_side: dict[tuple[str, str], list[Record]] = {}
    for record in records:
        study, _, variant = record.variant.partition("/")
        records_by_side.setdefault((study, record.scene.split("/")[0]), []).append(replace(record, variant=variant))
    return records_by_side


def group_by_difficulty(records: Sequence[Record]) -> dict[str, list[Record]]:
    """Records by difficulty (of the scene "side/difficulty/scene"), and all of them; only all if there is one."""
    by_difficulty: dict[str, list[Record]] = {}
    for record in records:
        by_difficulty.setdefault(record.scene.split("/")[1], []).append(record)
    return {**by_difficulty, ALL: list(records)} if len(by_difficulty) > 1 else {ALL: list(records)}


def _panels(groups: Mapping[str, tuple[tuple[SettingSummary, ...], dict[str, str]]]) -> Iterator[Panel]:
    """Panels: one row per measured error, one column per group."""
    for metric, title in ERRORS.items():
        if not any(setting.error(metric) is not None for setting in groups[ALL][0]):
            continue
        for group, (settings, _) in groups.items():
            curves: dict[str, list[Mark]] = {}
            baseline = None
            for setting in settings:
                error = setting.error(metric)
                if error is None:
                    continue
                if setting.curve in BASELINES:
                    baseline = (f"{setting.curve} {setting.setting}, {setting.milliseconds:.0f} ms/MP", error)
                else:
                    curves.setdefault(setting.curve, []).append(
                        Mark(setting.setting, setting.milliseconds, error, setting.low, setting.high)
                    )
            group_title = "all scenes" if group == ALL else f"{group} scenes"
            yield Panel(f"{title}, {group_title}", TIME_AXIS, title, curves, baseline)


def _choices(groups: Mapping[str, tuple[tuple[SettingSummary, ...], dict[str, str]]], limits: TradeoffLimits) -> str:
    """The cheapest setting within an error, and the best within a time, by group."""
    rows = []
    for group, (settings, _) in groups.items():
        if not settings:
            continue
        by_name = {setting.name: setting for setting in settings}
        points = points_of(settings)
        cheapest = cheapest_within(points, error_above_best(points, limits.decibels))
        budget = limits.milliseconds / settings[0].megapixels
        best_point = best_within(points, budget)
        size = f"{settings[0].megapixels:.3f} MP"
        for question, chosen in (
            (f"cheapest within {limits.decibels:g} dB of the best", cheapest),
            (f"best within {limits.milliseconds:g} ms an image of {size}", best_point),
        ):
            if chosen is None:
                rows.append((group, question, "none", "", ""))
            else:
                setting = by_name[chosen.name]
                rows.append(
                    (group, question, setting.name, f"{setting.milliseconds:.0f}", format_value("psnr", setting.psnr))
                )
    return markdown(frame(("scenes", "asked", "setting", "ms/MP", "PSNR, dB"), rows))


def points_of(settings: Sequence[SettingSummary]) -> tuple[Point, ...]:
    """The settings as points of mean squared error over time."""
    return tuple(Point(setting.name, setting.milliseconds, setting.error("mse") or 0.0) for setting in settings)


def setting_table(settings: Sequence[SettingSummary]) -> pd.DataFrame:
    """One line per setting, fastest first; settings on the Pareto front of mean squared error are bold.

    Args:
        settings: settings, each over the same views.
    """
    front_names = {point.name for point in pareto_front(points_of(settings))}
    distances = list(dict.fromkeys(name for setting in settings for name in setting.perceptual))
    rows = []
    for setting in sorted(settings, key=lambda setting: setting.milliseconds):
        name = f"**{setting.name}**" if setting.name in front_names else setting.name
        compile_seconds = "" if setting.compile_seconds is None else f"{setting.compile_seconds:.0f}"
        memory = "" if setting.memory is None else f"{setting.memory:.0f}"
        errors = [format_value("psnr", setting.psnr), format_value("ssim", setting.dssim)]
        errors += [format_value(key, setting.perceptual.get(key)) for key in distances]
        time, quartiles = f"{setting.milliseconds:.0f}", f"{setting.low:.0f} to {setting.high:.0f}"
        rows.append((name, time, quartiles, memory, compile_seconds, *errors))
    heads = ("setting", "ms/MP", "quartiles", "peak MB", "compiling, s", "PSNR, dB", "1 - SSIM")
    return frame((*heads, *(ERRORS.get(name, name) for name in distances)), rows)


def _scenes(records: Sequence[Record]) -> str:
    """The scenes with their numbers of views, and the sizes of the output images."""
    scenes: dict[str, set[str]] = {}
    for record in records:
        scenes.setdefault(record.scene.partition("/")[2], set()).update({record.view} - {""})
    sizes = sorted({record.size for record in records if any(record.size)})
    places = ", ".join(f"{scene} ({len(views)} views)" for scene, views in scenes.items())
    return f"{places}; {', '.join(f'{w}x{h}' for w, h in sizes)} pixels."
