"""Reading of a splat in any supported format; the format is recognised by the file's content, not its ending."""

from pathlib import Path

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.input_files import convert_read_errors, regular_file
from gaussian_enhancer.splat.io.compressed_ply import read_compressed_ply
from gaussian_enhancer.splat.io.gsplat_results import read_gsplat_checkpoint
from gaussian_enhancer.splat.io.ply import read_ply
from gaussian_enhancer.splat.io.result_folders import find_splat
from gaussian_enhancer.splat.io.spz import GZIP_MAGIC, MAGIC, read_spz
from gaussian_enhancer.types import Gaussians

_FORMATS = "a 3DGS .ply, a PlayCanvas compressed .ply, a .spz or a checkpoint of gsplat"
_ZIP_MAGIC = b"PK\x03\x04"


def read_splat(path: str | Path, *, invalid: str = "refuse") -> Gaussians:
    """Read a splat: 3DGS .ply (also of 2DGS and Mip-Splatting), PlayCanvas compressed .ply, Niantic .spz or gsplat.

    Args:
        path: the file, or a result folder of 3DGS or gsplat's simple_trainer, from which the latest splat is read.
        invalid: what to do with Gaussians that cannot be rendered: "refuse" or "drop".

    Raises:
        InputError: if the file is missing, empty, of an unknown format, inconsistent with its format, or holds invalid
            Gaussians that are refused.
    """
    path = find_splat(path)
    head = _head(path)
    if head[:4] == MAGIC or head[:2] == GZIP_MAGIC:
        return read_spz(path, invalid=invalid)
    if head[:3] == b"ply":
        compressed = b"packed_position" in head.split(b"end_header", 1)[0]
        return (read_compressed_ply if compressed else read_ply)(path, invalid=invalid)
    if head[:4] == _ZIP_MAGIC:
        return read_gsplat_checkpoint(path, invalid=invalid)
    if not head:
        raise InputError(path, "is empty", f"give {_FORMATS}")
    raise InputError(path, f"is no splat that can be read (it starts with {head[:4]!r})", f"give {_FORMATS}")


def _head(path: str | Path) -> bytes:
    """The file's first bytes, enough for the header of any .ply that holds a splat."""
    regular_file(path)
    with convert_read_errors(path), open(path, "rb") as file:
        return file.read(16_384)
