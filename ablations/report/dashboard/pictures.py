"""Copies pictures beside the page: a few views of every scene before and after enhancement, in original resolution."""

import hashlib
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from PIL import Image

from ablations.report.dashboard.folder import TableRecords
from gaussian_enhancer.files import atomic_write
from gaussian_enhancer.metrics.records import Record
from gaussian_enhancer.scene.renders import run_steps

LARGEST_COPY = 1_500_000
"""Largest size in bytes of a picture that is copied unchanged; larger ones become JPEGs of quality 92."""

PARTS = {"render": "renders", "photo": "gt"}
"""Folders of an enhanced run beside that of its enhanced images, by name of the image in `ShownView.files`."""


@dataclass
class ShownView:
    """One view of one scene.

    Args:
        scene: as in the records.
        splat: as in the records.
        view: file name of the view.
        files: addresses relative to the page, by "render", "photo" and method.
        methods: title by method.
        size: width and height in pixels.
    """

    scene: str
    splat: str
    view: str
    files: dict[str, str] = field(default_factory=dict)
    methods: dict[str, str] = field(default_factory=dict)
    size: tuple[int, int] = (0, 0)


@dataclass(frozen=True)
class ShownImages:
    """The pictures of the page, and the reasons of missing ones.

    Args:
        shown: views with files.
        missing: reason by a text of scene, splat and method.
    """

    shown: tuple[ShownView, ...] = ()
    missing: Mapping[str, str] = field(default_factory=dict)

    def packed(self) -> dict[str, Any]:
        """As plain values."""
        return {"pictures": [vars(view) for view in self.shown], "pictures_missing": dict(self.missing)}


def copy_pictures(tables: Sequence[TableRecords], runs: Path, output: Path, count: int = 2) -> ShownImages:
    """Copy a few views of every scene and splat from the enhanced runs that records name.

    Of a method with several seeds, the first seed is shown. Views are spread evenly over the measured ones.

    Args:
        tables: tables and their records.
        runs: folder of the runs.
        output: folder of the page; files are written to its subfolder ``images``, named by the hash of their content.
        count: largest number of views per scene, splat and method.

    Raises:
        InputError: the folder cannot be written.
    """
    chosen = _choose_records(tables, count)
    views: dict[tuple[str, str, str], ShownView] = {}
    missing: dict[str, str] = {}
    for (scene, splat, method), (title, records) in chosen.items():
        label = f"{scene} · {splat} · {title}"
        name = records[0].sources.get("enhance")
        if name is None:
            missing[label] = "its records name no enhanced run"
            continue
        folder = runs / "enhance" / name
        steps = run_steps(folder)
        if not steps:
            missing[label] = f"the enhanced run {name} is not on this machine"
            continue
        for record in records:
            shown_view = views.setdefault((scene, splat, record.view), ShownView(scene, splat, record.view))
            missing_file = _copy_view(shown_view, method, title, folder / f"test/ours_{steps[-1]}", record.view, output)
            if missing_file:
                missing[f"{label} · {record.view}"] = missing_file
    complete = tuple(
        shown_view for shown_view in views.values() if "render" in shown_view.files and len(shown_view.files) > 1
    )
    return ShownImages(complete, missing)


def _choose_records(tables: Sequence[TableRecords], count: int) -> dict[tuple[str, str, str], tuple[str, list[Record]]]:
    """Title and records to show, by scene, splat and method; a method in two tables with the same run is shown once."""
    shown_records: dict[tuple[str, str, str], tuple[str, list[Record]]] = {}
    for table_listing in tables:
        members: dict[tuple[str, str, str], list[Record]] = {}
        for record in table_listing.records:
            method = table_listing.table.methods.get(record.variant)
            has_weights = method is not None and bool(method.train or method.weights)
            if record.kind == "quality" and record.view and has_weights:
                members.setdefault((record.scene, record.splat, record.variant), []).append(record)
        for (scene, splat, method_name), records in members.items():
            first_seed = min(records, key=lambda record: -1 if record.seed is None else record.seed).seed
            seed_records = sorted((r for r in records if r.seed == first_seed), key=lambda record: record.view)
            title = table_listing.table.methods[method_name].title
            key = (scene, splat, method_name)
            if key in shown_records and shown_records[key][1][0].sources.get("enhance") != seed_records[0].sources.get(
                "enhance"
            ):
                key = (scene, splat, f"{table_listing.table.name}/{method_name}")
                title = f"{title} ({table_listing.table.name})"
            shown_records.setdefault(key, (title, _pick_evenly(seed_records, count)))
    return shown_records


def _pick_evenly(records: Sequence[Record], count: int) -> list[Record]:
    if len(records) <= count:
        return list(records)
    return [records[round((2 * i + 1) * (len(records) - 1) / (2 * count))] for i in range(count)]


def _copy_view(view: ShownView, method: str, title: str, step_folder: Path, name: str, output: Path) -> str:
    """Copy a view's files; returns which file is missing, or an empty text."""
    sources = {key: step_folder / subfolder / name for key, subfolder in PARTS.items() if key not in view.files}
    sources[method] = step_folder / "enhanced" / name
    for key, source in sources.items():
        if not source.is_file():
            if key != "photo":
                return f"{source.parent.name}/{name} is not in the enhanced run"
            continue
        file, size = _copy_picture(source, output)
        if key == method:
            view.methods[method] = title
        view.files[key] = file
        view.size = size if key == "render" else view.size
    return ""


def _copy_picture(source: Path, output: Path) -> tuple[str, tuple[int, int]]:
    """Copy a picture beside the page unless it exists there; returns its address and its size in pixels."""
    content = source.read_bytes()
    name = hashlib.sha256(content).hexdigest()[:20]
    with Image.open(source) as picture:
        size = picture.size
        large = len(content) > LARGEST_COPY
        target = output / "images" / f"{name}{'.jpg' if large else source.suffix.lower()}"
        if not target.is_file():
            with atomic_write(target) as temporary:
                if large:
                    picture.convert("RGB").save(temporary, "JPEG", quality=92)
                else:
                    shutil.copyfile(source, temporary)
    return f"images/{target.name}", size
