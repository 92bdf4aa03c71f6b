"""Makes the figures of the README and of the documentation's first page from committed records."""

from collections.abc import Sequence

import pandas as pd

from ablations.study.markdown import frame, markdown
from ablations.study.rows import frame_of, with_gains
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.metrics.records import Record

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
METHOD, ONE_STEP = "lr_tiny two steps", "lr_tiny"
"""The default of enhance for a run, and enhancement of its last step alone."""
CONVERGED_STEPS = 15000


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
    rows = rows[rows["step"] == rows.groupby("scene")["step"].transform("max")]
    lines, means = [], []
    for scene, title in CAPTURES.items():
        of_scene, one_step = (rows[(rows["scene"] == scene) & (rows["method"] == name)] for name in (METHOD, ONE_STEP))
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
            means.append((gains.mean(), one_step["gain_psnr_aligned"].mean(), of_scene["blocks_harmed"].mean()))
    headings = ("capture", "steps", "raw, dB", "gain, dB", "worst view", "views worse", "blocks worse by 0.5 dB")
    gain, alone, harmed = (sum(values) / len(means) for values in zip(*means, strict=True))
    mean = (
        f"Mean of the {len(means)} at {CONVERGED_STEPS:,} steps: {gain:+.2f} dB ({alone:+.2f} from one "
        f"step), {harmed:.1%} of blocks worse."
    )
    return f"{markdown(frame(headings, lines))}\n{mean}\n"


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
