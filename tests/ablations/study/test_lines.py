"""Lines of the dashboard's tables against numbers worked out by hand from the records."""

import statistics
from dataclasses import replace

import pytest

from ablations.study import lines as lines_
from ablations.study.description import MethodDescription, SceneGroup, TableDescription
from ablations.study.lines import ALL, Line, match_baselines
from ablations.study.results import Results, block_of
from gaussian_enhancer.metrics.records import Record
from support.dashboard_samples import NASTY, QUALITY, REPEATS, SCENES, measured


def table_lines(table: TableDescription, records: list[Record]) -> tuple[Line, ...]:
    return lines_.table_lines(Results(table, records), records)


def line(lines: tuple[Line, ...], **wanted: str) -> Line:
    (found,) = [one for one in lines if all(getattr(one, name) == value for name, value in wanted.items())]
    return found


def psnr(records: list[Record], scene: str, method: str, seed: int | None) -> list[float]:
    own = [r for r in records if (r.scene, r.variant, r.seed) == (scene, method, seed) and r.kind == "quality"]
    return [value for r in own if (value := r.metrics["psnr"]) is not None]


def gain_of_seed(records: list[Record], seed: int) -> float:
    means = [
        statistics.fmean(psnr(records, s, "gepp", seed)) - statistics.fmean(psnr(records, s, "raw", None))
        for s in SCENES
    ]
    return statistics.fmean(means)


def test_means_and_gains_are_those_of_the_records() -> None:
    records = measured()
    found = line(table_lines(QUALITY, records), block="3dgs", method="gepp").numbers["psnr"]
    seeds = [gain_of_seed(records, seed) for seed in (0, 1)]
    assert found.gain == pytest.approx(statistics.fmean(seeds), abs=1e-12)
    assert found.deviation == pytest.approx(statistics.stdev(seeds), abs=1e-12)
    values = [statistics.fmean(psnr(records, scene, "gepp", seed)) for scene in SCENES for seed in (0, 1)]
    assert found.value == pytest.approx(statistics.fmean(values), abs=1e-12)
    assert (found.scenes, found.seeds, found.views, found.reasons) == (2, 2, 6, ())
    assert (found.low, found.high) == (None, None)  # three views of each scene are too few
    many = line(table_lines(QUALITY, measured(tuple("abcde"))), block="3dgs", method="gepp").numbers["psnr"]
    assert many.low is not None
    assert many.high is not None
    assert many.low < many.gain < many.high


def test_the_papers_gain_stands_beside_ours() -> None:
    lines = table_lines(QUALITY, measured())
    assert line(lines, block="3dgs", method="ge").numbers["psnr"].paper_gain == pytest.approx(28.61 - 28.17)
    assert line(lines, block="3dgs", method="gepp").numbers["psnr"].paper_gain is None
    assert line(lines, block="2dgs", method="ge").numbers["psnr"].paper is None


def test_what_is_missing_is_named() -> None:
    lines = table_lines(QUALITY, measured())
    absent = line(lines, block="2dgs", method="ge").numbers["psnr"]
    assert absent.value is None
    assert absent.gain is None
    assert {reason.partition(": ")[2] for reason in absent.reasons} == {"is not fitted <yet>"}
    assert any(reason.startswith(NASTY) for reason in absent.reasons)
    partly = line(lines, block="3dgs", method="gepp").numbers["ssim"]
    assert partly.reasons == ("yard, seed 0: too small (1 views)",)
    without = [r for r in measured() if (r.scene, r.variant, r.seed) != ("yard", "ge", 1)]
    reasons = line(table_lines(QUALITY, without), block="3dgs", method="ge").numbers["psnr"].reasons
    assert reasons == ("yard, seed 1: no record",)


def test_repeated_trainings_give_the_papers_statistics() -> None:
    records = measured()
    lines = table_lines(REPEATS, records)
    seeds = [gain_of_seed(records, seed) for seed in (0, 1)]
    wanted = {"max": max(seeds), "min": min(seeds), "mean": statistics.fmean(seeds), "std": statistics.stdev(seeds)}
    assert {one.method for one in lines} == {"gepp"}
    for statistic, value in wanted.items():
        number = line(lines, statistic=statistic).numbers["psnr"]
        assert number.gain == pytest.approx(value, abs=1e-12)
        assert number.paper_gain == REPEATS.paper["mip_nerf_360"][statistic][0]


