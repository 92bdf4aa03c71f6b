"""Reads the descriptions of tables, figures and studies in ``ablations/`` and resolves them at a scale.

A study states what is compared: methods, metrics, splats, the paper's datasets. A scale (``conf/scale``) states the
data and budget: the stand-in for each dataset, the fits that trainings learn from, the number of steps, the seeds.
"""

import functools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from ablations.study.description import FAITHFUL, MethodDescription, SceneGroup, TableDescription
from ablations.suite.evaluation import StudyCell
from gaussian_enhancer.errors import InputError, refuse_unknown
from gaussian_enhancer.runs.instantiate import plain_values

FOLDER = Path(__file__).resolve().parents[1]
"""The folder of tables and studies."""

USUAL = "usual"
"""The training of a method that names none, among those that a scale describes."""

SHORT = {"lpips": "lpips_vgg_raw", "ms": "milliseconds", "gb": "peak_memory_mb"}
"""Our metric by the name in the paper's tables, where it differs; the paper's LPIPS is that of 3DGS."""


@dataclass(frozen=True)
class Experiment:
    """A table's description, with its cells and trainings at a scale.

    Args:
        table: its description.
        cells: scenes and splats that it is measured in.
        learns: name of the scale's training, by method.
    """

    table: TableDescription
    cells: tuple[StudyCell, ...]
    learns: Mapping[str, str]

    def seeds(self, method: str) -> tuple[int | None, ...]:
        """The seeds of a method; (None,) for a method without training."""
        return self.table.seeds if self.table.methods[method].train else (None,)


def known_names() -> dict[str, tuple[str, ...]]:
    """The names of all tables and figures, and of all studies."""

    def order(path: Path) -> tuple[str, int]:
        kind, _, number = path.stem.rpartition("_")
        return ("" if kind == "table" else kind, int(number))

    tables = sorted((FOLDER / "tables").glob("*.yaml"), key=order)
    studies = sorted((FOLDER / "studies").glob("*.yaml"))
    return {"all": tuple(path.stem for path in tables), "studies": tuple(path.stem for path in studies)}


def requested_names(choice: Any) -> tuple[str, ...]:
    """Resolve a user's choice to names of tables and studies, in its order, each once.

    Args:
        choice: a number, a name, "all" (tables and figures), "studies", or a list of these.

    Raises:
        InputError: a name is unknown, or the choice is empty.
    """
    groups = known_names()
    names: dict[str, None] = {}
    for item in choice if isinstance(choice, Sequence) and not isinstance(choice, str) else [choice]:
        name = f"table_{item}" if str(item).isdigit() else str(item)
        resolved = groups.get(name, (name,) if name in (*groups["all"], *groups["studies"]) else ())
        if not resolved:
            known_list = ", ".join((*groups, *groups["all"], *groups["studies"]))
            raise InputError(f"table {item!r}", "is unknown", f"choose a number, or of: {known_list}")
        names |= dict.fromkeys(resolved)
    if not names:
        raise InputError("table", "is empty", "choose a number, a name, a list of them, or all")
    return tuple(names)


def read_experiment(name: str, scale: DictConfig) -> Experiment:
    """Read a table or study and resolve it at a scale.

    Args:
        name: of the file.
        scale: one of ``conf/scale``.

    Raises:
        InputError: the file or the scale lacks a value, or has an invalid one.
    """
    path = next(iter(FOLDER.glob(f"*/{name}.yaml")))
    try:
        study = plain_values(OmegaConf.load(path))  # type: ignore[arg-type]
        rows = method_rows(study)
        learns = {method: str(values.pop("learns", USUAL)) for method, values in rows.items()}
        common = tuple(study.get("train", ()))
        methods = {
            method: _method(values, scale.trainings[learns[method]].train, common) for method, values in rows.items()
        }
        cost = study["kind"] == "cost"
        table = TableDescription(
            name,
            str(study["title"]),
            study["kind"],
            str(study["about"]).strip(),
            methods,
            str(study["baseline"]),
            tuple(study["metrics"]),
            tuple(study["splats"]),
            _outputs(scale) if cost else _datasets(study, scale),
            tuple(scale.seeds) if study.get("repeated") else tuple(scale.seeds[:1]),
            paper_values(study),
            bool(study.get("finer")),
            str(scale.name),
            tuple(map(str, study.get("artefacts", ()))),
        )
        cells = () if cost else tuple(_cells(table, scale))
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            path, f"is no study at scale {scale.name} ({error})", "compare it with its neighbours"
        ) from error
    return Experiment(table, cells, learns)


