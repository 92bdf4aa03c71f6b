"""Draws the figures of the suite: grids of images, from the runs of their methods."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from ablations.realism.real_crops import KINDS, crops, worst
from ablations.report.grids import PHOTO, Box, write_grid
from ablations.study.description import SceneGroup
from ablations.suite.descriptions import Experiment
from ablations.suite.evaluation import StudyCell
from ablations.suite.method_runs import Runs
from gaussian_enhancer.metrics.records import Record
from gaussian_enhancer.scene.photos import read_photo


def draw_figure(runs: Runs, experiment: Experiment, records: Sequence[Record], folder: Path) -> None:
    """Write the grid of a figure: the first measured view of each scene and splat, or a row for each type of artefact.

    Args:
        runs: the suite's.
        experiment: the figure.
        records: its records; missing images become grey tiles.
        folder: of the file ``NAME.png``.
    """
    pictures: dict[tuple[str, str], Path] = {}
    lines: list[str] = []
    boxes: dict[str, Box] = {}
    for cell in experiment.cells:
        files_by_method = _method_views(runs, experiment, cell, records)
        views = sorted(files_by_method.get(experiment.table.baseline, {}))
        for label, view, box in figure_rows(experiment, f"{cell.scene}, {cell.splat}", files_by_method, views):
            lines.append(label)
            boxes |= {} if box is None else {label: box}
            method_files = {method: files[view] for method, files in files_by_method.items() if view in files}
            pictures |= {(label, key): path for key, path in method_files.items() if path.is_file()}
    if pictures:
        shown = replace(experiment.table, datasets={"all": SceneGroup("", tuple(lines))})
        write_grid(folder / f"{experiment.table.name}.png", shown, pictures, boxes=boxes)


def _method_views(
    runs: Runs, experiment: Experiment, cell: StudyCell, records: Sequence[Record]
) -> dict[str, dict[str, Path]]:
    """Image files of a cell by method and view; the photos under `PHOTO`."""
    files: dict[str, dict[str, Path]] = {}
    for method in experiment.table.methods:
        key = cell.scene, cell.splat, method
        views = [r.view for r in records if (r.scene, r.splat, r.variant) == key and r.view]
        if views:
            images, photos = runs.images(experiment, cell, method, experiment.seeds(method)[0])
            files[method] = {view: images / view for view in views}
            photo_files = {view: next(photos.glob(f"{Path(view).stem}.*"), None) for view in views}
            files.setdefault(PHOTO, {}).update({view: path for view, path in photo_files.items() if path})
    return files


def figure_rows(
    experiment: Experiment, label: str, files: Mapping[str, Mapping[str, Path]], views: Sequence[str]
) -> Iterator[tuple[str, str, Box | None]]:
    """Rows of a cell: label, view, and the crop where it is chosen by a type of artefact."""
    photos = files.get(PHOTO, {})
    photographed = [view for view in views if view in photos]
    if not experiment.table.artefacts or not photographed:
        yield label, min(views, default=""), None
        return
    pairs = [(read_photo(files[experiment.table.baseline][view]), read_photo(photos[view])) for view in photographed]
    height, width = pairs[0][0].shape[-2:]
    size = max(1, height // 3), max(1, width // 3)
    view_crops = crops(pairs, size)
    for name in experiment.table.artefacts:
        crop = worst(view_crops, KINDS[name])
        top, left = crop.place[0] / height, crop.place[1] / width
        yield f"{label}: {name}", photographed[crop.view], (left, top, left + size[1] / width, top + size[0] / height)
