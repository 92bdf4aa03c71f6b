"""Safe, atomic extraction of parts of a scene from a zip archive."""

import fnmatch
import os
import shutil
import stat
import zipfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import unwritable
from gaussian_enhancer.scene.transfer import check_room


@dataclass(frozen=True)
class Parts:
    """What to take of an archive.

    Args:
        inside: the scene's folder in the archive.
        names: files and folders in it.
        leave_out: patterns of file names in those folders that are not wanted.
    """

    inside: str
    names: tuple[str, ...]
    leave_out: tuple[str, ...] = ()


def unpack(
    archive: Path, parts: Parts, folder: Path, advance: Callable[[int, int], None] | None = None
) -> tuple[str, ...]:
    """Unpack parts of a scene that are not there yet.

    A part is unpacked beside its place and moved there when it is complete, so that a part that is there is whole.

    Args:
        archive: a zip file.
        parts: what to take.
        folder: the scene's folder.
        advance: told how many bytes are unpacked, of how many.

    Returns:
        Names of the parts that were unpacked now.

    Raises:
        InputError: the archive is damaged, holds a path outside its folder or a link, or lacks a
            part; the disk is full.
    """
    todo = tuple(name for name in parts.names if not (folder / name).exists())
    if not todo:
        return ()
    try:
        with zipfile.ZipFile(archive) as opened:
            _refuse_outside(opened, archive)
            members = {name: _members(opened, archive, parts, name) for name in todo}
            total = sum(member.file_size for found in members.values() for member in found)
            folder.mkdir(parents=True, exist_ok=True)
            check_room(folder, total, f"{parts.inside} of {archive.name}")
            bytes_done = 0
            for name, found in members.items():
                for size in _unpack_part(opened, found, f"{parts.inside}/{name}", folder / name):
                    bytes_done += size
                    if advance is not None:
                        advance(bytes_done, total)
    except (zipfile.BadZipFile, zlib.error, EOFError, RuntimeError) as error:
        raise InputError(archive, f"is no intact zip file ({error})", "delete it and fetch it again") from error
    except OSError as error:
        raise unwritable(folder, error) from error
    return todo


def _members(opened: zipfile.ZipFile, archive: Path, parts: Parts, name: str) -> list[zipfile.ZipInfo]:
    """The files of one part."""
    prefix = f"{parts.inside}/{name}"
    found = [
        member
        for member in opened.infolist()
        if not member.is_dir()
        and (member.filename == prefix or member.filename.startswith(f"{prefix}/"))
        and not any(fnmatch.fnmatch(PurePosixPath(member.filename).name, pattern) for pattern in parts.leave_out)
    ]
    if not found:
        paths = [member.filename for member in opened.infolist() if member.filename.startswith(f"{parts.inside}/")]
        folders = sorted({path[len(parts.inside) + 1 :].split("/")[0] for path in paths} - {""})
        received = f"holds no {prefix} (of {parts.inside}: {', '.join(folders) or 'nothing'})"
        raise InputError(archive, received, "ask for what is there with images=")
    return found


def _refuse_outside(opened: zipfile.ZipFile, archive: Path) -> None:
    """Refuse an archive that names a path outside the folder it is unpacked to, or a link."""
    for member in opened.infolist():
        path = PurePosixPath(member.filename.replace("\\", "/"))
        outside = path.is_absolute() or ".." in path.parts or (path.parts and path.parts[0].endswith(":"))
        if outside or stat.S_ISLNK(member.external_attr >> 16):
            received = f"holds {member.filename!r}, which leads outside its folder"
            raise InputError(archive, received, "do not use it: delete it and fetch it from its authors")


def _unpack_part(
    opened: zipfile.ZipFile, members: Sequence[zipfile.ZipInfo], prefix: str, place: Path
) -> Iterator[int]:
    """Unpack one part file by file; yields their sizes."""
    temporary = place.with_name(f".{place.name}.part")
    if temporary.is_dir():
        shutil.rmtree(temporary)
    temporary.unlink(missing_ok=True)
    for member in members:
        relative = member.filename[len(prefix) + 1 :]
        target = temporary / relative if relative else temporary
        target.parent.mkdir(parents=True, exist_ok=True)
        with opened.open(member) as source, target.open("wb") as file:
            shutil.copyfileobj(source, file, 1 << 20)
        yield member.file_size
    os.replace(temporary, place)
