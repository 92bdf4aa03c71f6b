"""What a table of the suite is: methods, columns, scenes, seeds, metrics and the paper's own values, as its file says.

A table's records lie beside its description, so that every report is made from these two alone:
``<folder>/<name>.json`` (`write_description`) and ``<folder>/<name>.jsonl`` (`measure.records`). In the records
``scene`` is one of the dataset's scenes, ``splat`` the splatting method, ``variant`` the method, ``seed`` that of the
method's training; a method that could not be made in a scene leaves one record of kind ``measure.study.MISSING`` with
``reasons["row"]``.
"""

import dataclasses
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import whole_file
from gaussian_enhancer.metrics.records import HIGHER_IS_BETTER

Kind = Literal["quality", "repeats", "cost", "images"]
"""Means of a metric; statistics of repeated runs; time and memory; a grid of images."""
Mode = Literal["", "paper", "ours"]
FAITHFUL = "paper_"
"""Beginning of the names of the paper's own rows."""


@dataclass(frozen=True)
class Method:
    """One method of a table.

    Args:
        title: as the table prints it.
        about: what it is and why the comparison is fair.
        train: overrides of the job train that make its weights.
        weights: shipped name or file instead.
        enhance: overrides of the job enhance.
        upscale: enlarged bicubically at the end.
        render: the splat is rendered at 4 times the resolution first.
        role: "other" or "ours", for aims; empty for the baseline.
        mode: "paper" where it is the paper's system to the letter, "ours" where the same parts are ours; else empty.
    """

    title: str
    about: str = ""
    train: tuple[str, ...] = ()
    weights: str = ""
    enhance: tuple[str, ...] = ()
    upscale: bool = False
    render: bool = False
    role: str = "ours"
    mode: Mode = ""


@dataclass(frozen=True)
class SceneGroup:
    """What the scale measures in place of one of the paper's datasets, or the dataset itself.

    Args:
        title: the dataset's name in the paper.
        scenes: their names in the records.
        stand_in: what stands in for it, in words; empty where it is the dataset itself.
    """

    title: str
    scenes: tuple[str, ...]
    stand_in: str = ""


@dataclass(frozen=True)
class TableDescription:
    """One table, figure or study.

    Args:
        name: its file's name: "table_2", "figure_5", "gates".
        title: its caption.
        kind: what its cells hold.
        about: what it shows and how it is made fair.
        methods: by the name that records carry as ``variant``.
        baseline: the method that gains are taken over.
        metrics: of `HIGHER_IS_BETTER`, in the paper's order of columns.
        splats: splatting methods, one block of the table each.
        datasets: by key ("mip_nerf_360", ...), as the scale has them.
        seeds: trainings of every method that learns.
        paper: the paper's values by splat (by dataset where the kind is "repeats", by size where it is "cost"), then
            by method (or statistic), in the order of ``metrics``; empty for studies of our own; None where it has none.
        finer: measured against photos 4 times as fine.
        scale: "smoke", "desk" or "paper".
        artefacts: of a grid of images, the types of artefacts that it shows, one a line; the largest error where empty.
    """

    name: str
    title: str
    kind: Kind
    about: str
    methods: Mapping[str, Method]
    baseline: str
    metrics: tuple[str, ...]
    splats: tuple[str, ...]
    datasets: Mapping[str, SceneGroup]
    seeds: tuple[int, ...] = (0,)
    paper: Mapping[str, Mapping[str, tuple[float, ...] | None]] = field(default_factory=dict)
    finer: bool = False
    scale: str = ""
    artefacts: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        unknown = [name for name in self.metrics if name not in HIGHER_IS_BETTER]
        if unknown:
            raise ValueError(f"metric {unknown[0]!r} is none of {', '.join(HIGHER_IS_BETTER)}")
        if self.kind not in get_args(Kind):
            raise ValueError(f"kind {self.kind!r} is none of {', '.join(get_args(Kind))}")
        if self.baseline not in self.methods:
            raise ValueError(f"baseline {self.baseline!r} is none of {', '.join(self.methods)}")


def write_description(path: str | Path, table: TableDescription) -> None:
    """Write a table's description as JSON, whole or not at all.

    Raises:
        InputError: the file cannot be written.
    """
    with whole_file(path) as temporary:
        temporary.write_text(json.dumps(dataclasses.asdict(table), indent=1, ensure_ascii=False) + "\n", "utf-8")


def read_description(path: str | Path) -> TableDescription:
    """Read what `write_description` wrote.

    Raises:
        InputError: the file is missing, or describes no table.
    """
    try:
        return table_of(json.loads(Path(path).read_text(encoding="utf-8")))
    except FileNotFoundError:
        raise InputError(path, "does not exist", "make the table first: gaussian-enhancer tables") from None
    except (OSError, ValueError, TypeError, KeyError, AttributeError) as error:
        raise InputError(path, f"describes no table ({error})", "make the table again") from None


def table_of(values: Mapping[str, Any]) -> TableDescription:
    """A table from plain values.

    Raises:
        TypeError: a field is missing or unknown.
        ValueError: a value is out of range.
    """
    methods = {str(name): Method(**_tuples(method)) for name, method in values["methods"].items()}
    datasets = {str(name): SceneGroup(**_tuples(dataset)) for name, dataset in values["datasets"].items()}
    paper = {
        str(block): {
            str(method): None if cells is None else tuple(map(float, cells)) for method, cells in rows_.items()
        }
        for block, rows_ in values.get("paper", {}).items()
    }
    return TableDescription(**_tuples({**values, "methods": methods, "datasets": datasets, "paper": paper}))


def _tuples(values: Mapping[str, Any]) -> dict[str, Any]:
    """Lists as tuples."""
    return {str(name): tuple(value) if isinstance(value, list) else value for name, value in values.items()}
