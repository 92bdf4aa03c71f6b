"""How cells are judged, that hangs and crashes are cells, a fast subset of the catalogue, and the committed matrix."""

import math

import pytest

from ablations.report.stability import faults
from ablations.stability import order
from ablations.stability.case import PRECISIONS
from ablations.stability.catalogue import FAMILIES, catalogue
from ablations.stability.judge import FAILED, KIND, REFUSED, WITHIN, judge_case
from ablations.stability.watched import matrix_records
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.metrics.records import read_records
from support.paths import DOCS
from support.strained_cases import case

FLOAT32, BFLOAT16, FLOAT16 = PRECISIONS[:3]
COMMITTED = DOCS / "results/stability.jsonl"

FAST = (
    "needles_3dgs",
    "near_singular_mip_splatting",
    "edge_on_2dgs",
    "focal_1e5_3dgs",
    "harmonics_3dgs",
    "harmonics_2dgs",
    "harmonics_mip_splatting",
    "log_scale_90_2dgs",
    "log_scale_-1e30_3dgs",
    "constant_simulated",
    "black_lr_tiny",
    "one_pixel_lr_tiny",
    "checkerboard_sr_tiny",
    "one_of_a_batch",
    "unseen_network",
    "black_objective",
    "some_nan_warp",
    "1e38_warp",
    "some_1e38_warp",
    "half_size_unwarped",
    "nan_in_render",
    "plus_1e4",
    "steep_4",
    "nan_in_a_sample",
)
"""Cases that found faults, and others of every family, that take a fraction of a second a cell."""


@pytest.mark.parametrize(
    ("kind", "direction", "outcome", "reason"),
    [
        ("fine", "forward", WITHIN, ""),
        ("linear", "backward", WITHIN, ""),
        ("refuses", "forward", REFUSED, "x: is strained; rest"),
        ("breaks", "forward", FAILED, "RuntimeError: no such kernel"),
        ("nan", "forward", FAILED, "not finite"),
        ("wrong", "forward", FAILED, "off by 0.02"),
        ("wrong gradient", "backward", FAILED, "off by 1"),
        ("endless gradient", "backward", FAILED, "float64 itself is not finite"),
    ],
)
def test_a_cell_ends_as_its_case_does(kind, direction, outcome, reason):
    cell = judge_case(case(kind), FLOAT32, direction)
    assert cell.outcome == outcome
    assert reason in cell.reason
    assert bool(cell.reason) == (outcome != WITHIN)


def test_a_result_in_single_precision_says_so():
    assert [
        judge_case(case("single"), precision, "forward").computed for precision in (FLOAT32, BFLOAT16, FLOAT16)
    ] == [
        "",
        "float32",
        "float32",
    ]


def test_the_reference_is_computed_on_the_rounded_numbers():
    """Rounding 1.25 and 1.75 costs nothing, 1 / 3 would cost bfloat16 a thousandth: neither counts as an error."""
    assert judge_case(case("fine"), BFLOAT16, "forward").error == 0


def test_a_hang_and_a_crash_are_cells_and_the_rest_is_computed():
    cases = [case("hangs", seconds=0.5), case("dies"), case("fine")]
    records = list(matrix_records(cases, PRECISIONS[:1]))
    assert [record.variant for record in records] == [FAILED, FAILED, WITHIN]
    assert records[0].reasons["outcome"] == "has no result after 0.5 s"
    assert "code 7" in records[1].reasons["outcome"]
    assert all(record.kind == KIND for record in records)


@pytest.mark.parametrize("name", FAST)
def test_a_fast_case_does_not_fail(name):
    (one,) = catalogue(names=[name])
    for direction in one.passes:
        for precision in PRECISIONS:
            cell = judge_case(one, precision, direction)
            assert cell.outcome != FAILED, f"{precision.name}, {direction}: {cell.reason}"


@pytest.mark.parametrize("name", ["nan_in_render", "1e30_in_render", "1e30_in_references"])
def test_what_is_refused_names_its_cause(name):
    (one,) = catalogue(names=[name])
    cell = judge_case(one, FLOAT32, "forward")
    assert cell.outcome == REFUSED
    assert name.split("_")[-1] in cell.reason


def test_unknown_families_and_cases_are_refused():
    with pytest.raises(InputError, match="choose from splats"):
        catalogue(families=["splat"])
    with pytest.raises(InputError, match="choose from"):
        catalogue(names=["absent"])


def test_names_are_unique_and_faults_name_cases():
    names = [one.name for one in catalogue()]
    assert len(set(names)) == len(names)
    assert {fault["case"] for fault in faults()} <= set(names)
    assert {one.family for one in catalogue()} == set(FAMILIES)


@pytest.mark.skipif(not COMMITTED.is_file(), reason="not measured yet: gaussian-enhancer stability")
def test_the_committed_matrix_is_whole_and_no_cell_has_failed():
    cells = [record for record in read_records(COMMITTED) if record.kind == KIND]
    expected = {(one.name, p.name, d) for one in catalogue() for p in PRECISIONS for d in one.passes}
    assert {(record.scene, record.splat, record.view) for record in cells} == expected
    failed = [f"{r.scene} {r.splat} {r.view}: {r.reasons['outcome']}" for r in cells if r.variant == FAILED]
    assert failed == []


def test_the_samplers_error_falls_with_its_steps():
    """Slower than by order 1: the denoiser hears the time in waves that 256 steps only begin to resolve."""
    records = list(order.order_records("cosine", (8, 16, 32), 512))
    errors = [record.metrics["error"] for record in records]
    assert errors == sorted(errors, reverse=True)
    assert 0 < order.slopes(records)["cosine"] < 1.4


def test_order_is_read_off_errors_and_a_walk_that_diverges_says_so(monkeypatch):
    known = {"cosine": {4: 0.4, 8: 0.2, 16: 0.1}, "steep": {4: math.inf, 8: 0.2, 16: 0.1}}
    monkeypatch.setattr(order, "ddim_errors", lambda name, counts, finest: known[name])
    records = [record for name in known for record in order.order_records(name, (4, 8, 16), 32)]
    assert order.slopes(records) == {"cosine": pytest.approx(1.0)}
    assert [one.reasons for one in records if one.scene == "steep"] == [{"error": "the walk diverges"}, {}, {}]
