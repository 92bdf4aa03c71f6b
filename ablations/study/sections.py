"""Sections that pages of studies share: methods, aims, means by scene and by pair, losses of frames, missing values."""

import math
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import pandas as pd

from ablations.study.aims import VERDICTS, Aims, methods_of_role, pairs_of, ranked_losses, verdicts
from ablations.study.markdown import format_gain_with_interval, frame
from ablations.study.results import Results
from ablations.study.sample import SceneSplat
from ablations.study.statistics import interval
from gaussian_enhancer.metrics.comparison import format_value
from gaussian_enhancer.metrics.records import HIGHER_IS_BETTER, Record

TITLES = {
    "psnr": "PSNR, dB",
    "psnr_aligned": "colour-aligned PSNR, dB",
    "ssim": "SSIM",
    "lpips_alex": "LPIPS (alex)",
    "lpips_vgg": "LPIPS (vgg)",
}
"""Title of each metric, in the order of a page; metrics without any value are left out."""


def metrics_of(results: Results) -> tuple[str, ...]:
    """The metrics of `TITLES` that are known for at least one frame."""
    measured = {name for record in results.records for name, value in record.metrics.items() if value is not None}
    return tuple(name for name in TITLES if name in measured)


def methods_list(results: Results) -> str:
    """A list of the methods: what each one is and where its weights come from."""
    lines = []
    for name, method in results.study.methods.items():
        parts = [method.about, f"weights `{method.weights}`" if method.weights else ""]
        parts.append(f"`gaussian-enhancer train {' '.join(method.train)}`" if method.train else "")
        parts.append(f"`{' '.join(method.enhance)}`" if method.enhance else "")
        lines.append(f"- `{name}`: {'; '.join(filter(None, parts)) or 'no description'}\n")
    return "".join(lines)


def aims_table(results: Results, aims: Aims) -> pd.DataFrame:
    """One line per aim: method, scene, aim, the finding, whether it is met."""
    judged = [verdict for method in methods_of_role(results, "ours") for verdict in verdicts(results, method, aims)]
    lines = [(v.method, v.scene, v.aim, v.finding, VERDICTS[v.met]) for v in judged]
    return frame(("method", "scene", "aim", "found", "verdict"), lines)


def scene_table(results: Results) -> pd.DataFrame:
    """One line per scene and method: mean and gain of every metric over the scene's pairs."""
    names, lines = metrics_of(results), []
    for scene in dict.fromkeys(scene for scene, _ in results.pairs):
        pairs = pairs_of(results, scene)
        for method in results.study.methods:
            available = [pair for pair in pairs if not results.missing_reason(pair, method)]
            numbers = (_mean_and_gain(results, available, method, name, True) for name in names)
            lines.append((scene, method, f"{len(available)} of {len(pairs)}", *numbers))
    return frame(("scene", "method", "scene-splat pairs", *(TITLES[name] for name in names)), lines)


def pair_table(results: Results, metric: str) -> pd.DataFrame:
    """One line per scene-splat pair, one column per method: mean over frames and gain over the baseline."""
    lines = []
    for pair in results.pairs:
        frames = len(results.views.get((pair, results.study.baseline, None), {}))
        numbers = (_mean_and_gain(results, [pair], method, metric, False) for method in results.study.methods)
        lines.append((*pair, str(frames), *numbers))
    return frame(("scene", "splat", "frames", *results.study.methods), lines)


def harm_list(results: Results, allowed: Mapping[str, float]) -> str:
    """By method: the number of frames that lose more than allowed, and the worst frame; our methods' frames by name."""
    lines, our_methods = [], methods_of_role(results, "ours")
    for method in results.study.methods:
        if method == results.study.baseline or all(results.missing_reason(pair, method) for pair in results.pairs):
            continue
        for metric, limit in allowed.items():
            ranked = ranked_losses(results, method, metric)
            worse = [frame_loss for frame_loss in ranked if frame_loss.loss > limit]
            line = f"- `{method}`, more than {limit:g} in `{metric}`: {len(worse)} of {_frames(results, method)}"
            sign = -1 if HIGHER_IS_BETTER[metric] else 1
            named = [
                f"{' '.join((*frame_loss.pair, frame_loss.view))} ({sign * frame_loss.loss:+.4f})"
                for frame_loss in worse
            ]
            line += f": {', '.join(named)}" if named and method in our_methods else ""
            if ranked:
                line += f"; least gain {sign * ranked[0].loss:+.4f} at {' '.join((*ranked[0].pair, ranked[0].view))}"
            lines.append(f"{line}\n")
    return "".join(lines) or "No method was compared.\n"


