"""Trainings' part of the page of error over run time: validation error over wall-clock and over samples."""

import statistics
from collections.abc import Iterator, Sequence

from ablations.study.markdown import frame, markdown
from ablations.study.plots import Mark, Panel, work_precision
from gaussian_enhancer.metrics.records import MISSING, Record

ERROR = "MSE over the raw render's"
AXES = {"seconds": "wall-clock, s", "samples": "samples (crops)"}

ABOUT = """Validation error is that of the running mean of the weights, as its mean squared error over the raw
render's: 1 is no gain, 0.9 is +0.46 dB. Mean over seeds at each validation. A training that was validated once is a
single mark; `data.steps_per_epoch=100` validates every 100 steps.
"""


def training_parts(records: Sequence[Record]) -> Iterator[tuple[str, str, str]]:
    """Text, a diagram's name and the diagram.

    Args:
        records: of the kind training.
    """
    yield ABOUT, "", ""
    found = [record for record in records if record.kind != MISSING]
    panels = [Panel(f"over {title.split(',')[0]}", title, ERROR, _curves(found, key)) for key, title in AXES.items()]
    if found:
        yield _table(found), "training", work_precision("Validation error of trainings", panels, len(panels))
    lines = "".join(
        f"- `{r.variant}`, seed {r.seed} ({r.run}): {r.reasons['row']}\n" for r in records if r.kind == MISSING
    )
    yield f"Missing:\n\n{lines}" if lines else "Missing: nothing.\n", "", ""


def _curves(records: Sequence[Record], key: str) -> dict[str, tuple[Mark, ...]]:
    """Marks by variant: the geometric mean of the ratios over the mean time, at each step that was validated."""
    places: dict[str, dict[str, list[Record]]] = {}
    for record in records:
        places.setdefault(record.variant, {}).setdefault(record.view, []).append(record)
    return {
        variant: tuple(
            Mark(f"{step} steps", _mean(own, key), 10 ** (-_mean(own, "gain_psnr") / 10))
            for step, own in sorted(steps.items(), key=lambda item: int(item[0]))
        )
        for variant, steps in places.items()
    }


def _table(records: Sequence[Record]) -> str:
    rows = []
    for variant in dict.fromkeys(record.variant for record in records):
        own = [record for record in records if record.variant == variant]
        last = max(own, key=lambda record: int(record.view)).view
        end = [record for record in own if record.view == last]
        gains = [record.metrics["gain_psnr"] or 0.0 for record in end]
        spread = f" ± {statistics.stdev(gains):.3f}" if len(gains) > 1 else ""
        seconds, samples = (_mean(end, key) for key in AXES)
        validations = len({record.view for record in own})
        numbers = (f"{len(end)}", last, f"{samples:.0f}", f"{seconds:.0f}", f"{statistics.fmean(gains):+.3f}{spread}")
        rows.append((variant, *numbers, f"{validations}"))
    heads = ("training", "seeds", "steps", "samples", "wall-clock, s", "validation gain, dB", "validations")
    return markdown(frame(heads, rows))


def _mean(records: Sequence[Record], key: str) -> float:
    return statistics.fmean(record.metrics[key] or 0.0 for record in records)
