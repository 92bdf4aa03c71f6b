"""Makes the part on trainings of the page of error over run time: validation error over wall-clock and samples."""

from collections.abc import Iterator, Sequence

import pandas as pd

from ablations.study.markdown import frame, markdown
from ablations.study.plots import Mark, Panel, work_precision
from ablations.study.rows import frame_of
from ablations.study.sections import missing_section
from gaussian_enhancer.metrics.records import MISSING, Record

ERROR = "MSE over the raw render's"
AXES = {"seconds": "wall-clock, s", "samples": "samples (crops)"}

ABOUT = """Validation error is that of the running mean of the weights, as its mean squared error over the raw
render's: 1 is no gain, 0.9 is +0.46 dB. Mean over seeds at each validation. A training that was validated once is a
single mark; `data.steps_per_epoch=100` validates every 100 steps.
"""


def training_parts(records: Sequence[Record]) -> Iterator[tuple[str, str, str]]:
    """Yield parts of the page: text, name of a diagram, and the diagram; both are empty for a part without diagram.

    Args:
        records: of the kind training.
    """
    yield ABOUT, "", ""
    rows = frame_of(record for record in records if record.kind != MISSING)
    if len(rows):
        rows["step"] = rows["view"].astype(int)
        means = rows.groupby(["variant", "step"], sort=False)[["gain_psnr", *AXES]].mean()
        panels = [
            Panel(f"over {title.split(',')[0]}", title, ERROR, _curves(means, key)) for key, title in AXES.items()
        ]
        yield _table(rows), "training", work_precision("Validation error of trainings", panels, len(panels))
    missing = ((f"`{r.variant}`, seed {r.seed} ({r.run})", r.reasons["row"]) for r in records if r.kind == MISSING)
    yield missing_section(missing), "", ""


def _curves(means: pd.DataFrame, key: str) -> dict[str, tuple[Mark, ...]]:
    """Marks by variant: geometric mean of the error ratios over mean time or samples, at each validated step."""
    return {
        str(variant): tuple(
            Mark(f"{step} steps", row[key], 10 ** (-row["gain_psnr"] / 10))
            for (_, step), row in variant_rows.sort_index().iterrows()
        )
        for variant, variant_rows in means.groupby("variant", sort=False)
    }


def _table(validations: pd.DataFrame) -> str:
    rows = []
    for variant, variant_rows in validations.groupby("variant", sort=False):
        last_step = variant_rows["step"].max()
        last_rows = variant_rows[variant_rows["step"] == last_step]
        gains, (seconds, samples) = last_rows["gain_psnr"], (last_rows[key].mean() for key in AXES)
        spread = f" ± {gains.std():.3f}" if len(gains) > 1 else ""
        numbers = (
            f"{len(last_rows)}",
            f"{last_step}",
            f"{samples:.0f}",
            f"{seconds:.0f}",
            f"{gains.mean():+.3f}{spread}",
        )
        rows.append((str(variant), *numbers, f"{variant_rows['step'].nunique()}"))
    headings = ("training", "seeds", "steps", "samples", "wall-clock, s", "validation gain, dB", "validations")
    return markdown(frame(headings, rows))