def missing_list(results: Results) -> str:
    """Every reason of missing values, with the methods and scene-splat pairs or frames that it applies to."""
    places_by_reason: dict[str, dict[str, list[str]]] = {}
    for method in results.study.methods:
        for pair in results.pairs:
            if reason := results.missing_reason(pair, method):
                places_by_reason.setdefault(reason, {}).setdefault(method, []).append(" ".join(pair))
    study_metrics = set(results.study.metrics)
    for record in results.records:
        for metric, reason in record.reasons.items():
            if metric in study_metrics:
                place = f"{record.scene} {record.splat} {record.view}"
                places_by_reason.setdefault(f"{metric}: {reason}", {}).setdefault(record.variant, []).append(place)
    lines = (f"- {reason}: {_places(methods, len(results.pairs))}\n" for reason, methods in places_by_reason.items())
    return "".join(lines) or "Nothing.\n"


def missing_section(reasons: Iterable[tuple[str, str]], nothing: str = "Missing: nothing.\n") -> str:
    """A list of missing rows, from pairs of name and reason; ``nothing`` if there are none."""
    lines = "".join(f"- {name}: {reason}\n" for name, reason in reasons)
    return f"Missing:\n\n{lines}" if lines else nothing


def relative_link(target: Path, page: Path) -> str:
    """Address of a file or folder relative to the page that links to it."""
    return Path(os.path.relpath(target, page.parent)).as_posix()


def distinct_values(values: Iterable[str]) -> list[str]:
    """The distinct non-empty values, sorted."""
    return sorted(set(values) - {""})


def source_list(records: Sequence[Record], link: str, counted: str = "", separator: str = "; ") -> str:
    """A list of the records' protocols, machines, commits, times and file.

    Args:
        records: all records of the page.
        link: address of their file, relative to the page.
        counted: text before the number of records.
        separator: separator of protocols.
    """
    times = [record.time for record in records] or [""]
    return (
        f"- protocol: {separator.join(distinct_values(record.protocol for record in records))}\n"
        f"- machine: {'; '.join(distinct_values(record.machine for record in records))}\n"
        f"- commit: {', '.join(distinct_values(record.commit for record in records))} (`+`: with changes of its own)\n"
        f"- measured: {min(times)} to {max(times)}\n"
        f"- {counted}{len(records)} records in [{link.rsplit('/', 1)[-1]}]({link})\n"
    )


def _mean_and_gain(results: Results, pairs: Sequence[SceneSplat], method: str, metric: str, with_interval: bool) -> str:
    values = results.sample(pairs, method, metric)
    if not values.values:
        return "missing"
    value = format_value(metric, values.mean())
    if method == results.study.baseline:
        return value
    gains = results.sample(pairs, method, metric, results.study.baseline)
    low, high = interval(gains) if with_interval else (math.nan, math.nan)
    return f"{value} ({format_gain_with_interval(metric, gains.mean(), low, high)})"


def _frames(results: Results, method: str) -> int:
    """Number of frames that both a method and the baseline have."""
    view_sets = [
        [set(results.views.get((pair, name, None), {})) for name in (method, results.study.baseline)]
        for pair in results.pairs
    ]
    return sum(len(method_views & baseline_views) for method_views, baseline_views in view_sets)


def _places(methods: Mapping[str, Sequence[str]], count: int) -> str:
    """Methods with the pairs or frames that they lack, abbreviated if these are all pairs."""
    all_pairs = f"all {count} scene-splat pairs"
    return "; ".join(f"`{name}` in {all_pairs if len(p) == count else ', '.join(p)}" for name, p in methods.items())
