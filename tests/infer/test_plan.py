"""The plan as data: what it says, what its file holds, and what it refuses."""

import dataclasses
import json

import pytest

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.plan import Plan, PlanItem, Rules, ViewPlan
from gaussian_enhancer.types import Region

AUTO = Rules("auto", "auto", "auto", share=0.1)
PLAN = Plan(
    "chair",
    AUTO,
    (PlanItem("depth", True, "surface"), PlanItem("fine photos", False, "not known")),
    (
        ViewPlan("0.png", (100, 200), (Region(0, 0, 50, 100), Region(50, 100, 100, 200)), ("a",), {"b": 0.02}),
        ViewPlan("1.png", (100, 200), None, ("a", "b"), {"c": 0.4}),
        ViewPlan("2.png", (50, 200), ()),
    ),
)


def test_the_file_holds_the_whole_plan(tmp_path):
    PLAN.to_file(tmp_path / "plan.json")
    record = json.loads((tmp_path / "plan.json").read_text())
    assert record["scene"] == "chair"
    assert record["rules"] == dataclasses.asdict(AUTO)
    assert record["parts"][1] == {"name": "fine photos", "used": False, "why": "not known"}
    first, second, third = record["views"]
    assert (first["name"], first["size"], first["left_out"]) == ("0.png", [100, 200], {"b": 0.02})
    assert [Region(**region) for region in first["regions"]] == list(PLAN.views[0].regions)
    assert (second["regions"], second["references"]) == (None, ["a", "b"])
    assert (third["regions"], third["references"]) == ([], None)


def test_shares_of_what_passes_through():
    assert [view.passed_share for view in PLAN.views] == [0.5, 0.0, 1.0]
    assert PLAN.passed_share == pytest.approx((0.5 * 20000 + 10000) / 50000)
    assert Plan("bare").passed_share == 0


def test_the_table_says_what_is_used_what_is_not_and_why():
    lines = PLAN.table().splitlines()
    assert lines[0].split() == ["depth", "yes", "surface"]
    assert lines[1].split(maxsplit=3)[2:] == ["no", "not known"]
    assert "5 examined for 2 views, 2 left out, 1 of them because they see less than 10%" in lines[2]
    assert "40% show plain background" in lines[3]
    assert "candidates" not in Plan("full", Rules(), PLAN.parts, PLAN.views).table()


def test_the_table_has_no_candidates_where_no_reference_is_used():
    parts = (PlanItem("references", False, "none are asked for"),)
    assert "candidates" not in Plan("chair", AUTO, parts, (ViewPlan("0.png", (100, 200)),)).table()


def test_rules_leave_nothing_out_unless_they_are_told_to():
    assert Rules().full
    for forced in (Rules(references="auto"), Rules(depth="none"), Rules(tiles="auto")):
        assert not forced.full
    wrong = (
        {"references": "few"},
        {"depth": "on"},
        {"tiles": "some"},
        {"share": 1.5},
        {"tolerance": -0.1},
        {"margin": 5},
        {"small": -1},
    )
    for values in wrong:
        with pytest.raises(InputError, match=f"plan.{next(iter(values))}"):
            Rules(**values)
