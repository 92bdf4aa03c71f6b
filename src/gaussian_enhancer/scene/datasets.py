"""Descriptions of published datasets: archives, scenes, sizes and expected fitting times.

The facts themselves stand in ``conf/dataset/*.yaml``, with their sources in ``docs/datasets.md``.
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
"""How a scene's folder is read."""
DIGESTS = {"sha256": 64, "md5": 32}
"""Digits of the checksums that an archive may state."""


@dataclass(frozen=True)
class Archive:
    """A zip file as it is published.

    Args:
        file: its name on disk.
        url: where it can be fetched over HTTP.
        bytes: its size; None where unknown.
        sha256: its checksum in lower-case hexadecimal digits; None where none is known.
        md5: the same, where that is what the server states.

    Raises:
        InputError: the name is no plain file name, the address is no HTTP address, or a checksum is malformed.
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
            stated = getattr(self, kind)
            if stated is not None and not re.fullmatch(f"[0-9a-f]{{{digits}}}", str(stated)):
                raise InputError(self.file, f"has {kind} {stated!r}", f"give {digits} lower-case hexadecimal digits")


@dataclass(frozen=True)
class DatasetScene:
    """One scene of a dataset, at its official resolution.

    Args:
        archive: key of the archive that holds it.
        inside: its folder in the archive.
        images: folders of its photos.
        width: of a photo, in pixels.
        height: of a photo, in pixels.
        fit_seconds: expected time of one fit on one GPU.
        assumed: whether that time is carried over from other scenes; otherwise it was published for this one.
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
        title: as papers call it.
        page: where its authors publish it.
        licence: in words.
        archives: by key.
        model: what is needed of every scene beside its photos: files and folders.
        scenes: by name.
        fit_basis: what the expected times of fits rest on.
        leave_out: patterns of files in the photos' folders that are no photos.
        test_photos: size of the dataset's own test split; None where every 8th photo is held out.
        layout: of a scene's folder: ``colmap``, or ``transforms`` as NeRF-Synthetic has it.
        pyramid: folders of photos that the authors downscaled, by the factor; empty where there is one size.
        background: colour under transparent photos, where a scene states none.

    Raises:
        InputError: a scene names an archive that there is not, or the layout is unknown.
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
                known = ", ".join(self.archives)
                raise InputError(f"{self.name}.{name}", f"lies in archive {scene.archive!r}", f"name one of {known}")

    def photo_folder(self, downscale: int | float) -> str:
        """The folder of a scene's photos of a size.

        Args:
            downscale: factor that divides the photos' full size.

        Raises:
            InputError: the authors published no photos downscaled by that factor.
        """
        if not self.pyramid:
            return "images"
        if downscale not in self.pyramid:
            known = ", ".join(map(str, self.pyramid))
            received = f"is {downscale} for {self.title}"
            raise InputError("scene.downscale", received, f"choose from {known}: its own photos")
        return self.pyramid[int(downscale)]

    def chosen(self, names: tuple[str, ...] | None) -> Mapping[str, DatasetScene]:
        """The scenes that are asked for, all where None.

        Raises:
            InputError: there is no scene of that name.
        """
        refuse_unknown("scenes", names, self.scenes)
        return {name: scene for name, scene in self.scenes.items() if names is None or name in names}


def dataset_of(values: Mapping[str, Any]) -> Dataset:
    """A dataset from plain values, as a configuration holds them.

    Raises:
        InputError: a value is missing, unknown or out of range.
    """
    context = f"dataset {values.get('name', '')}".strip()
    archives = {str(key): _build(Archive, value, context) for key, value in _mapping(values, "archives", context)}
    scenes = {str(key): _build(DatasetScene, value, context) for key, value in _mapping(values, "scenes", context)}
    dataset: Dataset = _build(Dataset, {**values, "archives": archives, "scenes": scenes}, context)
    return dataset


def dataset_names() -> tuple[str, ...]:
    """The datasets of ``conf/dataset``, sorted; a new one is a new file there."""
    return tuple(sorted(path.stem for path in (configurations() / "dataset").glob("*.yaml")))


@cache
def published_dataset(name: str) -> Dataset:
    """A dataset of ``conf/dataset``.

    Args:
        name: of its file, without ending.

    Raises:
        InputError: there is none of that name, or its file is malformed.
    """
    if name not in dataset_names():
        raise InputError("scene.dataset", f"is {name!r}", f"choose from {', '.join(dataset_names())}")
    values: Any = OmegaConf.to_container(OmegaConf.load(configurations() / "dataset" / f"{name}.yaml"))
    return dataset_of(values)


def _mapping(values: Mapping[str, Any], key: str, where: str) -> list[tuple[str, Any]]:
    found = values.get(key)
    if not isinstance(found, Mapping) or not all(isinstance(entry, Mapping) for entry in found.values()):
        raise InputError(where, f"has {key} = {found!r}", "give a mapping of names to their values")
    return list(found.items())


def _build(kind: type, values: Mapping[str, Any], where: str) -> Any:
    unknown = sorted(set(values) - {field.name for field in fields(kind)})
    if unknown:
        raise InputError(where, f"states {unknown[0]!r}", f"it is no value of {kind.__name__}")
    try:
        return kind(**{key: tuple(value) if isinstance(value, list) else value for key, value in values.items()})
    except TypeError as error:
        raise InputError(where, f"is incomplete: {error}", f"state every value of {kind.__name__}") from None
