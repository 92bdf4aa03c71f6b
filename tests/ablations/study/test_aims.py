"""A study's gains, intervals, losses and verdicts, from records with known numbers."""

import pytest

from ablations.study.aims import Aims, ranked_losses, verdicts
from ablations.study.description import MethodDescription, SceneGroup, TableDescription
from ablations.study.results import Results
from gaussian_enhancer.metrics.records import MISSING, Record

METHODS = {
    "raw": MethodDescription("raw", role=""),
    "other": MethodDescription("other", role="other"),
    "ours": MethodDescription("ours", role="ours"),
}
STUDY = TableDescription(
    "t", "", "quality", "", METHODS, "raw", ("psnr", "lpips_alex"), (), {"d": SceneGroup("D", ("fox",))}, ()
)
AIMS = Aims({"fox": {"psnr": 1.0, "lpips_alex": 0.0}}, ("psnr", "lpips_alex"), {"psnr": 0.02})


def frame(splat: str, row: str, view: str, psnr: float, lpips: float | None, scene: str = "fox") -> Record:
    reasons = {"lpips_alex": "no backbone"} if lpips is None else {}
    return Record("quality", "r", scene, splat, view, row, {"psnr": psnr, "lpips_alex": lpips}, reasons)


def gap(splat: str, row: str, reason: str = "no weights", scene: str = "fox") -> Record:
    return Record(MISSING, "", scene, splat, "", row, {}, {"row": reason})


def study(*changes: tuple[str, str, float, float | None], missing: tuple[Record, ...] = ()) -> Results:
    """Two cells, of two frames and of one, with raw at 20 dB and 0.3; a change is (splat, row, dB, LPIPS)."""
    views = {"dense": ("a", "b"), "sparse": ("c",)}
    records = [frame(splat, "raw", view, 20.0, 0.3) for splat, names in views.items() for view in names]
    for splat, row, gain, distance in changes:
        lower = None if distance is None else 0.3 + distance
        records += [frame(splat, row, view, 20.0 + gain, lower) for view in views[splat]]
    return Results(STUDY, [*records, *missing])


def verdict(found: Results, aim: str) -> bool | None:
    (one,) = [v for v in verdicts(found, "ours", AIMS) if v.aim.startswith(aim)]
    return one.met


WHOLE = [(s, r, g, d) for s in ("dense", "sparse") for r, g, d in (("other", 0.5, -0.01), ("ours", 1.2, -0.02))]


def test_pairs_have_equal_weights_however_many_frames_they_have() -> None:
    found = study(("dense", "ours", 1.0, 0.0), ("sparse", "ours", 3.0, 0.0))
    gains = found.sample(found.pairs, "ours", "psnr", "raw")
    assert (gains.mean(), gains.frames, len(gains.pairs), gains.missing_pairs()) == (pytest.approx(2.0), 3, 2, 0)


def test_gain_over_another_method() -> None:
    found = study(*WHOLE)
    assert found.sample(found.pairs, "ours", "psnr", "other").mean() == pytest.approx(0.7)


def test_all_aims_met() -> None:
    assert all(v.met for v in verdicts(study(*WHOLE), "ours", AIMS))


def test_a_gain_below_the_aim_is_missed_and_one_at_the_aim_is_met() -> None:
    assert verdict(study(("dense", "ours", 0.99, -0.1), ("sparse", "ours", 0.99, -0.1)), "psnr") is False
    assert verdict(study(("dense", "ours", 1.0, -0.1), ("sparse", "ours", 1.0, -0.1)), "psnr") is True


def test_no_change_is_no_improvement_and_lower_lpips_is() -> None:
    for change, met in ((0.0, False), (0.01, False), (-0.01, True)):
        found = study(("dense", "ours", 2.0, change), ("sparse", "ours", 2.0, change))
        assert verdict(found, "lpips_alex") is met


def test_being_behind_in_one_metric_is_missed_even_where_cells_are_missing() -> None:
    behind = study(("dense", "ours", 1.2, -0.01), ("dense", "other", 1.0, -0.02), missing=(gap("sparse", "ours"),))
    (one,) = [v for v in verdicts(behind, "ours", AIMS) if v.aim.startswith("ahead")]
    assert one.met is False
    assert "other (lpips_alex +0.010)" in one.finding


def test_what_is_missing_leaves_aims_open() -> None:
    for found in (
        study(*WHOLE[:-1], missing=(gap("sparse", "ours"),)),
        study(*WHOLE[:-1]),  # not even a record of the reason
        study(*WHOLE[:-1], ("sparse", "ours", 1.2, None)),
    ):
        assert verdict(found, "lpips_alex") is None
        assert verdict(found, "ahead") is None
    assert study(*WHOLE[:-1]).missing_reason(("fox", "sparse"), "ours") == "no record"
    assert study(missing=(gap("sparse", "ours", "why"),)).missing_reason(("fox", "sparse"), "ours") == "why"


def test_one_frame_made_worse_misses_the_aim_and_is_named() -> None:
    found = study(*WHOLE[:-1], ("sparse", "ours", -0.03, -0.1))
    assert verdict(found, "no frame") is False
    worst = ranked_losses(found, "ours", "psnr")[0]
    assert (worst.view, worst.loss) == ("c", pytest.approx(0.03))
    assert verdict(study(*WHOLE[:-1], ("sparse", "ours", -0.01, -0.1)), "no frame") is True


def test_worse_means_higher_for_lpips() -> None:
    found = study(("dense", "ours", 1.0, 0.005), ("sparse", "ours", 1.0, -0.005))
    assert [(one.view, one.loss) for one in ranked_losses(found, "ours", "lpips_alex")] == [
        (view, pytest.approx(loss)) for view, loss in (("a", 0.005), ("b", 0.005), ("c", -0.005))
    ]
