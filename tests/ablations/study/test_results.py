"""Records as a table asks for them: what is paired with what, and what is missing, why."""

import dataclasses
import random

import pytest

from ablations.study.description import MethodDescription, SceneGroup, TableDescription
from ablations.study.results import Results, block_of
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.metrics.records import MISSING, Record

HILL = ("hill", "3dgs")
ROWS = {
    "raw": MethodDescription("raw", role=""),
    "one": MethodDescription("one", train=("a",)),
    "two": MethodDescription("two", train=("b",)),
    "file": MethodDescription("file"),
}
TABLE = TableDescription(
    "t", "", "quality", "", ROWS, "raw", ("psnr",), ("3dgs",), {"d": SceneGroup("D", ("hill",))}, (0, 1)
)


def frame(method: str, seed: int | None, psnr: float | None, view: str = "a", scene: str = "hill") -> Record:
    reasons = {"psnr": "torn"} if psnr is None else {}
    return Record("quality", "r", scene, "3dgs", view, method, {"psnr": psnr}, reasons, seed=seed)


def gap(method: str, seed: int | None, splat: str = "3dgs", scene: str = "hill") -> Record:
    return Record(MISSING, "", scene, splat, "", method, {}, {"row": f"{method} burnt"}, seed=seed)


RAW, ONE = [frame("raw", None, 20.0)], [frame("one", 0, 21.0), frame("one", 1, 23.0)]


def test_a_row_without_a_seed_stands_beside_every_seed() -> None:
    gains = Results(TABLE, [*RAW, *ONE]).gains("3dgs", "one", "psnr")
    assert gains.values == {(HILL, 0): {"a": 1.0}, (HILL, 1): {"a": 3.0}}
    assert gains.complete


def test_trained_rows_are_paired_by_seed() -> None:
    two = [frame("two", 0, 24.0), frame("two", 1, 24.0)]
    gains = Results(TABLE, [*ONE, *two]).gains("3dgs", "two", "psnr", over="one")
    assert gains.unit_means() == {(HILL, 0): 3.0, (HILL, 1): 1.0}


def test_a_row_without_training_against_a_trained_baseline() -> None:
    results = Results(dataclasses.replace(TABLE, baseline="one"), [*RAW, *ONE])
    assert results.gains("3dgs", "raw", "psnr").unit_means() == {(HILL, 0): -1.0, (HILL, 1): -3.0}


def test_a_row_of_a_weights_file_has_one_unit() -> None:
    gains = Results(TABLE, [*RAW, frame("file", None, 22.0)]).gains("3dgs", "file", "psnr")
    assert gains.unit_means() == {(HILL, None): 2.0}


def test_reasons_reach_the_units_that_they_keep_from_the_table() -> None:
    some = Results(TABLE, [*RAW, frame("one", 0, 21.0), gap("one", 1)]).gains("3dgs", "one", "psnr")
    assert (some.missing, set(some.values)) == ({(HILL, 1): "one burnt"}, {(HILL, 0)})
    none = Results(TABLE, [*RAW, gap("one", None)]).values("3dgs", "one", "psnr")
    assert none.missing == {(HILL, 0): "one burnt", (HILL, 1): "one burnt"}
    silent = Results(TABLE, RAW).values("3dgs", "one", "psnr")
    assert silent.missing == {(HILL, 0): "no record", (HILL, 1): "no record"}
    first = Results(TABLE, [gap("raw", None), *ONE]).gains("3dgs", "one", "psnr")
    assert first.missing[(HILL, 0)] == "raw is missing: raw burnt"


def test_views_without_a_number_are_kept_with_their_reason() -> None:
    records = [
        *RAW,
        frame("raw", None, None, "b"),
        frame("raw", None, 20.0, "c"),
        frame("raw", None, float("inf"), "d"),
    ]
    records += [frame("file", None, 21.0, view) for view in "abd"]
    gains = Results(TABLE, records).gains("3dgs", "file", "psnr")
    assert gains.values == {(HILL, None): {"a": 1.0}}
    reasons = {"b": "torn", "c": "not measured as file", "d": "psnr is not finite"}
    assert gains.unknown == {(HILL, None): reasons}
    only = Results(TABLE, [frame("file", None, None)]).values("3dgs", "file", "psnr")
    assert (only.values, only.missing) == ({}, {(HILL, None): "torn"})


def test_what_the_table_does_not_ask_for_stays_outside() -> None:
    strays = [frame("one", None, 1.0), frame("one", 7, 1.0), frame("raw", None, 1.0, scene="moon"), frame("x", 0, 1.0)]
    results = Results(TABLE, [*RAW, *ONE, *strays])
    assert len(results.uncovered_records) == 4
    assert results.gains("3dgs", "one", "psnr").mean() == 2.0


def test_the_order_of_records_changes_nothing() -> None:
    records = [*RAW, *ONE, gap("two", 0), frame("two", 1, 5.0)]
    wanted = [Results(TABLE, records).gains("3dgs", method, "psnr") for method in ("one", "two")]
    for _ in range(5):
        random.shuffle(records)
        assert [Results(TABLE, records).gains("3dgs", method, "psnr") for method in ("one", "two")] == wanted


def test_a_view_measured_twice_is_refused() -> None:
    with pytest.raises(InputError, match="measured twice as 'one' with seed 1"):
        Results(TABLE, [*ONE, frame("one", 1, 9.0)])


def test_costs_belong_to_the_size_that_they_name_or_have() -> None:
    table = dataclasses.replace(TABLE, kind="cost", metrics=("milliseconds",), splats=(), datasets={}, paper={"1k": {}})
    named = Record("cost", "r", "hill", "", "1k", "one", {"milliseconds": 5.0}, size=(9, 9), seed=0)
    sized = Record("cost", "r", "hill", "", "", "one", {"milliseconds": 7.0}, size=(64, 48), seed=0)
    assert [block_of(table, one) for one in (named, sized, gap("two", None, "", ""))] == ["1k", "64 x 48", ""]
    assert block_of(TABLE, sized) == ""
    assert block_of(TABLE, gap("two", None)) == "3dgs"
    results = Results(table, [named, sized, gap("two", None, "", "")])
    assert results.blocks == ("1k", "64 x 48")
    assert [results.values(block, "one", "milliseconds").mean() for block in results.blocks] == [5.0, 7.0]
    scenes = {"1k": SceneGroup("1K", ("1k",)), "2k": SceneGroup("2K", ("2k",))}
    own = Results(dataclasses.replace(table, datasets=scenes), [dataclasses.replace(named, scene="1k")])
    assert (own.blocks, own.scenes_of("1k")) == (("1k", "2k"), ("1k",))
    assert own.values("2k", "one", "milliseconds").missing == {(("2k", "2k"), 0): "no record"}
    assert own.values("1k", "one", "milliseconds").complete
