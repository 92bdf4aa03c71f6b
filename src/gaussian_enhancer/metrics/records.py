"""Records of measurements: JSON lines with checksums. All tables and pages are made from them."""

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
"""Whether a higher value of a metric is better; None if neither direction is better."""

LATER_FIELDS: dict[str, Any] = {"seed": None, "sources": {}, "weights": "", "photo": ""}
"""Fields added later, with default values. Defaults are not written, so that older lines keep their checksums."""


MISSING = "missing"
"""Kind of the record for a row that could not be measured; ``reasons["row"]`` says why."""


@dataclass(frozen=True)
class Record:
    """One measurement of one image, or of one run.

    Args:
        kind: what was measured: "quality", "cost", or `MISSING`.
        run: folder name of the run.
        scene: the scene's name.
        splat: how the render was made: method, and step if there are several.
        view: the image's file name; empty for a measurement of the whole run.
        variant: "raw", "enhanced", or a method's name.
        metrics: value by metric; None if it could not be measured.
        reasons: the reason for each None, by metric.
        size: width and height in pixels.
        protocol: description of the measurement.
        commit: version of this code.
        machine: description of processor, cores and accelerator.
        time: time of the measurement, ISO 8601, UTC.
        seed: seed of the training whose result was measured; None without training.
        sources: the runs that the result came from, by job: {"fit": folder name, "train": ..., "enhance": ...}.
        weights: digest of the weights that made the image (`gaussian_enhancer.checkpoint.checkpoint_digest`); empty
            if no weights were used, and in older records without this field.
        photo: digest of the photo that the image was compared with; empty if there was none, and in records before 29
            November 2026.
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
    photo: str = ""

    def __post_init__(self) -> None:
        unexplained = [name for name, value in self.metrics.items() if value is None and name not in self.reasons]
        if unexplained:
            raise ValueError(f"metric {unexplained[0]} has neither a value nor a reason")


def write_records(path: str | Path, records: Iterable[Record]) -> None:
    """Write a file of records atomically; an existing file is replaced.

    Raises:
        InputError: the file cannot be written.
    """
    text = "".join(record_line(record) for record in records)
    write_text(path, text)


def read_records(path: str | Path) -> tuple[Record, ...]:
    """Read a file of records and check each line against its checksum.

    Raises:
        InputError: the file is missing, or a line is not a record, was changed or is truncated.
    """
    return tuple(record for _, record in read_checked(path))


def read_checked(path: str | Path) -> tuple[tuple[str, Record], ...]:
    """Read a file of records like `read_records`, and return each record with its line's checksum.

    Raises:
        InputError: as `read_records`.
    """
    try:
        content = read_text(path, JSON_GROWTH)
    except InputError as error:
        remedy = "measure first" if error.received == "does not exist" else error.remedy
        raise InputError(path, error.received, remedy) from None
    lines = content.split("\n")  # splitlines would also split at rare Unicode separators within names
    return tuple(
        _verified_record(f"{path} line {number}", line) for number, line in enumerate(lines, 1) if line.strip()
    )


def record_line(record: Record) -> str:
    """Serialise a record as one line of JSON with a checksum of its other fields."""
    values = stringify_non_finite(dataclasses.asdict(record))
    values = {name: value for name, value in values.items() if name not in LATER_FIELDS or value != LATER_FIELDS[name]}
    return json.dumps({**values, "sha256": _checksum(values)}, ensure_ascii=False, allow_nan=False) + "\n"


def stringify_non_finite(value: Any) -> Any:
    """Convert non-finite numbers in a plain value, which JSON does not have, to strings that ``float`` parses."""
    if isinstance(value, dict):
        return {str(key): stringify_non_finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [stringify_non_finite(item) for item in value]
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


def parse_record(place: str, line: str) -> Record:
    """Parse a line of a file of records and verify its checksum.

    Args:
        place: name of the line in errors.
        line: the line.

    Raises:
        InputError: the line is not a record, was changed or is truncated.
    """
    return _verified_record(place, line)[1]


def _verified_record(place: str, line: str) -> tuple[str, Record]:
    """Verify a line; return its checksum and its record."""
    remedy = "measure again, or delete the line"
    try:
        values = parse_json(line, place)
    except InputError as error:
        raise InputError(place, f"is no record ({error.received})", remedy) from None
    names = {item.name for item in dataclasses.fields(Record)} | {"sha256"}
    if not isinstance(values, dict) or not names - set(LATER_FIELDS) <= set(values) <= names:
        raise InputError(place, "is no record (its fields differ)", remedy)
    stated_checksum = values.pop("sha256")
    if stated_checksum != _checksum(values):
        raise InputError(place, "was changed or damaged (its checksum differs)", remedy)
    metrics = {name: None if value is None else float(value) for name, value in values["metrics"].items()}
    return stated_checksum, Record(**{**values, "metrics": metrics, "size": tuple(values["size"])})


def _checksum(values: dict[str, Any]) -> str:
    canonical = json.dumps(values, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return hashlib.sha256(canonical.encode()).hexdigest()[:12]
