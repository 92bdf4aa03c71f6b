"""What the C library does with freed memory, where that is glibc; elsewhere nothing happens here.

Images of some megabytes are allocated and freed many times a second. By default glibc takes each from the system anew
and gives it back, and the system clears every page: on some machines that takes longer than what is computed.
"""

import ctypes
import sys
from functools import cache
from typing import Any

_M_TRIM_THRESHOLD, _M_MMAP_MAX = -1, -4  # malloc.h
_ALL = 2**31 - 1


def keep_freed() -> bool:
    """Keep freed memory for what is allocated next; whether the C library was told so."""
    library = _glibc()
    return library is not None and bool(library.mallopt(_M_MMAP_MAX, 0) and library.mallopt(_M_TRIM_THRESHOLD, _ALL))


def give_back() -> None:
    """Give what is kept but not used back to the system, so that resident memory is what is held."""
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
