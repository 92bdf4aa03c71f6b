"""Texts above and below a table: caption with stand-ins and machine, how to read the table, sources of its numbers."""

from collections.abc import Sequence
from pathlib import Path

from ablations.study.description import TableDescription
from ablations.study.sections import distinct_values
from ablations.study.statistics import MIN_UNITS
from gaussian_enhancer.files import file_digest
from gaussian_enhancer.metrics.records import MISSING, Record

KINDS = {
    "quality": (
        "Means over scenes of the means over their seeds and views. Gains are over the first method, on the same "
        "scenes, seeds and views, with a 95 % bootstrap interval (BCa) that draws scenes, or the views of each scene "
        f"where there are fewer than {MIN_UNITS} scenes; there is none below {MIN_UNITS} views. p: two-sided "
        "sign-flip test of the gains, corrected by Holm over all methods and blocks of a column"
    ),
    "repeats": (
        "Statistics of gains over the baseline. A run is one training seed, its gain the mean over the dataset's "
        "scenes of the mean over their views; 'by scene' takes every scene of every seed as a run of its own. Largest "
        "and smallest are numbers, not merits; std is the standard deviation with ddof=1"
    ),
    "cost": "Medians of interleaved repeats, and peak memory",
}
KINDS["images"] = KINDS["quality"]


def caption(table: TableDescription, records: Sequence[Record]) -> str:
    """Title, scale, rows of the paper's system, stand-ins, and for tables of cost the machine, as sentences.

    Args:
        table: its description.
        records: its records.
    """
    sentences = [table.title]
    sentences += [f"Scale: {table.scale}"] if table.scale else []
    sentences += _system_sentences(table, records)
    sentences += [stand_in(d.stand_in, d.title) for d in table.datasets.values() if d.stand_in]
    if table.kind == "cost":
        machines = distinct_values(record.machine for record in records if record.kind == "cost")
        sentences += [f"Measured on {'; '.join(machines)}"] if machines else ["Measured on no machine yet"]
        if any("no GPU" in machine for machine in machines):
            sentences.append("These are CPU times and the memory of a process: the machine has no GPU")
    return " ".join(f"{sentence.rstrip('.')}." for sentence in sentences)


def _system_sentences(table: TableDescription, records: Sequence[Record]) -> list[str]:
    """Sentences on which rows are the paper's system and which are ours, and on the paper's rows that are missing."""
    if not any(method.mode for method in table.methods.values()):
        return []
    lines = [
        "Rows named paper are our reading of the paper's system (docs/fidelity.md lists its deviations), those named "
        "ours have its parts by our own networks"
    ]
    measured_variants = {record.variant for record in records if record.kind != MISSING}
    missing_rows = [
        row.title for name, row in table.methods.items() if row.mode == "paper" and name not in measured_variants
    ]
    return lines + ([f"Not made at this scale: {'; '.join(missing_rows)}"] if missing_rows else [])


def stand_in(substitute: str, dataset: str) -> str:
    """A sentence that names a stand-in: "Stand-in: procedural scenes stand in for Mip-NeRF 360"."""
    verb = "stands" if substitute.lower().startswith(("a ", "an ", "one ", "the ")) else "stand"
    return f"Stand-in: {substitute} {verb} in for {dataset}"


def reading(table: TableDescription, units: Sequence[str], alone: bool = False) -> str:
    """How to read the table's numbers.

    Args:
        table: its description.
        units: what one mean of the significance tests is taken for.
        alone: whether every block has only one scene.
    """
    text = KINDS[table.kind]
    if units:
        text += f", on means by {' or by '.join(units)}"
    if "view" in units:
        text += f" (by view where fewer than {MIN_UNITS} scenes and seeds could tell nothing)"
    single_scene = " A block has one scene: its intervals and tests speak of that scene alone." if alone else ""
    bold = "" if table.kind == "repeats" else " Bold: best of a column in its block."
    paper = " The paper's numbers stand beside ours; a dash where it has none." if table.paper else ""
    return f"{text}.{single_scene}{bold}{paper}"


def sources(folder: Path, table: TableDescription, records: Sequence[Record]) -> tuple[tuple[str, str], ...]:
    """The sources of the numbers: the distinct values that the records state, and the hash of their file.

    Args:
        folder: folder of description and records.
        table: its description.
        records: its records.
    """
    times = sorted(record.time for record in records)
    path = folder / f"{table.name}.jsonl"
    digest = file_digest(path) if path.is_file() else "no file of records beside this one"
    lines = {
        "protocol": "; ".join(distinct_values(record.protocol for record in records)),
        "commits": ", ".join(distinct_values(record.commit for record in records)),
        "machines": "; ".join(distinct_values(record.machine for record in records)),
        "measured": f"{times[0]} to {times[-1]}" if times else "",
        "records": f"{len(records)} in {table.name}.jsonl",
        "sha256 of the records": digest,
    }
    return tuple((label, text or "not stated") for label, text in lines.items())
