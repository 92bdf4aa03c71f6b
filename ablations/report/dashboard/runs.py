"""The runs that records come from: their settings and what their trainings logged, as far as they lie here."""

import csv
import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ablations.report.dashboard.packed import NumberedValues
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.metrics.records import Record

MOST_POINTS = 1000
"""Points of a curve on the page; a longer one is thinned evenly, and the page says so."""


@dataclass(frozen=True)
class Curve:
    """One logged quantity of a training.

    Args:
        name: the log's column.
        steps: optimiser steps.
        values: its values there.
        logged: number of values in the log.
    """

    name: str
    steps: tuple[float, ...]
    values: tuple[float, ...]
    logged: int


@dataclass(frozen=True)
class SourceRun:
    """A run that records name.

    Args:
        job: the job that made it.
        name: its folder's name.
        settings: its resolved configuration, one entry a value, by dotted path, as JSON.
        curves: what it logged.
        absent: why settings or curves are not there, by "settings" and "curves".
    """

    job: str
    name: str
    settings: Mapping[str, str] = field(default_factory=dict)
    curves: tuple[Curve, ...] = ()
    absent: Mapping[str, str] = field(default_factory=dict)


def source_runs(
    runs: Path, records: Iterable[Record], configuration: Callable[[Path], Mapping[str, Any]]
) -> tuple[SourceRun, ...]:
    """Every run that a record names, in the order of job and name.

    Args:
        runs: folder that holds the runs, ``<job>/<name>``.
        records: the records.
        configuration: reads a run's ``config.yaml``.

    Raises:
        InputError: a configuration or a log that is there cannot be read.
    """
    named = sorted({(job, name) for record in records for job, name in record.sources.items()})
    return tuple(_read(runs / job / name, job, name, configuration) for job, name in named)


def flat(values: Mapping[str, Any], prefix: str = "") -> dict[str, str]:
    """A nested configuration by dotted path; a list of plain values is one value.

    Args:
        values: the configuration.
        prefix: path of ``values`` with its dot.
    """
    found: dict[str, str] = {}
    for key, value in values.items():
        if isinstance(value, list) and any(isinstance(item, dict | list) for item in value):
            value = {str(index): item for index, item in enumerate(value)}
        if isinstance(value, Mapping) and value:
            found |= flat(value, f"{prefix}{key}.")
        else:
            found[f"{prefix}{key}"] = json.dumps(value, ensure_ascii=False, default=str)
    return found


def read_curves(path: Path) -> tuple[Curve, ...]:
    """The columns of a CSV log over its column ``step``; rows without a value, and values not finite, have no point.

    Args:
        path: ``metrics.csv`` as the CSV logger writes it.

    Raises:
        InputError: it cannot be read, or holds what is no number.
    """
    try:
        with path.open(newline="", encoding="utf-8") as file:
            return _curves(list(csv.DictReader(file)))
    except (OSError, ValueError, csv.Error) as error:
        raise InputError(path, f"is no log of numbers ({error})", "delete it, or train again") from error


def _curves(rows: Sequence[Mapping[str, str]]) -> tuple[Curve, ...]:
    names = [name for name in (rows[0] if rows else ()) if name not in ("step", "epoch")]
    curves = []
    for name in names:
        points = [(float(row["step"]), float(row[name])) for row in rows if row.get(name) and row.get("step")]
        finite = sorted(point for point in points if math.isfinite(point[1]))
        if finite:
            kept = _thinned(finite)
            curves.append(Curve(name, tuple(x for x, _ in kept), tuple(y for _, y in kept), len(finite)))
    return tuple(curves)


def packed_runs(runs: Sequence[SourceRun]) -> dict[str, Any]:
    """Runs as plain values: paths and values of settings numbered, since most runs share most of them."""
    keys, values = NumberedValues(), NumberedValues()
    packed = [
        {
            "job": run.job,
            "name": run.name,
            "settings": [[keys.number(key), values.number(value)] for key, value in run.settings.items()],
            "curves": {c.name: {"x": c.steps, "y": c.values, "logged": c.logged} for c in run.curves},
            "absent": dict(run.absent),
        }
        for run in runs
    ]
    return {"runs": packed, "keys": keys.values, "settings": values.values}


def _read(folder: Path, job: str, name: str, configuration: Callable[[Path], Mapping[str, Any]]) -> SourceRun:
    absent: dict[str, str] = {}
    settings: dict[str, str] = {}
    curves: tuple[Curve, ...] = ()
    where = "the run is not on this machine" if not folder.is_dir() else "the run kept none"
    if (folder / "config.yaml").is_file():
        settings = flat(configuration(folder / "config.yaml"))
    else:
        absent["settings"] = where
    log = folder / "log" / "metrics.csv"
    if log.is_file():
        curves = read_curves(log)
    if job.startswith("train") and not curves:
        absent["curves"] = "its log holds no value" if log.is_file() else where
    return SourceRun(job, name, settings, curves, absent)


def _thinned(points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    if len(points) <= MOST_POINTS:
        return list(points)
    return [points[round(i * (len(points) - 1) / (MOST_POINTS - 1))] for i in range(MOST_POINTS)]
