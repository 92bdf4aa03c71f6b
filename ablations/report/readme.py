"""README's figures, made from the records of the quality page."""

import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.metrics.records import Record

RECORDS = "docs/results/quality.jsonl"
BEGIN, END = f"<!-- {RECORDS}: gaussian-enhancer pages write=true -->", "<!-- end -->"
RAW, ENHANCED = "lr/raw", "lr/lr_tiny"
SCENES = {
    "fox": "fox (real)",
    "monstree": "monstree (real)",
    "indoor": "indoor (in-distribution)",
    "unbounded": "unbounded (in-distribution)",
    "outdoor": "outdoor (in-distribution)",
    "object": "object (in-distribution)",
}
HEAD = "| scene | PSNR, raw → enhanced | gain in colour-aligned PSNR | LPIPS (alex) |\n|---|---|---|---|\n"


@dataclass(frozen=True)
class FrameGain:
    """One view before and after.

    Args:
        raw: metrics of the render.
        enhanced: metrics of the enhanced view.
    """

    raw: Mapping[str, float]
    enhanced: Mapping[str, float]

    def gain(self, metric: str) -> float:
        """Enhanced minus raw."""
        return self.enhanced[metric] - self.raw[metric]


def frames(records: Sequence[Record]) -> dict[str, dict[str, list[FrameGain]]]:
    """Views by scene and fitted run.

    Raises:
        InputError: a view was enhanced but not measured raw.
    """
    measured = {(one.run, one.view, one.variant): one for one in records}
    found: dict[str, dict[str, list[FrameGain]]] = {}
    for (run, view, variant), after in measured.items():
        if variant == ENHANCED:
            before = measured.get((run, view, RAW))
            if before is None:
                raise InputError(f"{run}, {view}", "has no raw render in the records", "measure it again")
            pair = FrameGain(_known(before), _known(after))
            found.setdefault(after.scene, {}).setdefault(run, []).append(pair)
    return found


def text(records: Sequence[Record]) -> str:
    """README's table, means over fits of the means over their views, and its sentence on single frames."""
    scenes = frames(records)
    lines = "".join(_line(title, list(scenes[scene].values())) for scene, title in SCENES.items())
    every = [frame for runs in scenes.values() for run in runs.values() for frame in run]
    return f"{HEAD}{lines}\n{_worst(every)}\n"


def inserted(page: str, made: str, begin: str = BEGIN, name: str | Path = "README.md") -> str:
    """The page with what stands between its marks replaced.

    Args:
        page: its text.
        made: what is to stand there.
        begin: the first mark; `END` is the second.
        name: of the page, for errors.

    Raises:
        InputError: it has no marks.
    """
    before, found, rest = page.partition(begin)
    _, end, after = rest.partition(END)
    if not found or not end:
        raise InputError(name, "has no place for its figures", f"put {begin} and {END} around them")
    return f"{before}{begin}\n{made}{END}{after}"


def _known(record: Record) -> dict[str, float]:
    return {name: value for name, value in record.metrics.items() if value is not None}


def _line(title: str, runs: Sequence[Sequence[FrameGain]]) -> str:
    def mean(values: Sequence[Sequence[float]]) -> float:
        return statistics.fmean(statistics.fmean(run) for run in values)

    raw, enhanced = (mean([[getattr(f, side)["psnr"] for f in run] for run in runs]) for side in ("raw", "enhanced"))
    aligned, lpips = (mean([[f.gain(name) for f in run] for run in runs]) for name in ("psnr_aligned", "lpips_alex"))
    return f"| {title} | {raw:.2f} → {enhanced:.2f} dB | {aligned:+.2f} dB | {lpips:+.4f} |\n"


def _worst(every: Sequence[FrameGain]) -> str:
    """How many frames gain, and what the worst one gains or loses."""
    told = []
    for metric, name in (("psnr_aligned", "colour-aligned PSNR"), ("psnr", "plain PSNR")):
        gains = [frame.gain(metric) for frame in every]
        worse = sum(gain < 0 for gain in gains)
        if worse:
            told.append(f"in {name}, {worse} of {len(every)} frames lose, at most {-min(gains):.2f} dB")
        else:
            told.append(f"in {name}, every one of the {len(every)} frames gains, at least {min(gains):.3f} dB")
    sentence = "; ".join(told)
    return f"{sentence[0].upper()}{sentence[1:]}."
