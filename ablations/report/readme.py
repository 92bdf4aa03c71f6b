"""Makes the figures of the README and of the documentation's first page from committed records."""

from collections.abc import Callable, Sequence
from pathlib import Path

import pandas as pd

from ablations.study.markdown import frame, markdown
from ablations.study.rows import RowFile, frame_of, with_gains
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.metrics.records import Record, read_records

TEST, CONVERGENCE = "docs/results/test.jsonl", "docs/results/convergence.jsonl"
BEGIN, END = "<!-- {}: gaussian-enhancer pages write=true -->", "<!-- end -->"
RAW, ENHANCED = "lr/raw", "lr/lr_tiny"
SCENES = {
    "fox": "fox (real)",
    "monstree": "monstree (real)",
    "harbour": "harbour (family unseen in training)",
    "unbounded": "in-distribution unbounded",
    "outdoor": "outdoor",
    "indoor": "indoor",
    "object": "object",
}
"""Test scenes by their name without seed, as the sentence on them names them."""
CAPTURES = {
    "banana": "banana (validation)",
    "plush": "plush (validation)",
    "cyprus": "cyprus (validation)",
    "flowerpot": "flowerpot (validation)",
    "copr": "copr (validation)",
    "monstree": "monstree (test)",
    "fox": "fox (test)",
}
"""Rows of the table of converged splats."""
METHOD, CONVERGED_STEPS = "lr_tiny", 15000


def views(records: Sequence[Record]) -> pd.DataFrame:
    """Enhanced views with their gains over the raw render, and the names of their scenes without seed.

    Raises:
        InputError: a view was enhanced but not measured raw.
    """
    measured = frame_of(record for record in records if record.variant in (RAW, ENHANCED))
    gains = with_gains(measured, {"variant": RAW}, ("run", "view"))
    gains = gains[gains["variant"] == ENHANCED]
    for _, record in gains[gains["gain psnr"].isna()].iterrows():
        raise InputError(f"{record['run']}, {record['view']}", "has no raw render in the records", "measure it again")
    return gains.assign(name=gains["scene"].str.partition("_")[0])


def frozen_test_sentence(records: Sequence[Record]) -> str:
    """Sentences on the gains in test scenes, means over fits of the means over their views, and on single frames."""
    enhanced_views = views(records)
    fits = enhanced_views.groupby(["name", "run"])["gain psnr_aligned"].mean()
    means = fits.groupby("name").mean()
    gains = ", ".join(f"{title} {means[name]:+.2f} dB" for name, title in SCENES.items())
    return f"Gains: {gains}. {_worst(enhanced_views)}\n"


def converged_table(rows: pd.DataFrame) -> str:
    """The table of converged splats, each at its last step, and a sentence on the mean of the longest fits.

    Args:
        rows: rows of the job ``convergence``, one for each method, scene, step and view.
    """
    rows = rows[rows["method"] == METHOD]
    rows = rows[rows["step"] == rows.groupby("scene")["step"].transform("max")]
    lines, means = [], []
    for scene, title in CAPTURES.items():
        of_scene = rows[rows["scene"] == scene]
        gains, step = of_scene["gain_psnr_aligned"], int(of_scene["step"].iloc[0])
        worst = f"{gains.min():+.2f}" if gains.min() >= 0 else f"**{gains.min():+.2f}**"
        lines.append(
            (
                title,
                f"{step:,}",
                f"{of_scene['raw_psnr_aligned'].mean():.2f}",
                f"{gains.mean():+.2f}",
                worst,
                f"{(gains < 0).sum()}/{len(gains)}",
                f"{of_scene['blocks_harmed'].mean():.1%}",
            )
        )
        if step == CONVERGED_STEPS:
            means.append((gains.mean(), of_scene["blocks_harmed"].mean()))
    headings = ("capture", "steps", "raw, dB", "gain, dB", "worst view", "views worse", "blocks worse by 0.5 dB")
    gain, harmed = (sum(values) / len(means) for values in zip(*means, strict=True))
    mean = f"Mean of the {len(means)} at {CONVERGED_STEPS:,} steps: {gain:+.2f} dB, {harmed:.1%} of blocks worse."
    return f"{markdown(frame(headings, lines))}\n{mean}\n"


FIGURES: dict[str, Callable[[Path], str]] = {
    TEST: lambda path: frozen_test_sentence(read_records(path)),
    CONVERGENCE: lambda path: converged_table(RowFile(path, ("method", "scene", "step", "view")).read()),
}
"""Texts by the file of their records."""


def fill_page(page: str, folder: Path, name: str | Path = "README.md") -> str:
    """Replace every text of a page that is made from records.

    Args:
        page: text of the page.
        folder: the repository, or a copy of its documentation.
        name: of the page, for errors.

    Raises:
        InputError: the page has no place for figures, or records are missing or damaged.
    """
    files = [file for file in FIGURES if BEGIN.format(file) in page]
    if not files:
        raise InputError(name, "has no place for its figures", f"put {BEGIN.format(TEST)} and {END} around them")
    for file in files:
        page = insert_between_marks(page, FIGURES[file](folder / file), BEGIN.format(file), name)
    return page


def insert_between_marks(page: str, new_text: str, begin: str, name: str | Path = "README.md") -> str:
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
            lines.append(f"in {name}, all {len(gains)} frames gain, at least {gains.min():.3f} dB")
    sentence = "; ".join(lines)
    return f"{sentence[0].upper()}{sentence[1:]}."
