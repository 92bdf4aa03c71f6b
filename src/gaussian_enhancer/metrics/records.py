"""Records of measurements: JSON lines with checksums, from which all tables and pages are made."""

import dataclasses
import hashlib
import json
import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import write_text
from gaussian_enhancer.input_files import JSON_GROWTH, parse_json, read_text
from gaussian_enhancer.metrics.provenance import this_commit, this_machine

HIGHER_IS_BETTER = {
    "psnr": True,
    "psnr_aligned": True,
    "psnr_masked": True,
    "ssim": True,
    "lpips_vgg_raw": False,
    "lpips_vgg": False,
    "lpips_alex": False,
    "lpips_squeeze": False,
    "milliseconds": False,
    "peak_memory_mb": False,
    "gaussians": None,
}
"""Which way a metric improves; None where neither way is better."""

LATER: dict[str, Any] = {"seed": None, "sources": {}, "weights": ""}
"""Fields added later, with their values where a line lacks them, so that older lines keep their checksums."""


MISSING = "missing"
"""Kind of the record for a row that could not be measured in a cell; ``reasons["row"]`` says why."""


@dataclass(frozen=True)
class Record:
    """One measurement of one image, or of one run.

    Args:
        kind: what was measured: "quality" or "cost".
        run: the run it belongs to, by its folder's name.
        scene: the scene's name.
        splat: how the render was made: method, and step where there are several.
        view: the image's file name; empty for what concerns the whole run.
        variant: "raw", "enhanced", or a method's name.
        metrics: value by metric; None where it could not be measured.
        reasons: why it could not, by metric.
        size: width and height in pixels.
        protocol: how it was measured, in words.
        commit: version of this code.
        machine: processor, cores and accelerator in words.
        time: when it was measured, ISO 8601, UTC.
        seed: of the training behind it; None where nothing was trained for it.
        sources: the runs that it came from, by job: {"fit": folder name, "train": ..., "enhance": ...}.
        weights: digest of the weights that made the image (`gaussian_enhancer.checkpoint.checkpoint_digest`); empty
            where none did, and in records from before it was kept.
    """

    kind: str
    run: str
    scene: str
    splat: str
    view: str
    variant: str
    metrics: dict[str, float | None]
    reasons: dict[str, str] = field(default_factory=dict)
    size: tuple[int, int] = (0, 0)
    protocol: str = ""
    commit: str = field(default_factory=this_commit)
    machine: str = field(default_factory=this_machine)
    time: str = field(default_factory=lambda: datetime.now(UTC).isoformat(timespec="seconds"))
    seed: int | None = None
    sources: dict[str, str] = field(default_factory=dict)
    weights: str = ""

    def __post_init__(self) -> None:
        unexplained = [name for name, value in self.metrics.items() if value is None and name not in self.reasons]
        if unexplained:
            raise ValueError(f"metric {unexplained[0]} has neither a value nor a reason")


def missing_record(
    variant: str,
    reason: str,
    *,
    run: str = "",
    scene: str = "",
    splat: str = "",
    view: str = "",
    seed: int | None = None,
    sources: dict[str, str] | None = None,
) -> Record:
    """The record for a row that could not be measured.

    Args:
        variant: the method.
        reason: why, in words.
        run: see `Record`, as the following.
        scene: of the row.
        splat: of the row.
        view: of the row.
        seed: of the training behind it.
        sources: the runs that it would have come from.
    """
    return Record(MISSING, run, scene, splat, view, variant, {}, {"row": reason}, seed=seed, sources=sources or {})


def write_records(path: str | Path, records: Iterable[Record]) -> None:
    """Write a file of records atomically; an existing file is replaced.

    Raises:
        InputError: if the file cannot be written.
    """
    text = "".join(record_line(record) for record in records)
    write_text(path, text)


def read_records(path: str | Path) -> tuple[Record, ...]:
    """Read a file of records and check each line against its checksum.

    Raises:
        InputError: if the file is missing, or a line is no record or was changed or cut.
    """
    return tuple(record for _, record in read_checked(path))


def read_checked(path: str | Path) -> tuple[tuple[str, Record], ...]:
    """Read a file of records as `read_records` does; each comes with the checksum that its line states.

    Raises:
        InputError: as `read_records`.
    """
    try:
        content = read_text(path, JSON_GROWTH)
    except InputError as error:
        remedy = "measure first" if error.received == "does not exist" else error.remedy
        raise InputError(path, error.received, remedy) from None
    lines = content.split("\n")  # splitlines would cut names at exotic separators
    return tuple(
        _verified_record(f"{path} line {number}", line) for number, line in enumerate(lines, 1) if line.strip()
    )


def record_line(record: Record) -> str:
    """A record as one line of JSON with the checksum of the rest."""
    values = _jsonable(dataclasses.asdict(record))
    values = {name: value for name, value in values.items() if name not in LATER or value != LATER[name]}
    return json.dumps({**values, "sha256": _checksum(values)}, ensure_ascii=False, allow_nan=False) + "\n"


def parse_record(place: str, line: str) -> Record:
    """The record of a line.

    Args:
        place: what the line is called in errors.
        line: of a file of records.

    Raises:
        InputError: it is no record, or was changed or cut.
    """
    return _verified_record(place, line)[1]


def _verified_record(place: str, line: str) -> tuple[str, Record]:
    """A line's checksum and its record."""
    remedy = "measure again, or delete the line"
    try:
        values = parse_json(line, place)
    except InputError as error:
        raise InputError(place, f"is no record ({error.received})", remedy) from None
    names = {item.name for item in dataclasses.fields(Record)} | {"sha256"}
    if not isinstance(values, dict) or not names - set(LATER) <= set(values) <= names:
        raise InputError(place, "is no record (its fields differ)", remedy)
    stated = values.pop("sha256")
    if stated != _checksum(values):
        raise InputError(place, "was changed or damaged (its checksum differs)", remedy)
    metrics = {name: None if value is None else float(value) for name, value in values["metrics"].items()}
    return stated, Record(**{**values, "metrics": metrics, "size": tuple(values["size"])})


def _jsonable(value: Any) -> Any:
    """JSON has no infinity: numbers that are not finite become the strings that ``float`` reads."""
    if isinstance(value, dict):
        return {key: _jsonable(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_jsonable(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value


def _checksum(values: dict[str, Any]) -> str:
    canonical = json.dumps(values, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return hashlib.sha256(canonical.encode()).hexdigest()[:12]
