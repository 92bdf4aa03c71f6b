"""Measurements of a study as rows of one frame, and the file that keeps them, one JSON object a line.

A measurement is a `Record`, whose line has a checksum, or a row with columns of the study's own.
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
"""Fields of a record that are columns of a frame, beside its metrics."""


def row_of(measurement: Measurement) -> dict[str, Any]:
    """A measurement as columns; metrics of a record stand beside its fields."""
    if isinstance(measurement, Record):
        return {**{name: getattr(measurement, name) for name in FIELDS}, **measurement.metrics}
    return dict(measurement)


def frame_of(measurements: Iterable[Measurement]) -> pd.DataFrame:
    """One row a measurement; a value within a value is the column "OUTER INNER"."""
    return pd.json_normalize([row_of(one) for one in measurements], sep=" ")


def with_gains(frame: pd.DataFrame, baseline: Mapping[str, str], keys: Sequence[str]) -> pd.DataFrame:
    """The frame with a column "gain METRIC" for every column of numbers: the row's value less its baseline's.

    Args:
        frame: rows.
        baseline: values of columns that single out the rows that gains are over.
        keys: columns by which a row finds its baseline, for instance run and view.
    """
    chosen = (frame[list(baseline)] == pd.Series(baseline)).all(axis=1)
    numbers = [name for name in frame.select_dtypes("number") if name not in keys]
    before = frame.loc[chosen, [*keys, *numbers]].set_index(list(keys))
    matched = before.reindex(pd.MultiIndex.from_frame(frame[list(keys)]) if len(keys) > 1 else frame[keys[0]])
    gains = {f"gain {name}": frame[name].to_numpy() - matched[name].to_numpy() for name in numbers}
    return frame.assign(**gains)


@dataclass(frozen=True)
class RowFile:
    """The file of a study's measurements.

    Args:
        path: the file.
        keys: columns that say what was measured; measuring it again replaces its rows.
        columns: further ones that it must have.
        option: of the job, by which it measures.
    """

    path: Path
    keys: tuple[str, ...]
    columns: tuple[str, ...] = ()
    option: str = "runs"

    def read(self) -> pd.DataFrame:
        """All rows.

        Raises:
            InputError: there is no file, it holds something else, or a record was damaged.
        """
        frame = frame_of(row for _, row in self._lines())
        lacking = set() if frame.empty else {*self.keys, *self.columns} - set(frame.columns)
        if lacking:
            raise InputError(self.path, f"lacks the column {sorted(lacking)[0]}", self._remedy)
        return frame

    def held(self) -> pd.DataFrame:
        """All rows; none where there is no file.

        Raises:
            InputError: the file holds something else.
        """
        return self.read() if self.path.exists() else pd.DataFrame(columns=[*self.keys, *self.columns])

    def add(self, measurements: Iterable[Measurement]) -> None:
        """Add measurements in place of those with the same keys; other lines stay as they are.

        Raises:
            InputError: the file holds something else, or cannot be written.
        """
        self.add_lines(list(map(line_of, measurements)))

    def add_lines(self, lines: Sequence[str]) -> None:
        """Add lines of measurements, as `line_of` gives them, in place of those with the same keys.

        Raises:
            InputError: a line or the file is something else, or the file cannot be written.
        """
        self.held()
        fresh = {self._key(self._row("measured now", line)) for line in lines}
        held = self._lines() if self.path.exists() else []
        stay = [line for line, row in held if self._key(row) not in fresh]
        if lines:
            write_text(self.path, "".join(f"{line}\n" for line in [*stay, *lines]))

    def _key(self, row: Mapping[str, Any]) -> tuple[Any, ...]:
        return tuple(row[name] for name in self.keys)

    def _lines(self) -> list[tuple[str, dict[str, Any]]]:
        """Every line with its row."""
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


def stated(measurement: Measurement) -> Measurement:
    """A measurement with where and when it was made; records state it by themselves."""
    return measurement if isinstance(measurement, Record) else {**measurement, **provenance(timed=True)}


def line_of(measurement: Measurement) -> str:
    """A measurement as one line of JSON, without its end."""
    if isinstance(measurement, Record):
        return record_line(measurement).rstrip("\n")
    return json.dumps(_plain(measurement), ensure_ascii=False, allow_nan=False)


def _plain(value: Any) -> Any:
    """JSON has no number that is not finite: what was not measured is null."""
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    return None if isinstance(value, float) and not math.isfinite(value) else value
