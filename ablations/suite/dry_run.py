"""The text of a dry run: each run and each cell of the tables, whether it is ready, what it lacks, and a forecast."""

from collections.abc import Iterator, Sequence

from ablations.suite.plan import JOBS, PlannedRun, TableCell
from ablations.suite.schedule import predicted_minutes
from gaussian_enhancer.runs.status import NAMES

READY = "ready"
"""State of a run that is not started, whose inputs are all there or will be made by other runs of the plan."""
WORKERS = (1, 2, 4, 8)
"""Numbers of workers for which every dry run has a forecast."""
SHOWN = 3
"""Number of missing things that a line names; it counts the others."""


def format_plan(steps: Sequence[PlannedRun], workers: int | None = None) -> str:
    """Format a plan as text: a line for each run, a line for each cell of the tables, then the totals.

    Args:
        steps: the plan; a run's inputs come before it.
        workers: number of workers that the user chose; None if it is not known.
    """
    missing = missing_by_run(steps)
    run_lines = (_run_line(step, found) for step, found in zip(steps, missing, strict=True))
    return "\n".join([*run_lines, *_cell_lines(steps, missing), *_totals(steps, missing, workers)])


def missing_by_run(steps: Sequence[PlannedRun]) -> list[dict[str, str]]:
    """What each run lacks that no run makes, itself or through its inputs; nothing for a finished run.

    Args:
        steps: the plan; a run's inputs come before it.

    Returns:
        For each run, what is missing, with the name of the run that needs it.
    """
    by_name: dict[str, dict[str, str]] = {}
    found_by_run = []
    for step in steps:
        found: dict[str, str] = {}
        if step.state.name != "done":
            found = {step.missing: step.name} if step.missing else {}
            for name in step.inputs:
                found = {**by_name.get(name, {}), **found}
        by_name[step.name] = found
        found_by_run.append(found)
    return found_by_run


def _run_line(step: PlannedRun, missing: dict[str, str]) -> str:
    state = f"{step.state.name}: {step.state.detail}" if step.state.detail else step.state.name
    parts = [
        f"{step.work.job:<6} {step.name}",
        READY if _is_ready(step, missing) else state,
        "" if not step.minutes else f"about {step.minutes:.1f} min",
        f"for {', '.join(step.tables)}",
        "" if not step.inputs else f"from {', '.join(step.inputs)}",
        "" if not step.without else f"without {step.without}",
        "" if not missing else f"MISSING: {_shortened(missing, step.name)}",
    ]
    return "; ".join(part for part in parts if part)


def _is_ready(step: PlannedRun, missing: dict[str, str]) -> bool:
    return step.state.name == "not started" and not missing


def _shortened(missing: dict[str, str], own_name: str = "") -> str:
    """What is missing, with the runs that need it; not more than `SHOWN` things by name."""
    texts = [text if name == own_name else f"{text}, needed by {name}" for text, name in missing.items()]
    further = [f"and {len(texts) - SHOWN} more"] if len(texts) > SHOWN else []
    return "; ".join([*texts[:SHOWN], *further])


def _cell_lines(steps: Sequence[PlannedRun], missing: Sequence[dict[str, str]]) -> Iterator[str]:
    """A heading, then a line for each cell: table, dataset and splat."""
    cells: dict[TableCell, list[int]] = {}
    for index, step in enumerate(steps):
        for cell in step.cells:
            cells.setdefault(cell, []).append(index)
    needed = _needed_runs(steps)
    yield f"{len(cells)} cells; the forecast of a cell counts every run that it needs, also those that others share:"
    for cell, own in cells.items():
        runs = sorted(set().union(*(needed[index] for index in own)))
        found = {text: name for index in own for text, name in missing[index].items()}
        yield f"cell   {cell}: {_cell_state([steps[index] for index in runs], [steps[index] for index in own], found)}"


def _needed_runs(steps: Sequence[PlannedRun]) -> list[set[int]]:
    """Positions of the unfinished runs that each run needs, with its own; empty for a finished run."""
    by_name: dict[str, set[int]] = {}
    needed_by_run = []
    for index, step in enumerate(steps):
        needed: set[int] = set()
        if step.state.name != "done":
            needed = {index}.union(*(by_name.get(name, set()) for name in step.inputs))
        by_name[step.name] = needed
        needed_by_run.append(needed)
    return needed_by_run


def _cell_state(unfinished: Sequence[PlannedRun], own: Sequence[PlannedRun], missing: dict[str, str]) -> str:
    """Whether a cell is done or ready, what it lacks, and its forecast."""
    if not unfinished:
        return "done"
    without = ", ".join(dict.fromkeys(step.without for step in own if step.without))
    parts = [
        f"MISSING: {_shortened(missing)}" if missing else READY,
        f"without {without}" if without else "",
        f"{len(unfinished)} runs to make",
        f"about {sum(step.minutes for step in unfinished):.1f} min",
    ]
    return "; ".join(part for part in parts if part)


def _totals(steps: Sequence[PlannedRun], missing: Sequence[dict[str, str]], workers: int | None) -> Iterator[str]:
    states = [READY if _is_ready(step, found) else step.state.name for step, found in zip(steps, missing, strict=True)]
    counts = {name: states.count(name) for name in (READY, *NAMES)}
    yield f"{len(steps)} runs: " + ", ".join(f"{count} {name}" for name, count in counts.items() if count)
    minutes = {job: sum(step.minutes for step in steps if step.work.job == job) for job in JOBS}
    total = sum(minutes.values())
    shares = ", ".join(f"{job} {value:.0f}" for job, value in minutes.items() if value)
    yield f"about {total:.0f} minutes to go ({total / 60:.1f} hours of one worker){': ' + shares if shares else ''}"
    yield from _forecast(steps, workers) if total else ()
    lacking = sum(map(bool, missing))
    yield (
        f"{lacking} runs lack something that no run makes, themselves or through their inputs"
        if lacking
        else "nothing is missing"
    )


def _forecast(steps: Sequence[PlannedRun], workers: int | None) -> Iterator[str]:
    """Hours by the number of workers; the chosen number is marked."""
    hours = []
    for count in sorted({*WORKERS, *(() if workers is None else (workers,))}):
        chosen = " (as configured)" if count == workers else ""
        hours.append(f"{count}{chosen}: {predicted_minutes(steps, count) / 60:.1f}")
    yield f"predicted hours by the number of workers, each with a device of its own: {', '.join(hours)}"
