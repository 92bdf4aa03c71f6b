"""The page of what plans leave out: numbers, verdicts and the diagram from records alone."""

from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import pytest

from ablations.report.plan_study import KIND, RATIOS, PlanAims, PlanScenes, plan_plot, plan_study_page
from gaussian_enhancer.metrics.records import Record

AIMS = PlanAims("full", "auto", 1.5, 0.98, 0.02)


def records(
    scene: str, milliseconds: float, psnr: float, *, background: bool = False, low: float = 0.0, high: float = 0.0
) -> list[Record]:
    """A scene under both plans; ``low`` and ``high``: what the ratio of times lies between, itself where 0."""
    found = []
    for plan, time, quality in (("full", 100.0, 30.0), ("auto", milliseconds, psnr)):
        metrics = {
            "milliseconds": time,
            **dict(zip(RATIOS, (100.0 / time, low or 100.0 / time, high or 100.0 / time), strict=True)),
            "peak_memory_mb": 500.0,
            "background": float(background),
            "passed": 0.25,
        }
        metrics |= {"candidates_taken": 6.0, "candidates_left_out": 4.0, "candidates_unseeing": 1.0, "part depth": 0.0}
        found.append(Record(KIND, "fit", scene, "3dgs", "", plan, metrics, {"part depth": "not given"}, (64, 48)))
        for view, more in (("a.png", 0.01), ("b.png", -0.01)):
            found.append(Record("quality", "fit", scene, "3dgs", view, plan, {"psnr": quality + more, "ssim": 0.9}))
    return found


def section(*scenes: list[Record]) -> PlanScenes:
    return PlanScenes("Scenes", "test", [record for scene in scenes for record in scene], AIMS)


@pytest.mark.parametrize(
    ("milliseconds", "psnr", "background", "verdicts"),
    [
        (60.0, 29.99, True, (True, True)),
        (70.0, 29.99, True, (False, True)),
        (70.0, 29.97, False, (True, False)),
        (101.0, 30.1, False, (True, True)),
        (104.0, 30.0, False, (False, True)),
    ],
)
def test_aims_are_judged_by_what_kind_of_scene_it_is(milliseconds, psnr, background, verdicts):
    (cell,) = section(records("chair", milliseconds, psnr, background=background)).costs()
    assert cell.ratio == pytest.approx(100 / milliseconds)
    assert cell.lost["psnr"] == pytest.approx(30 - psnr)
    assert cell.verdicts(AIMS) == verdicts


@pytest.mark.parametrize(
    ("between", "verdict", "word"),
    [((0.99, 1.1), True, "met"), ((0.9, 0.97), False, "**missed**"), ((0.95, 1.02), None, "open")],
)
def test_an_aim_that_noise_hides_is_open(between, verdict, word):
    shown = section(records("hall", 100.0, 30.0, low=between[0], high=between[1]))
    (cell,) = shown.costs()
    assert cell.verdicts(AIMS) == (verdict, True)
    assert f"| {word} | met |" in plan_study_page("T", "", [shown], (), Path("x.svg"), Path("p.md"))


def test_times_that_were_not_taken_in_turn_are_open():
    old = [
        replace(one, metrics={k: v for k, v in one.metrics.items() if k not in RATIOS})
        for one in records("hall", 90.0, 30.0)
    ]
    (cell,) = section(old).costs()
    assert cell.ratio is None
    assert cell.verdicts(AIMS) == (None, True)


def test_the_page_states_numbers_reasons_and_what_is_missing():
    lost = Record("missing", "", "fox", "3dgs", "", "full", {}, {"row": "is not fitted"})
    shown = section(records("chair", 50.0, 29.99, background=True), [lost])
    more = PlanScenes("More", "training", (), AIMS)
    found = {"passed by predicted": 0.1, "box by predicted": 1.0, "passed by bound": 0.8, "box by bound": 0.5}
    good = [Record("already_good", "chair_0-3dgs-1", "chair_0", "3dgs", view, "", found) for view in ("a", "b")]
    page = plan_study_page("T", "about it", [shown, more], good, Path("d/r/x.svg"), Path("d/p.md"))
    assert page.startswith("# T\n\nabout it\n")
    assert "(r/x.svg)" in page
    assert "| chair | 64x48 | 100 → 50 | 2.00 (2.00 to 2.00) | 500 → 500 | +0.010 |" in page
    assert "25% of the pixels" in page
    assert "4 of 10 candidates (1 see too little" in page
    assert "depth (not given)" in page
    assert "- fox: is not fitted" in page
    assert page.count("Not measured yet") == 1
    assert "| chair_0-3dgs | 2 | 10% | 100% | 80% | 50% |" in page


def test_the_plot_names_every_scene_and_number():
    drawn = ElementTree.fromstring(plan_plot(section(records("chair", 50.0, 29.99), records("hall", 90.0, 30.005))))
    texts = ["".join(one.itertext()) for one in drawn.iter("{http://www.w3.org/2000/svg}text")]
    assert {"chair", "hall", "2.00x", "1.11x", "+0.010", "-0.005"} <= set(texts)
    ElementTree.fromstring(plan_plot(PlanScenes("None", "test", (), AIMS)))
