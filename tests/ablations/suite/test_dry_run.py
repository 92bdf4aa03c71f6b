"""What a dry run says of runs and cells: ready, done or what is missing, through inputs too, and how long it takes."""

import pytest

from ablations.suite.dry_run import format_plan, missing_by_run
from ablations.suite.plan import PlannedRun, RunSpec, TableCell
from ablations.suite.schedule import predicted_minutes
from gaussian_enhancer.runs.status import State

CELL = TableCell("table_2", "Mip-NeRF 360", "3dgs")


def step(name: str, minutes: float, *inputs: str, job: str = "fit", missing: str = "", **further) -> PlannedRun:
    state = State(further.pop("state", "not started"))
    return PlannedRun(
        RunSpec(job, "table_2"), name, name, state, inputs, float(minutes), missing, ("table_2",), **further
    )


def cell_lines(steps: list[PlannedRun]) -> list[str]:
    return [line for line in format_plan(steps).splitlines() if line.startswith("cell ")]


def test_a_run_is_ready_if_nothing_is_missing_on_its_way() -> None:
    steps = [step("a", 3), step("b", 5, "a", job="train"), step("c", 1, "b", job="row", cells=(CELL,))]
    text = format_plan(steps, 2)
    assert text.splitlines()[2] == "row    c; ready; about 1.0 min; for table_2; from b"
    assert cell_lines(steps) == ["cell   table_2, Mip-NeRF 360, 3dgs: ready; 3 runs to make; about 9.0 min"]
    assert "3 runs: 3 ready\n" in text
    assert text.endswith("nothing is missing")


def test_what_an_input_lacks_is_named_with_the_input() -> None:
    steps = [
        step("a", 3, missing="no photos"),
        step("b", 5, "a", job="train"),
        step("c", 1, "b", job="row", cells=(CELL,)),
        step("d", 1, job="row", cells=(TableCell("table_2", "Deep Blending", "3dgs"),)),
    ]
    lines = format_plan(steps).splitlines()
    assert lines[0].endswith("MISSING: no photos")
    assert lines[2] == "row    c; not started; about 1.0 min; for table_2; from b; MISSING: no photos, needed by a"
    assert cell_lines(steps) == [
        "cell   table_2, Mip-NeRF 360, 3dgs: MISSING: no photos, needed by a; 3 runs to make; about 9.0 min",
        "cell   table_2, Deep Blending, 3dgs: ready; 1 runs to make; about 1.0 min",
    ]
    assert "4 runs: 1 ready, 3 not started" in lines
    assert lines[-1].startswith("3 runs lack something")


def test_finished_runs_need_nothing_any_more() -> None:
    gone = step("a", 0, missing="no photos", state="done")
    row = step("b", 0, "a", job="row", state="done", cells=(CELL,))
    assert missing_by_run([gone, row, step("c", 1, "a")]) == [{}, {}, {}]
    assert cell_lines([gone, row]) == ["cell   table_2, Mip-NeRF 360, 3dgs: done"]
    assert "predicted" not in format_plan([gone, row])


def test_a_metric_without_backbone_does_not_stop_its_run() -> None:
    row = step("a", 1, job="row", without="lpips_vgg_raw: no backbone", cells=(CELL,))
    text = format_plan([row])
    assert "row    a; ready; about 1.0 min; for table_2; without lpips_vgg_raw: no backbone\n" in text
    assert ": ready; without lpips_vgg_raw: no backbone; 1 runs to make" in text
    assert text.endswith("nothing is missing")


def test_a_shared_run_counts_in_every_cell_and_once_in_all() -> None:
    other = TableCell("table_4", "Tanks & Temples", "3dgs")
    steps = [step("a", 10), step("b", 1, "a", job="row", cells=(CELL,)), step("c", 2, "a", job="row", cells=(other,))]
    assert [line.rsplit("; ", 1)[1] for line in cell_lines(steps)] == ["about 11.0 min", "about 12.0 min"]
    assert "about 13 minutes to go" in format_plan(steps)


def test_long_lists_of_missing_things_are_counted() -> None:
    fits = [step(f"f{i}", 1, missing=f"no photos {i}") for i in range(5)]
    row = step("r", 1, *(fit.name for fit in fits), job="row", cells=(CELL,))
    (line,) = cell_lines([*fits, row])
    assert line.count("needed by") == 3
    assert "; and 2 more; " in line


@pytest.mark.parametrize(("workers", "minutes"), [(1, 30.0), (2, 15.0), (3, 13.0), (8, 13.0)])
def test_the_schedule_waits_for_inputs_and_takes_the_longest_first(workers, minutes) -> None:
    steps = [
        step("short", 1),
        step("a", 4),
        step("b", 4),
        step("long", 7, "a"),
        step("row", 2, "long", job="row"),
        step("other", 12),
    ]
    assert predicted_minutes(steps, workers) == minutes


def test_costs_are_measured_alone_and_at_the_end() -> None:
    steps = [step("a", 4), step("done", 9, state="done"), step("b", 4, "done"), step("time", 3, "a", job="cost")]
    assert predicted_minutes(steps, 4) == 4 + 3


def test_the_forecast_names_the_configured_number_of_workers() -> None:
    steps = [step(f"f{i}", 60) for i in range(12)]
    (line,) = [line for line in format_plan(steps, 3).splitlines() if line.startswith("predicted")]
    assert line.endswith(": 1: 12.0, 2: 6.0, 3 (as configured): 4.0, 4: 3.0, 8: 2.0")
    assert "configured" not in format_plan(steps)  # a scheduler's workers are not known
