"""Makes the README's numbers from the records of the quality page."""

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from ablations.study.rows import frame_of, with_gains
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
LINE = "{:.2f} → {:.2f} dB | {:+.2f} dB | {:+.4f}"


def views(records: Sequence[Record]) -> pd.DataFrame:
    """Enhanced views with their gains over the raw render.

    Raises:
        InputError: a view was enhanced but not measured raw.
    """
    frame = frame_of(record for record in records if record.variant in (RAW, ENHANCED))
    gains = with_gains(frame, {"variant": RAW}, ("run", "view"))
    gains = gains[gains["variant"] == ENHANCED]
    for _, record in gains[gains["gain psnr"].isna()].iterrows():
        raise InputError(f"{record['run']}, {record['view']}", "has no raw render in the records", "measure it again")
    return gains.assign(raw=gains["psnr"] - gains["gain psnr"])


def text(records: Sequence[Record]) -> str:
    """The README's table (means over fits of the means over their views), and its sentence on single frames."""
    enhanced_views = views(records)
    fits = enhanced_views.groupby(["scene", "run"])[["raw", "psnr", "gain psnr_aligned", "gain lpips_alex"]].mean()
    means = fits.groupby("scene").mean()
    lines = [f"| {title} | {LINE.format(*means.loc[scene])} |\n" for scene, title in SCENES.items()]
    return f"{HEAD}{''.join(lines)}\n{_worst(enhanced_views)}\n"


def insert_between_marks(page: str, new_text: str, begin: str = BEGIN, name: str | Path = "README.md") -> str:
    """Replace the text between two marks of a page.

    Args:
        page: text of the page.
        new_text: the new text between the marks.
        begin: the first mark; `END` is the second.
        name: of the page, for errors.

    Raises:
        InputError: the page has no such marks.
    """
    before, begin_mark, after_begin = page.partition(begin)
    _, end_mark, after = after_begin.partition(END)
    if not begin_mark or not end_mark:
        raise InputError(name, "has no place for its figures", f"put {begin} and {END} around them")
    return f"{before}{begin}\n{new_text}{END}{after}"


def _worst(enhanced_views: pd.DataFrame) -> str:
    """A sentence on the number of frames that lose, and the loss or gain of the worst one."""
    lines = []
    for metric, name in (("psnr_aligned", "colour-aligned PSNR"), ("psnr", "plain PSNR")):
        gains = enhanced_views[f"gain {metric}"]
        worse = (gains < 0).sum()
        if worse:
            lines.append(f"in {name}, {worse} of {len(gains)} frames lose, at most {-gains.min():.2f} dB")
        else:
            lines.append(f"in {name}, every one of the {len(gains)} frames gains, at least {gains.min():.3f} dB")
    sentence = "; ".join(lines)
    return f"{sentence[0].upper()}{sentence[1:]}."
