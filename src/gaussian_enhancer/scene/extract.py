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
from gaussian_enhancer.files import to_write_error
from gaussian_enhancer.scene.transfer import check_room


@dataclass(frozen=True)
class Parts:
    """The parts of an archive to unpack.

    Args:
        inside: the scene's folder in the archive.
        names: files and folders in that folder.
        leave_out: patterns of file names to skip.
    """

    inside: str
    names: tuple[str, ...]
    leave_out: tuple[str, ...] = ()


def unpack(
    archive: Path, parts: Parts, folder: Path, advance: Callable[[int, int], None] | None = None
) -> tuple[str, ...]:
    """Unpack the parts of a scene that are not on disk yet.

    A part is unpacked to a temporary path beside its destination and renamed when complete. Existing parts are
    therefore complete.

    Args:
        archive: a zip file.
        parts: the parts to unpack.
        folder: the scene's folder on disk.
        advance: progress callback: bytes unpacked, total bytes.

    Returns:
        Names of the parts unpacked by this call.

    Raises:
        InputError: the archive is damaged, holds a link or a path outside its folder, or lacks a part; or the disk is
            full.
    """
    missing_parts = tuple(name for name in parts.names if not (folder / name).exists())
    if not missing_parts:
        return ()
    try:
        with zipfile.ZipFile(archive) as zip_file:
            _refuse_outside(zip_file, archive)
            members = {name: _members(zip_file, archive, parts, name) for name in missing_parts}
            total = sum(member.file_size for part_members in members.values() for member in part_members)
            folder.mkdir(parents=True, exist_ok=True)
            check_room(folder, total, f"{parts.inside} of {archive.name}")
            bytes_done = 0
            for name, part_members in members.items():
                for size in _unpack_part(zip_file, part_members, f"{parts.inside}/{name}", folder / name):
                    bytes_done += size
                    if advance is not None:
                        advance(bytes_done, total)
    except (zipfile.BadZipFile, zlib.error, EOFError, RuntimeError) as error:
        raise InputError(archive, f"is no intact zip file ({error})", "delete it and fetch it again") from error
    except OSError as error:
        raise to_write_error(folder, error) from error
    return missing_parts


def _members(zip_file: zipfile.ZipFile, archive: Path, parts: Parts, name: str) -> list[zipfile.ZipInfo]:
    """The archive's entries for the files of one part."""
    prefix = f"{parts.inside}/{name}"
    files = [
        member
        for member in zip_file.infolist()
        if not member.is_dir()
        and (member.filename == prefix or member.filename.startswith(f"{prefix}/"))
        and not any(fnmatch.fnmatch(PurePosixPath(member.filename).name, pattern) for pattern in parts.leave_out)
    ]
    if not files:
        paths = [member.filename for member in zip_file.infolist() if member.filename.startswith(f"{parts.inside}/")]
        folders = sorted({path[len(parts.inside) + 1 :].split("/")[0] for path in paths} - {""})
        received = f"holds no {prefix} (of {parts.inside}: {', '.join(folders) or 'nothing'})"
        raise InputError(archive, received, "set images= to existing folders")
    return files


def _refuse_outside(zip_file: zipfile.ZipFile, archive: Path) -> None:
    """Refuse an archive that holds a symbolic link or a path outside the folder it is unpacked to."""
    for member in zip_file.infolist():
        path = PurePosixPath(member.filename.replace("\\", "/"))
        is_outside = path.is_absolute() or ".." in path.parts or (path.parts and path.parts[0].endswith(":"))
        if is_outside or stat.S_ISLNK(member.external_attr >> 16):
            received = f"holds {member.filename!r}, whose path is outside the target folder"
            raise InputError(archive, received, "do not use it: delete it and fetch it from its authors")


def _unpack_part(
    zip_file: zipfile.ZipFile, members: Sequence[zipfile.ZipInfo], prefix: str, destination: Path
) -> Iterator[int]:
    """Unpack one part; yield the size of each file after it is written."""
    temporary = destination.with_name(f".{destination.name}.part")
    if temporary.is_dir():
        shutil.rmtree(temporary)
    temporary.unlink(missing_ok=True)
    for member in members:
        relative = member.filename[len(prefix) + 1 :]
        target = temporary / relative if relative else temporary
        target.parent.mkdir(parents=True, exist_ok=True)
        with zip_file.open(member) as source, target.open("wb") as file:
            shutil.copyfileobj(source, file, 1 << 20)
        yield member.file_size
    os.replace(temporary, destination)
