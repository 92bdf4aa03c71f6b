"""Loading of a measured run for the report: images, numbers and their provenance."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import write_text
from gaussian_enhancer.input_files import read_configuration
from gaussian_enhancer.metrics.records import Record, read_records
from gaussian_enhancer.report.collect import compared_views, provenance_of
from gaussian_enhancer.report.compared import ComparedView
from gaussian_enhancer.report.figures import contact_sheet
from gaussian_enhancer.report.page import document
from gaussian_enhancer.runs.status import DONE
from gaussian_enhancer.scene.photos import background_colour
from gaussian_enhancer.scene.renders import run_steps


@dataclass(frozen=True)
class MeasuredRun:
    """A finished run of the job ``measure`` and its measurements.

    Args:
        views: renders, enhanced renders, photos and measured values.
        records: the records of these values, including costs.
        config: configuration of the job ``measure``.
        folder: folder of the run.
    """

    views: tuple[ComparedView, ...]
    records: tuple[Record, ...]
    config: Mapping[str, Any]
    folder: Path


def write_page(path: Path, measured: MeasuredRun, *, title: str | None = None, most_pictured: int = 60) -> None:
    """Write the page of a measured run, atomically.

    Args:
        path: the HTML file.
        measured: the run to show.
        title: title of the page; None uses scene and splat of the records.
        most_pictured: maximum number of views shown with pictures.

    Raises:
        InputError: see `document`, or the file cannot be written.
    """
    quality = [record for record in measured.records if record.kind == "quality"]
    default_title = f"{quality[0].scene} · {quality[0].splat}" if quality else measured.folder.name
    run = str(measured.config.get("run") or "")
    sources = {"Measurement": str(measured.folder), "Run": run, "Weights": _weights_of(measured.config)}
    provenance = provenance_of(quality, sources)
    write_text(path, document(title or default_title, measured.views, provenance, most_pictured=most_pictured))


def open_measured(folder: str | Path) -> MeasuredRun:
    """Read the folder of a job ``measure`` and find the images that it measured.

    Raises:
        InputError: the job is not finished, measured only one variant, or its images no longer exist.
    """
    root = Path(folder)
    if not (root / DONE).is_file():
        raise InputError(root, "is no finished measure job", "run: gaussian-enhancer measure run=FOLDER")
    records = read_records(root / "records.jsonl")
    if {record.variant for record in records} != {"raw", "enhanced"}:
        variants = ", ".join(sorted({record.variant for record in records})) or "nothing"
        remedy = "measure a run with renders and enhanced renders, or give raw= as well"
        raise InputError(root, f"holds measurements of {variants}, not of raw and enhanced", remedy)
    config = read_configuration(root / "config.yaml")
    renders, enhanced, photos = _image_folders(root, config)
    costs = _costs(config)
    background = background_colour(config.get("background") or (0, 0, 0))
    views = compared_views(renders, enhanced, photos, (*records, *costs), background)
    return MeasuredRun(views, (*records, *costs), config, root)


def _weights_of(config: Mapping[str, Any]) -> str:
    """The weights that the measured run was enhanced with, from its configuration; empty if unknown."""
    path = Path(config.get("run") or "") / "config.yaml"
    return str(read_configuration(path).get("weights") or "") if config.get("run") and path.is_file() else ""


def write_contact_sheet(path: Path, views: Sequence[ComparedView]) -> None:
    """Write all views as one picture: render, enhanced render and, if all views have one, the photo."""
    images = [view.read() for view in views]
    with_photos = all(image.photo is not None for image in images)
    titles = ["render", "enhanced", *(["photo"] if with_photos else [])]
    rows = [[i.raw, i.enhanced, *([i.photo] if with_photos and i.photo is not None else [])] for i in images]
    contact_sheet(rows, titles, [view.name for view in views]).save(path)


def _image_folders(root: Path, config: Mapping[str, Any]) -> tuple[Path, Path, Path]:
    """Folders of renders, enhanced renders and photos of a measurement."""
    if config.get("run"):
        source = Path(config["run"])
        steps = run_steps(source) if source.is_dir() else ()
        if not steps:
            raise InputError(
                source, f"holds no renders any more (seen from {Path.cwd()})", "measure the run at its current path"
            )
        step = config.get("step")
        step_folder = source / "test" / f"ours_{steps[-1] if step is None else step}"
        return step_folder / "renders", step_folder / "enhanced", step_folder / "gt"
    paths = [config.get(key) for key in ("raw", "images", "photos")]
    if not all(paths):
        raise InputError(root / "config.yaml", "does not name raw, images and photos", "measure again")
    raw, images, photos = (Path(str(value)) for value in paths)
    return raw, images, photos


def _costs(config: Mapping[str, Any]) -> tuple[Record, ...]:
    """Run-time records of the enhanced run; empty if it has no records."""
    path = Path(config.get("run") or "") / "records.jsonl"
    if not config.get("run") or not path.is_file():
        return ()
    return tuple(record for record in read_records(path) if record.kind == "cost" and record.variant == "enhanced")
