"""Makes the page on reliability from records of fault injection: cases tried, handled and failed, by class."""

import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from ablations.stability.judge import FAILED, KIND, REFUSED, WITHIN
from ablations.study.markdown import escape_markdown, frame, markdown
from ablations.study.sections import distinct_values
from gaussian_enhancer.metrics.records import Record, read_records

Row = Mapping[str, Any]

ABOUT = """\
This page counts what happens with damaged files, killed jobs, full disks and extreme inputs. Every number is counted
from a committed record. Those of damaged files and extreme numbers state their commit. Those of inputs guided by
coverage, kills, two processes and full disks state none: they are of 23 November 2026, and code has changed since.

A case is *handled* if the file is read correctly or refused with a one-line message, if the job ends with the result of
an undisturbed job, or if the result is within its tolerance or the input is refused. All other cases have *failed*.
"""

FUZZ = """\
A seeded generator damages small real files: it cuts, flips, deletes, repeats and fills bytes, sets fields of known
formats to extreme values, and replaces words and values. Each case has a limit of time and memory. *Read* means that
what was read satisfies all checks of its format. `nox -s fuzz` runs all cases; the tests run a sample.

Not covered: damage that leaves a plausible file, such as a camera moved by a centimetre. Image codecs are Pillow's own.
"""

COVERAGE = """\
A coverage-guided fuzzer (atheris, libFuzzer) keeps inputs that reach new code and mutates them further. It starts from
the same real files. The table counts the inputs that were tried and the edges (branches of the code) that they reached.
`nox -s fuzz -- --coverage` runs it.

Not covered: compiled code inside NumPy, Pillow, zstandard and safetensors, which is not instrumented.
"""

KILL = """\
Jobs at the smallest scale receive a signal at seeded moments, and the same command is run again. Half of the moments
are file operations: a file is opened, moved or removed. The other moments are fractions of the processor time. On one
thread, the result must equal that of an undisturbed job bit for bit, except for times. After the signal, no visible
file may be truncated, and no unfinished run may be marked as done. `nox -s kill` runs all cases, the tests a sample.

Not covered: loss of power, where the system itself may lose what was written; GPUs; and jobs that write no run
(`report`, `dashboard`). Trainings on several processes and tables on several workers are tested separately.
"""

TWO = """\
One process is paused while it writes, a second one starts in the same folder, and then the first one continues. The
second process must wait, or be refused with a one-line message.
"""

FULL = """\
From the first write of each kind of file onwards, the system refuses to let any file grow. The job must end with a
one-line message, leave no truncated file, and produce the same result once there is space. Paths that differ only in
numbers or in the names of a suite's runs are of one kind; each kind is tried at the first run that writes it.

Not covered: a disk that fails to read.
"""

STABILITY = """\
Extreme inputs in five precisions are compared with float64, forward and backward: [the matrix](results/stability.md).
"""


def reliability_page(
    fuzz: Sequence[Row], coverage: Sequence[Row], kills: Sequence[Row], cells: Sequence[Record]
) -> str:
    """The page as Markdown.

    Args:
        fuzz: rows of ``fuzz.jsonl``.
        coverage: rows of ``fuzz_coverage.jsonl``.
        kills: rows of ``kill.jsonl``.
        cells: of the stability matrix.
    """
    damaged = [row for row in fuzz if "reader" in row and "case" not in row]
    kinds = {
        name: [row for row in kills if row.get("class") == name] for name in ("kill", "two processes", "full disk")
    }
    counts = [
        ("damaged files", *_counts((row["cases"], row["verdict"] in ("refused", "right")) for row in damaged)),
        ("inputs guided by coverage", *_coverage_counts(coverage)),
        ("kills", *_counts(map(_count_case, kinds["kill"]))),
        ("two processes on one folder", *_counts(map(_count_case, kinds["two processes"]))),
        ("full disk", *_counts(map(_count_case, kinds["full disk"]))),
        ("extreme numbers", *_counts((1, cell.variant != FAILED) for cell in cells)),
    ]
    counts = [line if line[1] != "0" else (line[0], "not run yet", "", "") for line in counts]
    parts = ["# Reliability\n", ABOUT, "## In short\n", _table(("class", "tried", "handled", "failed"), counts)]
    parts += ["## Damaged files\n", FUZZ, _readers(damaged)]
    parts += ["## Damaged files, guided by coverage\n", COVERAGE, _coverage_table(coverage)]
    parts += ["## Kills\n", KILL, _by_signal(kinds["kill"])]
    parts += ["## Two processes on one folder\n", TWO, _two_process_table(kinds["two processes"])]
    parts += ["## Full disk\n", FULL, _by_job(kinds["full disk"])]
    parts += ["## Extreme numbers\n", STABILITY, _families(cells)]
    parts += ["## What has failed\n", _failed(fuzz, coverage, kills, cells)]
    parts += ["## Where the numbers come from\n", _sources(cells)]
    return "\n".join(parts)


def read_page(results: Path) -> str:
    """Make the page from the records of a folder.

    Args:
        results: the folder of committed records.

    Raises:
        InputError: the records of the matrix are missing or damaged.
    """
    fuzz, coverage, kills = (_rows(results / f"{name}.jsonl") for name in ("fuzz", "fuzz_coverage", "kill"))
    cells = [record for record in read_records(results / "stability.jsonl") if record.kind == KIND]
    return reliability_page(fuzz, coverage, kills, cells)


