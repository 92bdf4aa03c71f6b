"""Pictures beside the page: a few views of every scene before and after, each file once, at its original size."""

import hashlib
import re
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from PIL import Image

from ablations.report.dashboard.folder import Listed
from gaussian_enhancer.files import whole_file
from gaussian_enhancer.metrics.records import Record

LARGEST_COPY = 1_500_000
"""Bytes up to which a picture is copied as it is; a larger one becomes a JPEG of quality 92."""

PARTS = {"render": "renders", "photo": "gt"}
"""What every enhanced run holds beside its enhanced images."""


@dataclass
class Shown:
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
    """What the page can show, and what it cannot, with reasons.

    Args:
        shown: views with files.
        missing: reason by scene, splat and method in words.
    """

    shown: tuple[Shown, ...] = ()
    missing: Mapping[str, str] = field(default_factory=dict)

    def packed(self) -> dict[str, Any]:
        """As plain values."""
        return {"pictures": [vars(view) for view in self.shown], "pictures_missing": dict(self.missing)}


def copy_pictures(listed: Sequence[Listed], runs: Path, output: Path, most: int = 2) -> ShownImages:
    """Copy a few views of every scene and splat from the enhanced runs that records name.

    Of methods with several seeds the first is shown. Views are spread evenly over those that were measured.

    Args:
        listed: tables and records.
        runs: folder that holds the runs.
        output: folder of the page; files go to ``images`` in it, named by their content.
        most: views of each scene and splat.

    Raises:
        InputError: the folder cannot be written.
    """
    chosen = _chosen(listed, most)
    shown: dict[tuple[str, str, str], Shown] = {}
    missing: dict[str, str] = {}
    for (scene, splat, method), (title, records) in chosen.items():
        place = f"{scene} · {splat} · {title}"
        name = records[0].sources.get("enhance")
        if name is None:
            missing[place] = "its records name no enhanced run"
            continue
        folder = runs / "enhance" / name
        side = _side(folder)
        if side is None:
            missing[place] = f"the enhanced run {name} is not on this machine"
            continue
        for record in records:
            view = shown.setdefault((scene, splat, record.view), Shown(scene, splat, record.view))
            lacking = _add(view, method, title, side, record.view, output)
            if lacking:
                missing[f"{place} · {record.view}"] = lacking
    kept = tuple(view for view in shown.values() if "render" in view.files and len(view.files) > 1)
    return ShownImages(kept, missing)


def _chosen(listed: Sequence[Listed], most: int) -> dict[tuple[str, str, str], tuple[str, list[Record]]]:
    """Title and records to show, by scene, splat and method; methods of the same weights in two tables come once."""
    found: dict[tuple[str, str, str], tuple[str, list[Record]]] = {}
    for one in listed:
        members: dict[tuple[str, str, str], list[Record]] = {}
        for record in one.records:
            method = one.table.methods.get(record.variant)
            learnt = method is not None and bool(method.train or method.weights)
            if record.kind == "quality" and record.view and learnt:
                members.setdefault((record.scene, record.splat, record.variant), []).append(record)
        for (scene, splat, method_name), records in members.items():
            first = min(records, key=lambda record: -1 if record.seed is None else record.seed).seed
            ours = sorted((r for r in records if r.seed == first), key=lambda record: record.view)
            title = one.table.methods[method_name].title
            key = (scene, splat, method_name)
            if key in found and found[key][1][0].sources.get("enhance") != ours[0].sources.get("enhance"):
                key = (scene, splat, f"{one.table.name}/{method_name}")
                title = f"{title} ({one.table.name})"
            found.setdefault(key, (title, _spread(ours, most)))
    return found


def _spread(records: Sequence[Record], most: int) -> list[Record]:
    if len(records) <= most:
        return list(records)
    return [records[round((2 * i + 1) * (len(records) - 1) / (2 * most))] for i in range(most)]


def _side(folder: Path) -> Path | None:
    """The last step's folder of an enhanced run; None where it is not here."""
    steps = [(int(m[1]), p) for p in folder.glob("test/ours_*") if (m := re.fullmatch(r"ours_(\d+)", p.name))]
    return max(steps)[1] if steps else None


def _add(view: Shown, method: str, title: str, side: Path, name: str, output: Path) -> str:
    """Copy a view's files; what it lacks, in words."""
    sources = {what: side / part / name for what, part in PARTS.items() if what not in view.files}
    sources[method] = side / "enhanced" / name
    for what, source in sources.items():
        if not source.is_file():
            if what != "photo":
                return f"{source.parent.name}/{name} is not in the enhanced run"
            continue
        file, size = _copied(source, output)
        if what == method:
            view.methods[method] = title
        view.files[what] = file
        view.size = size if what == "render" else view.size
    return ""


def _copied(source: Path, output: Path) -> tuple[str, tuple[int, int]]:
    """Address and size of a picture beside the page; a file that is there already is not written again."""
    content = source.read_bytes()
    name = hashlib.sha256(content).hexdigest()[:20]
    with Image.open(source) as picture:
        size = picture.size
        large = len(content) > LARGEST_COPY
        target = output / "images" / f"{name}{'.jpg' if large else source.suffix.lower()}"
        if not target.is_file():
            with whole_file(target) as temporary:
                if large:
                    picture.convert("RGB").save(temporary, "JPEG", quality=92)
                else:
                    shutil.copyfile(source, temporary)
    return f"images/{target.name}", size