def test_one_training_has_no_deviation_and_says_why() -> None:
    one = [r for r in measured() if r.seed != 1]
    number = line(table_lines(REPEATS, one), statistic="std").numbers["psnr"]
    assert number.gain is None
    assert "1 of the 2 trainings" in number.reasons[0]


def test_several_datasets_get_a_line_of_all_with_the_papers_numbers() -> None:
    datasets = {name: SceneGroup(name, (scene,)) for name, scene in zip(("one", "two"), SCENES, strict=True)}
    lines = table_lines(replace(QUALITY, datasets=datasets), measured())
    whole = line(lines, block="3dgs", method="ge", dataset=ALL).numbers["psnr"]
    parts = [line(lines, block="3dgs", method="ge", dataset=name).numbers["psnr"] for name in datasets]
    assert whole.gain == pytest.approx(statistics.fmean(part.gain or 0 for part in parts))
    assert whole.paper_gain is not None
    assert [part.paper_gain for part in parts] == [None, None]


def test_costs_stand_by_size_beside_the_papers() -> None:
    methods = {"ge": MethodDescription("GE"), "gepp": MethodDescription("GE++")}
    paper = {"1k": {"ge": (377.0, 8500.0), "gepp": (459.0, 8600.0)}, "2k": {"ge": None}}
    table = TableDescription(
        "table_3", "Cost", "cost", "", methods, "ge", ("milliseconds", "peak_memory_mb"), (), {}, paper=paper
    )
    records = [
        Record(
            "cost",
            "run",
            "yard",
            "1k",
            f"{i}",
            "ge",
            {"milliseconds": 10.0 + i, "peak_memory_mb": 3.0},
            commit="-",
            machine="-",
            time="-",
        )
        for i in range(3)
    ]
    lines = table_lines(table, records)
    found = line(lines, block="1k", method="ge").numbers["milliseconds"]
    assert (found.value, found.paper, found.gain) == (11.0, 377.0, None)
    assert line(lines, block="1k", method="ge").records == (0, 1, 2)
    assert line(lines, block="2k", method="ge").numbers["milliseconds"].value is None
    assert line(lines, block="1k", method="gepp").numbers["milliseconds"].reasons


def test_every_record_finds_its_baseline_of_the_same_seed() -> None:
    records = measured()
    for own, before in zip(records, match_baselines(QUALITY, records), strict=True):
        if own.kind != "quality" or own.variant == "raw":
            assert before == ()
            continue
        (place,) = before
        other = records[place]
        assert (other.scene, other.splat, other.view, other.variant) == (own.scene, own.splat, own.view, "raw")
    learnt = replace(QUALITY, baseline="gepp")
    for own, before in zip(records, match_baselines(learnt, records), strict=True):
        if own.kind == "quality" and own.variant != "gepp":
            assert {records[i].seed for i in before} == ({0, 1} if own.seed is None else {own.seed})


def test_the_records_behind_a_line_are_those_of_its_block_and_row() -> None:
    records = measured()
    for one in table_lines(QUALITY, records):
        assert one.records
        assert {(block_of(QUALITY, records[i]), records[i].variant) for i in one.records} == {(one.block, one.method)}


def test_the_records_behind_a_cost_are_those_of_the_size_that_they_name() -> None:
    """A size may be the description's own, of which the paper has nothing, and stand in the record's scene."""
    sizes = {"1k": SceneGroup("1K", ("1k",)), "4k": SceneGroup("4K", ("4k",))}
    table = TableDescription(
        "table_3", "", "cost", "", {"ge": MethodDescription("GE")}, "ge", ("milliseconds",), (), sizes, paper={"1k": {}}
    )
    records = [Record("cost", "r", size, "", "", "ge", {"milliseconds": 1.0}, size=(64, 48)) for size in sizes]
    lines = table_lines(table, records)
    assert [(one.block, one.numbers["milliseconds"].value, one.records) for one in lines] == [
        ("1k", 1.0, (0,)),
        ("4k", 1.0, (1,)),
    ]