def method_rows(study: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """The methods of a study: a mapping of its own, or a list of names of ``ablations/methods.yaml``.

    Raises:
        InputError: a name is unknown.
    """
    methods = study["methods"]
    if isinstance(methods, Mapping):
        return {str(method): values for method, values in methods.items()}
    shared = plain_values(OmegaConf.load(FOLDER / "methods.yaml"))  # type: ignore[arg-type]
    refuse_unknown("methods", methods, shared)
    return {method: shared[method] for method in methods}


def paper_values(study: Mapping[str, Any]) -> dict[str, dict[str, tuple[float, ...] | None]]:
    """The paper's values of a study as in `TableDescription.paper`: by block, then method, in the order of metrics.

    Gigabytes are converted to the megabytes of records. If a study has a faithful row of a method, the values are its.

    Raises:
        InputError: the paper has no such table, or its columns are not the study's metrics.
    """
    name = study.get("paper")
    if name is None:
        return {}
    tables = _papers_tables(FOLDER / "paper.yaml")
    if name not in tables:
        raise InputError(f"paper: {name}", "is none of the paper's tables", f"choose {', '.join(tables)}")
    values = dict(tables[name])
    method_names = {str(method) for method in study["methods"]}

    def named(method: str) -> str:
        return f"{FAITHFUL}{method}" if f"{FAITHFUL}{method}" in method_names else method

    columns = [SHORT.get(column, column) for column in values.pop("columns")]
    if columns != list(study["metrics"])[: len(columns)]:
        raise InputError(f"paper: {name}", f"has the columns {', '.join(columns)}", "put these first in metrics")
    factors = [1000.0 if column == "peak_memory_mb" else 1.0 for column in columns]

    def scaled(cells: Sequence[float | int] | None) -> tuple[float, ...] | None:
        return None if cells is None else tuple(round(v * f, 6) for v, f in zip(cells, factors, strict=True))

    if study["kind"] == "cost":  # printed row by row
        sizes = dict.fromkeys(size for cells in values.values() for size in cells)
        return {size: {named(method): scaled(cells[size]) for method, cells in values.items()} for size in sizes}
    if not isinstance(next(iter(values.values())), Mapping):  # printed for one splat alone
        values = {study["splats"][0]: values}
    return {
        block: {named(method): scaled(cells) for method, cells in methods.items()} for block, methods in values.items()
    }


@functools.cache
def _papers_tables(path: Path) -> dict[str, Any]:
    return plain_values(OmegaConf.load(path))  # type: ignore[arg-type]


def _method(values: Mapping[str, Any], recipe: Sequence[str], common: Sequence[str]) -> MethodDescription:
    """A method. Its training overrides are the scale's, those common to the study's methods, and its own.

    A method without training overrides of its own is not trained.
    """
    method_overrides = tuple(values.get("train", ()))
    train = (*recipe, *common, *method_overrides) if method_overrides else ()
    return MethodDescription(**{**values, "train": train, "enhance": tuple(values.get("enhance", ()))})


def _datasets(study: Mapping[str, Any], scale: DictConfig) -> dict[str, SceneGroup]:
    """The study's datasets as the scale has them. Of a dataset without stand-in, only the study's scenes are kept.

    If none of the study's scenes is available, or it names none, all scenes of the dataset are kept.
    """
    datasets = {}
    for key in study["datasets"]:
        values = scale.datasets[key]
        stand_in, scenes = str(values.get("stand_in") or ""), tuple(map(str, values.scenes))
        requested = tuple(name for name in study.get("scenes", ()) if name in scenes)
        datasets[str(key)] = SceneGroup(
            str(values.title), requested if requested and not stand_in else scenes, stand_in
        )
    return datasets


def _outputs(scale: DictConfig) -> dict[str, SceneGroup]:
    """The sizes of the enhanced image, each as one dataset."""
    return {
        str(key): SceneGroup(str(key).upper(), (str(key),), f"an image of {width}x{height} pixels")
        for key, (height, width) in scale.outputs.items()
    }


def _cells(table: TableDescription, scale: DictConfig) -> Iterator[StudyCell]:
    """One cell for every scene of every dataset and every splat."""
    density, every = (scale.finer.fit, scale.finer.every) if table.finer else (scale.sparse, scale.every)
    for splat in table.splats:
        for key, dataset in table.datasets.items():
            for scene in dataset.scenes:
                scene_overrides = scale.datasets[key].scenes[scene]
                fit = (*scene_overrides, f"splat={splat}", *scale.fit, *density)
                yield StudyCell(scene, splat, tuple(map(str, fit)), int(every), table.finer)
