"""The number of processor cores that this process may use."""

import os


def usable_cores() -> int:
    """Number of cores that this process may use: all cores where the system does not restrict processes to some.

    Only Linux has `os.sched_getaffinity`; macOS and Windows do not.
    """
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
