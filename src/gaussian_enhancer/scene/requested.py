"""The scenes of a dataset requested by a download, and which of their parts are on disk."""

import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from gaussian_enhancer.scene.datasets import Archive, Dataset, DatasetScene
from gaussian_enhancer.scene.extract import Parts


@dataclass(frozen=True)
class RequestedScene:
    """A requested scene.

    Args:
        scene: the scene's description.
        parts: the parts of the scene to unpack.
        folder: the folder that they are unpacked to.
    """

    scene: DatasetScene
    parts: Parts
    folder: Path

    @property
    def missing_parts(self) -> tuple[str, ...]:
        """Names of the parts that are not on disk."""
        return tuple(name for name in self.parts.names if not (self.folder / name).exists())


def requested_scenes(
    dataset: Dataset, folder: Path, scenes: tuple[str, ...] | None, images: tuple[str, ...] | None
) -> Mapping[str, RequestedScene]:
    """Requested scenes by name.

    Args:
        dataset: the dataset.
        folder: parent folder of all datasets.
        scenes: names of scenes; all where None.
        images: folders of photos to unpack; those that the dataset's description lists for each scene where None.

    Raises:
        InputError: there is no such scene.
    """
    return {
        name: RequestedScene(
            scene,
            Parts(scene.inside, (*dataset.model, *(images or scene.images)), dataset.leave_out),
            folder / dataset.name / name,
        )
        for name, scene in dataset.select_scenes(scenes).items()
    }


def listing(dataset: Dataset, folder: Path, requested: Mapping[str, RequestedScene]) -> Iterator[str]:
    """Lines of text that state which archives and parts are on disk and which are to be fetched or unpacked."""
    yield f"{dataset.title}, {dataset.page}"
    yield f"  licence: {dataset.licence}"
    yield f"  folder: {folder}, {shutil.disk_usage(_nearest_existing(folder)).free / 1e9:.1f} GB free"
    needed = needed_archives(dataset, requested)
    for archive in sorted(
        {dataset.archives[entry.scene.archive] for entry in requested.values()}, key=lambda a: a.file
    ):
        path = folder / "archives" / archive.file
        partial_file = path.with_name(f"{path.name}.part")
        if path.is_file():
            state = f"there ({_size(path.stat().st_size)})"
        elif archive not in needed:
            state = "not needed"
        else:
            partial = f", {_size(partial_file.stat().st_size)} of it there" if partial_file.is_file() else ""
            state = f"to fetch ({_size(archive.bytes)}{partial}) from {archive.url}"
        yield f"  archive {archive.file}: {state}; {checksum_note(archive)}"
    for name, entry in requested.items():
        absent = ", ".join(entry.missing_parts)
        present = ", ".join(name for name in entry.parts.names if name not in entry.missing_parts)
        states = [f"{label} {names}" for label, names in (("there:", present), ("to unpack:", absent)) if names]
        yield f"  scene {name}: {'; '.join(states)}"


def needed_archives(dataset: Dataset, requested: Mapping[str, RequestedScene]) -> list[Archive]:
    """The archives of those scenes that lack parts on disk, without repetition.

    Args:
        dataset: the dataset.
        requested: requested scenes by name.
    """
    archives = {dataset.archives[entry.scene.archive]: None for entry in requested.values() if entry.missing_parts}
    return list(archives)


def checksum_note(archive: Archive) -> str:
    """Description of how an archive's checksum is verified.

    Args:
        archive: an archive of a dataset.
    """
    kinds = [kind for kind in ("sha256", "md5") if getattr(archive, kind) is not None]
    return f"{kinds[0]} recorded" if kinds else "no checksum published: the first copy's is kept beside it"


def _size(count: int | None) -> str:
    return "size unknown" if count is None else f"{count / 1e9:.2f} GB" if count > 1e7 else f"{count} bytes"


def _nearest_existing(folder: Path) -> Path:
    """The folder itself if it exists, otherwise its nearest existing parent."""
    return next(parent for parent in (folder.resolve(), *folder.resolve().parents) if parent.is_dir())
