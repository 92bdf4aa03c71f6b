"""Reads the runs that records name: their settings and the curves of their trainings, if they are on this machine."""

import csv
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ablations.report.dashboard.packed import NumberedValues
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.input_files import read_configuration
from gaussian_enhancer.metrics.records import Record

MOST_POINTS = 1000
"""Largest number of points of a curve on the page; longer curves are subsampled evenly, and the page says so."""


@dataclass(frozen=True)
class Curve:
    """One logged quantity of a training.

    Args:
        name: column of the log.
        steps: optimiser steps.
        values: its values at these steps.
        logged: number of finite values in the log.
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
        settings: values of its resolved configuration as JSON, by dotted path.
        curves: its logged curves.
        absent: why settings or curves are missing, by "settings" and "curves".
    """

    job: str
    name: str
    settings: Mapping[str, str] = field(default_factory=dict)
    curves: tuple[Curve, ...] = ()
    absent: Mapping[str, str] = field(default_factory=dict)


def source_runs(runs: Path, records: Iterable[Record]) -> tuple[SourceRun, ...]:
    """Every run that a record names, in the order of job and name.

    Args:
        runs: folder of the runs, ``<job>/<name>``.
        records: the records.

    Raises:
        InputError: an existing configuration or log cannot be read.
    """
    named = sorted({(job, name) for record in records for job, name in record.sources.items()})
    return tuple(_read(runs / job / name, job, name) for job, name in named)


def flatten(values: Mapping[str, Any], prefix: str = "") -> dict[str, str]:
    """Flatten a nested configuration to JSON values by dotted path; a list of plain values is one value.

    Args:
        values: the configuration.
        prefix: path of ``values`` with a dot at its end.
    """
    flattened: dict[str, str] = {}
    for key, value in values.items():
        if isinstance(value, list) and any(isinstance(item, dict | list) for item in value):
            value = {str(index): item for index, item in enumerate(value)}
        if isinstance(value, Mapping) and value:
            flattened |= flatten(value, f"{prefix}{key}.")
        else:
            flattened[f"{prefix}{key}"] = json.dumps(value, ensure_ascii=False, default=str)
    return flattened


def read_curves(path: Path) -> tuple[Curve, ...]:
    """Read the columns of a CSV log as curves over its column ``step``; missing and non-finite values are left out.

    Args:
        path: ``metrics.csv`` as the CSV logger writes it.

    Raises:
        InputError: it cannot be read, or contains a value that is not a number.
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
            thinned = _thinned(finite)
            curves.append(Curve(name, tuple(x for x, _ in thinned), tuple(y for _, y in thinned), len(finite)))
    return tuple(curves)


def packed_runs(runs: Sequence[SourceRun]) -> dict[str, Any]:
    """Runs as plain values for the page's script; settings are stored as indices, since runs share most of them."""
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


def _read(folder: Path, job: str, name: str) -> SourceRun:
    absent: dict[str, str] = {}
    settings: dict[str, str] = {}
    curves: tuple[Curve, ...] = ()
    reason = "the run is not on this machine" if not folder.is_dir() else "the run kept none"
    if (folder / "config.yaml").is_file():
        settings = flatten(read_configuration(folder / "config.yaml"))
    else:
        absent["settings"] = reason
    log = folder / "log" / "metrics.csv"
    if log.is_file():
        curves = read_curves(log)
    if job.startswith("train") and not curves:
        absent["curves"] = "its log holds no value" if log.is_file() else reason
    return SourceRun(job, name, settings, curves, absent)


def _thinned(points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    if len(points) <= MOST_POINTS:
        return list(points)
    return [points[round(i * (len(points) - 1) / (MOST_POINTS - 1))] for i in range(MOST_POINTS)]
