"""Descriptions of published datasets: archives, scenes, sizes and expected fitting times.

The values are stored in ``conf/dataset/*.yaml``; their sources are given in ``docs/datasets.md``.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import cache
from typing import Any

from omegaconf import OmegaConf

from gaussian_enhancer.configurations import configurations
from gaussian_enhancer.errors import InputError, refuse_unknown

LAYOUTS = ("colmap", "transforms")
"""Supported layouts of a scene's folder."""
DIGESTS = {"sha256": 64, "md5": 32}
"""Number of hexadecimal digits of each supported checksum."""


@dataclass(frozen=True)
class Archive:
    """A published zip file.

    Args:
        file: its name on disk.
        url: its HTTP or HTTPS address.
        bytes: its size; None where unknown.
        sha256: SHA-256 checksum in lower-case hexadecimal digits; None where unknown.
        md5: MD5 checksum in the same form, for servers that publish MD5; None where unknown.

    Raises:
        InputError: the name is not a plain file name, the address is not an HTTP address, or a checksum is malformed.
    """

    file: str
    url: str
    bytes: int | None = None
    sha256: str | None = None
    md5: str | None = None

    def __post_init__(self) -> None:
        if not re.fullmatch(r"\w[\w.-]*", self.file):
            raise InputError("archive", f"is called {self.file!r}", "give a plain file name")
        if not re.match(r"https?://", self.url):
            raise InputError(self.file, f"is to be fetched from {self.url!r}", "give an http or https address")
        for kind, digits in DIGESTS.items():
            checksum = getattr(self, kind)
            if checksum is not None and not re.fullmatch(f"[0-9a-f]{{{digits}}}", str(checksum)):
                raise InputError(self.file, f"has {kind} {checksum!r}", f"give {digits} lower-case hexadecimal digits")


@dataclass(frozen=True)
class DatasetScene:
    """One scene of a dataset, at its official resolution.

    Args:
        archive: key of the archive that holds the scene.
        inside: the scene's folder in the archive.
        images: folders of its photos that the tables need.
        width: of a photo, in pixels.
        height: of a photo, in pixels.
        fit_seconds: expected time of one fit on one GPU, in seconds.
        assumed: whether ``fit_seconds`` was taken over from other scenes; otherwise it was published for this scene.
    """

    archive: str
    inside: str
    images: tuple[str, ...]
    width: int
    height: int
    fit_seconds: int | float
    assumed: bool = False


@dataclass(frozen=True)
class Dataset:
    """A published dataset.

    Args:
        name: its key, which is also its folder's name.
        title: its name in papers.
        page: address of its authors' page.
        licence: description of its licence.
        archives: archives by key.
        model: files and folders that every scene needs besides its photos.
        scenes: scenes by name.
        fit_basis: source of the expected fitting times.
        leave_out: patterns of files in the photo folders that are not photos.
        test_photos: size of the dataset's own test split; None where every 8th photo is held out.
        layout: layout of a scene's folder: ``colmap``, or ``transforms`` as in NeRF-Synthetic.
        pyramid: folders of photos downscaled by the authors, by downscaling factor; empty where there is one size.
        background: default colour under transparent photos.

    Raises:
        InputError: a scene names an unknown archive, or the layout is unknown.
    """

    name: str
    title: str
    page: str
    licence: str
    archives: Mapping[str, Archive]
    model: tuple[str, ...]
    scenes: Mapping[str, DatasetScene]
    fit_basis: str
    leave_out: tuple[str, ...] = ()
    test_photos: int | None = None
    layout: str = "colmap"
    pyramid: Mapping[int, str] = field(default_factory=dict)
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if self.layout not in LAYOUTS:
            raise InputError(f"{self.name}.layout", f"is {self.layout!r}", f"choose from {', '.join(LAYOUTS)}")
        for name, scene in self.scenes.items():
            if scene.archive not in self.archives:
                remedy = f"name one of {', '.join(self.archives)}"
                raise InputError(f"{self.name}.{name}", f"lies in archive {scene.archive!r}", remedy)

    def photo_folder(self, downscale: int | float) -> str:
        """Name of the folder that holds a scene's photos at a downscaling factor.

        Args:
            downscale: factor that divides the photos' full width and height.

        Raises:
            InputError: the dataset has a ``pyramid``, which lacks that factor.
        """
        if not self.pyramid:
            return "images"
        if downscale not in self.pyramid:
            factors = ", ".join(map(str, self.pyramid))
            received = f"is {downscale} for {self.title}"
            raise InputError("scene.downscale", received, f"choose from {factors}: its own photos")
        return self.pyramid[int(downscale)]

    def select_scenes(self, names: tuple[str, ...] | None) -> Mapping[str, DatasetScene]:
        """The scenes with the given names, by name; all scenes where None.

        Raises:
            InputError: a name is not that of a scene.
        """
        refuse_unknown("scenes", names, self.scenes)
        return {name: scene for name, scene in self.scenes.items() if names is None or name in names}


def dataset_of(values: Mapping[str, Any]) -> Dataset:
    """Build a dataset from the plain values of a configuration.

    Raises:
        InputError: a value is missing, unknown or out of range.
    """
    context = f"dataset {values.get('name', '')}".strip()
    archives = {str(key): _build(Archive, value, context) for key, value in _mapping(values, "archives", context)}
    scenes = {str(key): _build(DatasetScene, value, context) for key, value in _mapping(values, "scenes", context)}
    dataset: Dataset = _build(Dataset, {**values, "archives": archives, "scenes": scenes}, context)
    return dataset


def dataset_names() -> tuple[str, ...]:
    """Sorted names of the datasets in ``conf/dataset``; a file added there adds a dataset."""
    return tuple(sorted(path.stem for path in (configurations() / "dataset").glob("*.yaml")))


@cache
def published_dataset(name: str) -> Dataset:
    """Load a dataset's description from ``conf/dataset`` (cached).

    Args:
        name: name of its file, without ending.

    Raises:
        InputError: no dataset has that name, or its file is malformed.
    """
    if name not in dataset_names():
        raise InputError("scene.dataset", f"is {name!r}", f"choose from {', '.join(dataset_names())}")
    values: Any = OmegaConf.to_container(OmegaConf.load(configurations() / "dataset" / f"{name}.yaml"))
    return dataset_of(values)


def _mapping(values: Mapping[str, Any], key: str, where: str) -> list[tuple[str, Any]]:
    entries = values.get(key)
    if not isinstance(entries, Mapping) or not all(isinstance(entry, Mapping) for entry in entries.values()):
        raise InputError(where, f"has {key} = {entries!r}", "give a mapping of names to their values")
    return list(entries.items())


def _build(kind: type, values: Mapping[str, Any], where: str) -> Any:
    unknown = sorted(set(values) - {item.name for item in fields(kind)})
    if unknown:
        raise InputError(where, f"states {unknown[0]!r}", f"it is no value of {kind.__name__}")
    try:
        return kind(**{key: tuple(value) if isinstance(value, list) else value for key, value in values.items()})
    except TypeError as error:
        raise InputError(where, f"is incomplete: {error}", f"state every value of {kind.__name__}") from None
