"""``gaussian-enhancer download``: a published dataset, or the scenes of it that are asked for, ready to be measured on.

Archives go to ``folder/archives``, scenes to ``folder/DATASET/SCENE``. What is there is not fetched again.
"""

import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from omegaconf import DictConfig
from rich.console import Console
from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TimeRemainingColumn, TransferSpeedColumn

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.runs.instantiate import plain, require
from gaussian_enhancer.scene.checksum import check_archive
from gaussian_enhancer.scene.datasets import Archive, Dataset, DatasetScene, dataset_of
from gaussian_enhancer.scene.extract import Parts, unpack
from gaussian_enhancer.scene.fetch import Patience, fetch


@dataclass(frozen=True)
class Wanted:
    """One scene that is asked for.

    Args:
        scene: where it lies in which archive.
        parts: what to take of it.
        folder: where it goes.
    """

    scene: DatasetScene
    parts: Parts
    folder: Path

    @property
    def absent(self) -> tuple[str, ...]:
        """Names of the parts that are not there."""
        return tuple(name for name in self.parts.names if not (self.folder / name).exists())


def run(cfg: DictConfig) -> None:
    """Fetch, check and unpack; or, with ``dry_run``, list what that would be.

    Args:
        cfg: see ``conf/download.yaml``.

    Raises:
        InputError: an unknown scene, an address that is refused, a wrong checksum, a full disk.
    """
    require(cfg)
    dataset = dataset_of(plain(cfg.dataset))
    folder = Path(cfg.folder).expanduser()
    wanted = wanted_scenes(dataset, folder, _names(cfg, "scenes"), _names(cfg, "images"))
    for line in listing(dataset, folder, wanted):
        print(line)
    if cfg.dry_run:
        return
    console = Console(stderr=True)
    with _progress(console, bool(cfg.runtime.progress)) as progress:
        for archive in _archives(dataset, wanted):
            _fetched(cfg, dataset, archive, folder / "archives" / archive.file, progress)
            for name, scene in wanted.items():
                if dataset.archives[scene.scene.archive] == archive:
                    _unpacked(scene, name, folder / "archives" / archive.file, progress)
            if not cfg.keep_archives:
                (folder / "archives" / archive.file).unlink()
    console.print(f"{dataset.title}: {len(wanted)} scenes in {folder / dataset.name}", highlight=False, soft_wrap=True)


def wanted_scenes(
    dataset: Dataset, folder: Path, scenes: tuple[str, ...] | None, images: tuple[str, ...] | None
) -> Mapping[str, Wanted]:
    """What is asked for, by the scenes' names.

    Args:
        dataset: the dataset.
        folder: of all datasets.
        scenes: names; all where None.
        images: folders of photos; those of the official resolution where None.

    Raises:
        InputError: there is no such scene.
    """
    found = {}
    for name, scene in dataset.chosen(scenes).items():
        names = (*dataset.model, *(images or scene.images))
        found[name] = Wanted(scene, Parts(scene.inside, names, dataset.leave_out), folder / dataset.name / name)
    return found


def listing(dataset: Dataset, folder: Path, wanted: Mapping[str, Wanted]) -> Iterator[str]:
    """Lines that say what would be fetched and what is there."""
    yield f"{dataset.title}, {dataset.page}"
    yield f"  licence: {dataset.licence}"
    yield f"  folder: {folder}, {shutil.disk_usage(_existing(folder)).free / 1e9:.1f} GB free"
    needed = _archives(dataset, wanted)
    for archive in sorted({dataset.archives[entry.scene.archive] for entry in wanted.values()}, key=lambda a: a.file):
        path = folder / "archives" / archive.file
        part = path.with_name(f"{path.name}.part")
        if path.is_file():
            state = f"there ({_size(path.stat().st_size)})"
        elif archive not in needed:
            state = "not needed"
        else:
            begun = f", {_size(part.stat().st_size)} of it there" if part.is_file() else ""
            state = f"to fetch ({_size(archive.bytes)}{begun}) from {archive.url}"
        yield f"  archive {archive.file}: {state}; {_checked(archive)}"
    for name, entry in wanted.items():
        absent = ", ".join(entry.absent)
        there = ", ".join(part for part in entry.parts.names if part not in entry.absent)
        states = [f"{words} {parts}" for words, parts in (("there:", there), ("to unpack:", absent)) if parts]
        yield f"  scene {name}: {'; '.join(states)}"


def _archives(dataset: Dataset, wanted: Mapping[str, Wanted]) -> list[Archive]:
    """The archives of scenes of which something is absent."""
    found = {dataset.archives[entry.scene.archive]: None for entry in wanted.values() if entry.absent}
    return list(found)


def _fetched(cfg: DictConfig, dataset: Dataset, archive: Archive, path: Path, progress: Progress) -> None:
    """Bring an archive to its place, checked."""
    if path.is_file():
        progress.console.print(f"{path}: checking", highlight=False, soft_wrap=True)
        check_archive(archive, path, path)
        return
    task = progress.add_task(archive.file, total=archive.bytes)
    patience = Patience(retries=cfg.retries, timeout=cfg.timeout)
    digest = fetch(
        archive,
        path,
        page=dataset.page,
        patience=patience,
        advance=lambda done, total: progress.update(task, completed=done, total=total),
    )
    progress.console.print(f"{path}: SHA-256 {digest}, {_checked(archive)}", highlight=False, soft_wrap=True)


def _unpacked(entry: Wanted, name: str, archive: Path, progress: Progress) -> None:
    task = progress.add_task(name, total=None, visible=bool(entry.absent))
    unpack(archive, entry.parts, entry.folder, lambda done, total: progress.update(task, completed=done, total=total))


def _progress(console: Console, shown: bool) -> Progress:
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        DownloadColumn(),
        TransferSpeedColumn(),
        TimeRemainingColumn(),
    )
    return Progress(*columns, console=console, disable=not (shown and console.is_terminal))


def _names(cfg: DictConfig, key: str) -> tuple[str, ...] | None:
    """A list of names, or None."""
    value = plain(cfg)[key]
    if value is None:
        return None
    if not isinstance(value, list) or not value or not all(isinstance(entry, str) for entry in value):
        raise InputError(key, f"is {value!r}", f"give a list: {key}=[NAME,NAME]")
    return tuple(value)


def _checked(archive: Archive) -> str:
    kinds = [kind for kind in ("sha256", "md5") if getattr(archive, kind) is not None]
    return f"{kinds[0]} recorded" if kinds else "no checksum published: the first copy's is kept beside it"


def _size(count: int | None) -> str:
    return "size unknown" if count is None else f"{count / 1e9:.2f} GB" if count > 1e7 else f"{count} bytes"


def _existing(folder: Path) -> Path:
    """The nearest folder that exists."""
    return next(parent for parent in (folder.resolve(), *folder.resolve().parents) if parent.is_dir())
