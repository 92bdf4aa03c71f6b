"""Control over what glibc does with freed memory. With another C library, these functions do nothing.

Images of some megabytes are allocated and freed many times a second. By default glibc requests the memory of each from
the system and returns it, and the system clears every page. On some machines this takes longer than the computation.
"""

import ctypes
import sys
from functools import cache
from typing import Any

_M_TRIM_THRESHOLD, _M_MMAP_MAX = -1, -4  # malloc.h
_ALL = 2**31 - 1


def retain_freed_memory() -> bool:
    """Keep freed memory for later allocations. Return whether the C library accepted the setting."""
    library = _glibc()
    return library is not None and bool(library.mallopt(_M_MMAP_MAX, 0) and library.mallopt(_M_TRIM_THRESHOLD, _ALL))


def release_freed_memory() -> None:
    """Return freed memory to the system, so that resident memory is only what is in use."""
    library = _glibc()
    if library is not None:
        library.malloc_trim(0)


@cache
def _glibc() -> Any:
    """The C library of this process, or None where it is not glibc."""
    if not sys.platform.startswith("linux"):
        return None
    library = ctypes.CDLL(None)
    return library if hasattr(library, "mallopt") and hasattr(library, "malloc_trim") else None
