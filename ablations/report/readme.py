"""README's figures, made from the records of the quality page."""

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
    frame = frame_of(one for one in records if one.variant in (RAW, ENHANCED))
    found = with_gains(frame, {"variant": RAW}, ("run", "view"))
    found = found[found["variant"] == ENHANCED]
    for _, one in found[found["gain psnr"].isna()].iterrows():
        raise InputError(f"{one['run']}, {one['view']}", "has no raw render in the records", "measure it again")
    return found.assign(raw=found["psnr"] - found["gain psnr"])


def text(records: Sequence[Record]) -> str:
    """README's table, means over fits of the means over their views, and its sentence on single frames."""
    found = views(records)
    fits = found.groupby(["scene", "run"])[["raw", "psnr", "gain psnr_aligned", "gain lpips_alex"]].mean()
    means = fits.groupby("scene").mean()
    lines = [f"| {title} | {LINE.format(*means.loc[scene])} |\n" for scene, title in SCENES.items()]
    return f"{HEAD}{''.join(lines)}\n{_worst(found)}\n"


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


def _worst(found: pd.DataFrame) -> str:
    """How many frames gain, and what the worst one gains or loses."""
    lines = []
    for metric, name in (("psnr_aligned", "colour-aligned PSNR"), ("psnr", "plain PSNR")):
        gains = found[f"gain {metric}"]
        worse = (gains < 0).sum()
        if worse:
            lines.append(f"in {name}, {worse} of {len(gains)} frames lose, at most {-gains.min():.2f} dB")
        else:
            lines.append(f"in {name}, every one of the {len(gains)} frames gains, at least {gains.min():.3f} dB")
    sentence = "; ".join(lines)
    return f"{sentence[0].upper()}{sentence[1:]}."