def _rows(path: Path) -> list[Row]:
    """The rows of a campaign's file of records; none if it was not run."""
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()] if path.is_file() else []


def _count_case(row: Row) -> tuple[int, bool]:
    return 1, row["verdict"] == "handled"


def _counts(cases: Iterable[tuple[int, bool]]) -> tuple[str, str, str]:
    """Totals of tried, handled and failed cases, from pairs of a count and whether it was handled."""
    totals: Counter[bool] = Counter()
    for count, handled in cases:
        totals[handled] += count
    return tuple(f"{number:,}" for number in (totals.total(), totals[True], totals[False]))  # type: ignore[return-value]


def _coverage_counts(coverage: Sequence[Row]) -> tuple[str, str, str]:
    """Totals of coverage-guided fuzzing; each run ends at its first bad input, so at most one of its inputs failed."""
    tried, failed = sum(row["inputs"] for row in coverage), sum(row["verdict"] == "failed" for row in coverage)
    return f"{tried:,}", f"{tried - failed:,}", f"{failed:,}"


def _table(heads: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    rows = list(lines)
    return markdown(frame(heads, rows)) if rows else "Not run yet.\n"


def _readers(damaged: Sequence[Row]) -> str:
    counts: Counter[tuple[str, str]] = Counter()
    for row in damaged:
        counts[row["reader"], row["verdict"]] += row["cases"]
    verdicts = ("refused", "right", "wrong", "crashed")
    names = sorted({reader for reader, _ in counts})
    lines = [(f"`{name}`", *(str(counts[name, verdict]) for verdict in verdicts)) for name in names]
    return _table(("reader", "refused", "read", "wrong", "crashed"), lines)


def _coverage_table(coverage: Sequence[Row]) -> str:
    lines = [
        (f"`{row['reader']}`", f"`{row['file']}`", f"{row['seconds']}", f"{row['inputs']:,}", f"{row['edges']:,}")
        for row in coverage
    ]
    return _table(("reader", "file", "seconds", "inputs", "edges"), lines)


def _by_signal(kills: Sequence[Row]) -> str:
    lines = []
    for job, signal in sorted({(row["job"], row["signal"]) for row in kills}):
        signal_rows = [row for row in kills if (row["job"], row["signal"]) == (job, signal)]
        writes = sum("write" in row["moment"] for row in signal_rows)
        handled_and_failed = _counts(map(_count_case, signal_rows))[1:]
        lines.append((f"`{job}`", signal, str(writes), str(len(signal_rows) - writes), *handled_and_failed))
    return _table(("job", "signal", "at a write", "at any time", "handled", "failed"), lines)


def _two_process_table(rows: Sequence[Row]) -> str:
    lines = [(f"`{row['job']}`", row["moment"], row["how"], row["verdict"]) for row in rows]
    return _table(("job", "the second runs", "what it did", "verdict"), lines)


def _by_job(rows: Sequence[Row]) -> str:
    jobs = list(dict.fromkeys(row["job"] for row in rows))
    lines = []
    for job in jobs:
        job_rows = [row for row in rows if row["job"] == job]
        moments = ", ".join(f"`{row['moment']}`" for row in job_rows)
        lines.append((f"`{job}`", *_counts(map(_count_case, job_rows)), moments))
    return _table(("job", "sorts of files", "handled", "failed", "which"), lines)


def _families(cells: Sequence[Record]) -> str:
    counts = Counter((cell.run, cell.variant) for cell in cells)
    lines = [
        (family, *(str(counts[family, outcome]) for outcome in (WITHIN, REFUSED, FAILED)))
        for family in dict.fromkeys(cell.run for cell in cells)
    ]
    return _table(("family", WITHIN, REFUSED, "failed"), lines)


def _failed(fuzz: Sequence[Row], coverage: Sequence[Row], kills: Sequence[Row], cells: Sequence[Record]) -> str:
    """A list of all failed cases, with what happened."""
    lines = [(row["case"], row["verdict"], row.get("detail", "")) for row in fuzz if "case" in row]
    lines += [
        (f"{row['reader']} {row['file']}", "failed", row["detail"]) for row in coverage if row["verdict"] == "failed"
    ]
    lines += [
        (f"{row['job']}, {row['class']}, {row['signal']}, {row['moment']}", "failed", row.get("detail", ""))
        for row in kills
        if row.get("verdict") == "failed"
    ]
    lines += [
        (f"{cell.scene} {cell.splat} {cell.view}", "failed", cell.reasons.get("outcome", ""))
        for cell in cells
        if cell.variant == FAILED
    ]
    return (
        "".join(f"- {escape_markdown(case)}: {verdict}; {escape_markdown(detail)}\n" for case, verdict, detail in lines)
        or "Nothing.\n"
    )


def _sources(cells: Sequence[Record]) -> str:
    names = ("fuzz", "fuzz_coverage", "kill", "stability")
    files = ", ".join(f"`docs/results/{name}.jsonl`" for name in names)
    machines = ", ".join(distinct_values(cell.machine for cell in cells))
    return (
        f"{files}. `gaussian-enhancer pages write=true` makes this page from them. "
        f"The matrix was computed on {machines}.\n"
    )
