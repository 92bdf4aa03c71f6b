"""Sections of a study's page: which metrics it shows, and what it says of them."""

import pytest

from ablations.study.description import MethodDescription, SceneGroup, TableDescription
from ablations.study.results import Results
from ablations.study.sections import metrics_of, pair_table
from gaussian_enhancer.metrics.records import Record

METHODS = {"raw": MethodDescription("raw", role=""), "ours": MethodDescription("ours")}
STUDY = TableDescription(
    "t", "", "quality", "", METHODS, "raw", ("psnr", "lpips_alex"), (), {"d": SceneGroup("D", ("fox",))}, ()
)


def results(lpips: float | None) -> Results:
    """One frame, raw and enhanced, with one LPIPS of both."""
    reasons = {"lpips_alex": "no backbone"} if lpips is None else {}
    metrics = {"psnr": 20.0, "lpips_alex": lpips}
    return Results(STUDY, [Record("quality", "r", "fox", "3dgs", "a", name, metrics, reasons) for name in METHODS])


@pytest.mark.parametrize("lpips", [0.0, 0.3])
def test_a_metric_is_shown_also_where_it_is_zero_for_every_frame(lpips: float) -> None:
    assert metrics_of(results(lpips)) == ("psnr", "lpips_alex")


def test_a_metric_that_no_frame_has_is_left_out() -> None:
    assert metrics_of(results(None)) == ("psnr",)


def test_a_pair_of_zeros_is_a_number_with_a_gain_of_zero() -> None:
    ((*_, raw, ours),) = pair_table(results(0.0), "lpips_alex").itertuples(index=False)
    assert (raw, ours) == ("0.0000", "0.0000 (+0.0000)")
