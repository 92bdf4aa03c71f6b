"""The description of a table of the suite: methods, columns, scenes, seeds, metrics and the paper's values.

A table's records lie beside its description, and every report is made from these two alone:
``<folder>/<name>.json`` (`write_description`) and ``<folder>/<name>.jsonl`` (`metrics.records`). In the records
``scene`` is one of the dataset's scenes, ``splat`` the splatting method, ``variant`` the method, ``seed`` the seed of
the method's training. A method that could not be made in a scene has one record of kind ``metrics.records.MISSING``
with ``reasons["row"]``.
"""

import dataclasses
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import write_text
from gaussian_enhancer.metrics.records import HIGHER_IS_BETTER

Kind = Literal["quality", "repeats", "cost", "images"]
"""Means of a metric; statistics of repeated runs; time and memory; a grid of images."""
Mode = Literal["", "paper", "ours"]
FAITHFUL = "paper_"
"""Prefix of the names of rows that reproduce the paper's own system."""


@dataclass(frozen=True)
class MethodDescription:
    """One method of a table.

    Args:
        title: name in the printed table.
        about: what it is and why the comparison is fair.
        train: overrides of the job train that makes its weights.
        weights: shipped name or file of its weights, in place of a training.
        enhance: overrides of the job enhance.
        upscale: whether its images are upsampled bicubically at the end.
        render: whether the splat is rendered at 4 times the resolution first.
        role: "other" or "ours", for aims; empty for the baseline.
        mode: "paper" for our reading of the paper's system, "ours" for the same parts by our networks, or "".
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
    """The scenes that a scale measures for one of the paper's datasets: its own scenes or a stand-in.

    Args:
        title: the dataset's name in the paper.
        scenes: their names in the records.
        stand_in: description of the stand-in; empty if the scenes are the dataset's own.
    """

    title: str
    scenes: tuple[str, ...]
    stand_in: str = ""


@dataclass(frozen=True)
class TableDescription:
    """One table, figure or study.

    Args:
        name: name of its file: "table_2", "figure_5", "gates".
        title: its caption.
        kind: what its cells hold.
        about: what it shows and how it is made fair.
        methods: by the name that records state as ``variant``.
        baseline: the method that gains are computed against.
        metrics: of `HIGHER_IS_BETTER`, in the paper's order of columns.
        splats: splatting methods, one block of the table each.
        datasets: by key ("mip_nerf_360", ...), as the scale has them.
        seeds: seeds of the trainings of every trained method.
        paper: the paper's values by splat (by dataset if the kind is "repeats", by size if it is "cost"), then by
            method (or statistic), in the order of ``metrics``; None for a method without values in the paper. Empty
            for studies of our own.
        finer: whether methods are measured against photos of 4 times the resolution.
        scale: "smoke", "desk" or "paper".
        artefacts: for a grid of images, the types of artefacts that it shows, one per row of the grid; if empty, the
            region of the largest error is shown.
    """

    name: str
    title: str
    kind: Kind
    about: str
    methods: Mapping[str, MethodDescription]
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
    """Write a table's description as JSON, atomically.

    Raises:
        InputError: the file cannot be written.
    """
    write_text(path, json.dumps(dataclasses.asdict(table), indent=1, ensure_ascii=False) + "\n")


def read_description(path: str | Path) -> TableDescription:
    """Read a description that `write_description` wrote.

    Raises:
        InputError: the file is missing, or is not a description of a table.
    """
    try:
        values = json.loads(Path(path).read_text(encoding="utf-8"), object_hook=_tuples)
        methods = {name: MethodDescription(**method) for name, method in values["methods"].items()}
        datasets = {name: SceneGroup(**dataset) for name, dataset in values["datasets"].items()}
        return TableDescription(**{**values, "methods": methods, "datasets": datasets})
    except FileNotFoundError:
        raise InputError(path, "does not exist", "make the table first: gaussian-enhancer tables") from None
    except (OSError, ValueError, TypeError, KeyError, AttributeError) as error:
        raise InputError(path, f"describes no table ({error})", "make the table again") from None


def _tuples(values: dict[str, Any]) -> dict[str, Any]:
    """The values with lists converted to tuples."""
    return {name: tuple(value) if isinstance(value, list) else value for name, value in values.items()}
