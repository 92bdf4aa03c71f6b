"""Measurements of a study as rows of a frame, and the file that stores them, one JSON object per line.

A measurement is either a `Record`, whose line has a checksum, or a mapping with the study's own columns.
"""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import write_text
from gaussian_enhancer.input_files import parse_json, read_text
from gaussian_enhancer.metrics.provenance import provenance
from gaussian_enhancer.metrics.records import Record, parse_record, record_line

Measurement = Record | Mapping[str, Any]

FIELDS = ("kind", "run", "scene", "splat", "view", "variant", "seed", "weights", "commit", "machine", "time")
"""Fields of a record that become columns of a frame, beside its metrics."""


def row_of(measurement: Measurement) -> dict[str, Any]:
    """A measurement as values by column; a record's metrics are columns beside its fields."""
    if isinstance(measurement, Record):
        return {**{name: getattr(measurement, name) for name in FIELDS}, **measurement.metrics}
    return dict(measurement)


def frame_of(measurements: Iterable[Measurement]) -> pd.DataFrame:
    """A frame with one row per measurement; nested values become columns "OUTER INNER"."""
    return pd.json_normalize([row_of(measurement) for measurement in measurements], sep=" ")


def with_gains(frame: pd.DataFrame, baseline: Mapping[str, str], keys: Sequence[str]) -> pd.DataFrame:
    """Add a column "gain METRIC" for every numeric column: the row's value minus that of its baseline row.

    Args:
        frame: rows.
        baseline: values by column that select the baseline rows.
        keys: columns in which a row and its baseline row agree, for instance run and view.
    """
    is_baseline = (frame[list(baseline)] == pd.Series(baseline)).all(axis=1)
    numbers = [name for name in frame.select_dtypes("number") if name not in keys]
    baseline_rows = frame.loc[is_baseline, [*keys, *numbers]].set_index(list(keys))
    matching_rows = baseline_rows.reindex(
        pd.MultiIndex.from_frame(frame[list(keys)]) if len(keys) > 1 else frame[keys[0]]
    )
    gains = {f"gain {name}": frame[name].to_numpy() - matching_rows[name].to_numpy() for name in numbers}
    return frame.assign(**gains)


@dataclass(frozen=True)
class RowFile:
    """The file of a study's measurements.

    Args:
        path: the file.
        keys: columns that identify a measurement; a new one replaces rows with the same keys.
        columns: further columns that it must have.
        option: the job's option that selects what is measured, for error messages.
    """

    path: Path
    keys: tuple[str, ...]
    columns: tuple[str, ...] = ()
    option: str = "runs"

    def read(self) -> pd.DataFrame:
        """Read all rows.

        Raises:
            InputError: the file is missing or not a file of these rows, or a record is damaged.
        """
        frame = frame_of(row for _, row in self._lines())
        missing_columns = set() if frame.empty else {*self.keys, *self.columns} - set(frame.columns)
        if missing_columns:
            raise InputError(self.path, f"lacks the column {sorted(missing_columns)[0]}", self._remedy)
        return frame

    def read_or_empty(self) -> pd.DataFrame:
        """Read all rows; none if there is no file.

        Raises:
            InputError: the file is not a file of these rows.
        """
        return self.read() if self.path.exists() else pd.DataFrame(columns=[*self.keys, *self.columns])

    def add_lines(self, lines: Sequence[str]) -> None:
        """Add lines of measurements, made by `line_of`, and replace those with the same keys.

        Raises:
            InputError: a line or the file is invalid, or the file cannot be written.
        """
        self.read_or_empty()
        new_keys = {self._key(self._row("measured now", line)) for line in lines}
        old_lines = self._lines() if self.path.exists() else []
        kept = [line for line, row in old_lines if self._key(row) not in new_keys]
        if lines:
            write_text(self.path, "".join(f"{line}\n" for line in [*kept, *lines]))

    def _key(self, row: Mapping[str, Any]) -> tuple[Any, ...]:
        return tuple(row[name] for name in self.keys)

    def _lines(self) -> list[tuple[str, dict[str, Any]]]:
        """Every line of the file, with its row."""
        lines = [line for line in read_text(self.path).split("\n") if line.strip()]
        return [(line, self._row(f"{self.path} line {number}", line)) for number, line in enumerate(lines, 1)]

    def _row(self, place: str, line: str) -> dict[str, Any]:
        try:
            values = parse_json(line, place)
        except InputError as error:
            raise InputError(self.path, f"is no file of rows ({error.received})", self._remedy) from error
        if not isinstance(values, dict):
            raise InputError(self.path, "is no file of rows", self._remedy)
        return row_of(parse_record(place, line)) if "sha256" in values else values

    @property
    def _remedy(self) -> str:
        return f"measure again, with {self.option}="


def with_provenance(measurement: Measurement) -> Measurement:
    """The measurement with its provenance (commit, machine, time); records have theirs already."""
    return measurement if isinstance(measurement, Record) else {**measurement, **provenance(timed=True)}


def line_of(measurement: Measurement) -> str:
    """A measurement as one line of JSON, without line break."""
    if isinstance(measurement, Record):
        return record_line(measurement).rstrip("\n")
    return json.dumps(_plain(measurement), ensure_ascii=False, allow_nan=False)


def _plain(value: Any) -> Any:
    """Replace non-finite numbers by None, since JSON has none."""
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    return None if isinstance(value, float) and not math.isfinite(value) else value
