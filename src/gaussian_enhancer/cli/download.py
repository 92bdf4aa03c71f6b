"""The job ``download``: fetch a published dataset, or selected scenes of it.

Archives go to ``folder/archives``, scenes to ``folder/DATASET/SCENE``. Existing files are not fetched again.
"""

from pathlib import Path

from omegaconf import DictConfig
from rich.console import Console
from rich.progress import DownloadColumn, Progress, TimeRemainingColumn, TransferSpeedColumn

from gaussian_enhancer.console import hides_progress, print_line, progress_bar
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.runs.instantiate import plain_values, require
from gaussian_enhancer.scene.checksum import check_archive
from gaussian_enhancer.scene.datasets import Archive, Dataset, dataset_of
from gaussian_enhancer.scene.extract import unpack
from gaussian_enhancer.scene.fetch import fetch
from gaussian_enhancer.scene.requested import RequestedScene, checksum_note, listing, needed_archives, requested_scenes


def output_path(cfg: DictConfig) -> Path | None:
    """The folder of archives and scenes; None if they are only listed."""
    return None if cfg.dry_run else Path(cfg.folder).expanduser()


def run(cfg: DictConfig) -> None:
    """Fetch, verify and unpack a dataset; with ``dry_run``, only list what would be fetched.

    Args:
        cfg: see ``conf/download.yaml``.

    Raises:
        InputError: an unknown scene, an address that is refused, a wrong checksum, a full disk.
    """
    require(cfg)
    dataset = dataset_of(plain_values(cfg.dataset))
    folder = Path(cfg.folder).expanduser()
    requests = requested_scenes(dataset, folder, _names(cfg, "scenes"), _names(cfg, "images"))
    for line in listing(dataset, folder, requests):
        print(line)
    if cfg.dry_run:
        return
    console = Console(stderr=True)
    columns = DownloadColumn(), TransferSpeedColumn(), TimeRemainingColumn()
    with progress_bar(*columns, hidden=hides_progress(cfg, console), console=console) as progress:
        for archive in needed_archives(dataset, requests):
            archive_path = folder / "archives" / archive.file
            _fetch(cfg, dataset, archive, archive_path, progress)
            for name, request in requests.items():
                if dataset.archives[request.scene.archive] == archive:
                    _unpack(request, name, archive_path, progress)
            if not cfg.keep_archives:
                archive_path.unlink()
    print_line(console, f"{dataset.title}: {len(requests)} scenes in {folder / dataset.name}")


def _fetch(cfg: DictConfig, dataset: Dataset, archive: Archive, path: Path, progress: Progress) -> None:
    """Fetch an archive and verify its checksum; an archive that exists is only verified."""
    if path.is_file():
        print_line(progress.console, f"{path}: checking")
        check_archive(archive, path, path)
        return
    task = progress.add_task(archive.file, total=archive.bytes)
    digest = fetch(
        archive,
        path,
        page=dataset.page,
        retries=cfg.retries,
        timeout=cfg.timeout,
        advance=lambda done, total: progress.update(task, completed=done, total=total),
    )
    print_line(progress.console, f"{path}: SHA-256 {digest}, {checksum_note(archive)}")


def _unpack(scene: RequestedScene, name: str, archive: Path, progress: Progress) -> None:
    task = progress.add_task(name, total=None, visible=bool(scene.missing_parts))
    unpack(archive, scene.parts, scene.folder, lambda done, total: progress.update(task, completed=done, total=total))


def _names(cfg: DictConfig, key: str) -> tuple[str, ...] | None:
    """The names that an option lists, or None."""
    value = plain_values(cfg)[key]
    if value is None:
        return None
    if not isinstance(value, list) or not value or not all(isinstance(entry, str) for entry in value):
        raise InputError(key, f"is {value!r}", f"give a list: {key}=[NAME,NAME]")
    return tuple(value)
