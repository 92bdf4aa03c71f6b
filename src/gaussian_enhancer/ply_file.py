"""Reading of .ply files. The header is compared with the file's size before any data is read."""

from pathlib import Path

import numpy as np

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.input_files import reader, refuse_larger, regular_file

LONGEST_HEADER = 65_536
WIDTHS = {1: "char uchar int8 uint8", 2: "short ushort int16 uint16", 4: "int uint float int32 uint32 float32"}
WIDTHS |= {8: "double float64"}
GROWTH = 4
"""Most copies of a file's numbers in memory at the same time: mapped, as columns, joined, and as returned."""


@reader
def read_ply_elements(path: str | Path, element_names: tuple[str, ...], remedy: str) -> dict[str, np.ndarray]:
    """Read elements of a .ply as structured arrays by name; elements that the file lacks are left out.

    Args:
        path: the file, binary or ASCII.
        element_names: names of the elements, which must not have list properties.
        remedy: advice for a file that is not such a .ply, as an imperative.

    Raises:
        InputError: the file is missing, truncated or not a .ply, takes more memory than the limit, or has a list
            property in one of the elements.
    """
    from plyfile import PlyData, PlyParseError

    size = regular_file(path)
    _check_header(path, size, remedy)
    try:
        ply = PlyData.read(str(path), mmap="c")
    except (PlyParseError, ValueError, KeyError, TypeError, OverflowError) as error:
        received = f"is no readable .ply of {size} bytes ({error})"
        raise InputError(path, received, f"{remedy}, or copy it again") from None
    elements = {element.name: element for element in ply.elements if element.name in element_names}
    for name, element in elements.items():
        if element.data.dtype.hasobject:
            raise InputError(path, f"has lists in its element {name}", remedy)
    return {name: np.asarray(element.data) for name, element in elements.items()}


def _check_header(path: str | Path, size: int, remedy: str) -> None:
    """Refuse a header whose elements need more bytes than the file has, or more memory than the limit."""
    with open(path, "rb") as file:
        head = file.read(LONGEST_HEADER)
    text, _, _ = head.partition(b"end_header")
    min_bytes = allocated = count = 0
    ascii_file = b"format ascii" in text
    for line in text.decode("latin-1").splitlines():
        words = line.split()
        if len(words) == 3 and words[0] == "element":
            count = _count(path, words, remedy)
        elif len(words) >= 3 and words[0] == "property":
            width = _width(words[1])
            min_bytes += count * (2 if ascii_file else width)
            allocated += count * max(width, 4) * GROWTH
        if count > size or min_bytes > size + 1:  # the last line's end may be missing
            received = f"is no readable .ply of {size} bytes (it announces {count} rows, which take more)"
            raise InputError(path, received, f"{remedy}, or copy it again")
    refuse_larger(path, allocated, f"announces {count} rows")


def _count(path: str | Path, words: list[str], remedy: str) -> int:
    if not words[2].isascii() or not words[2].isdigit() or len(words[2]) > 18:
        raise InputError(path, f"announces {words[2]} rows of {words[1]}", remedy)
    return int(words[2])


def _width(kind: str) -> int:
    """Bytes of a property of this type; 1 for a list, which stores at least its length."""
    return next((width for width, names in WIDTHS.items() if kind in names.split()), 1)
