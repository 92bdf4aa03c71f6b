"""Provenance of a measurement: code version and machine."""

import functools
import platform
import subprocess
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

from gaussian_enhancer.cores import usable_cores


@functools.lru_cache(maxsize=1)
def this_commit() -> str:
    """Commit of this code's checkout, with ``+`` if tracked files were changed; otherwise the installed version."""
    folder = Path(__file__).resolve().parent

    def git(*arguments: str) -> str:
        command = ["git", "-C", str(folder), *arguments]
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=10).stdout.strip()

    try:
        git("ls-files", "--error-unmatch", Path(__file__).name)  # fails in another project's checkout
        return git("rev-parse", "--short=10", "HEAD") + ("+" if git("status", "--porcelain", "-uno") else "")
    except (OSError, subprocess.SubprocessError):
        return version("gaussian-enhancer")


@functools.lru_cache(maxsize=1)
def this_machine() -> str:
    """Description of the machine: processor, usable cores, accelerator and torch version."""
    import torch

    accelerator = torch.cuda.get_device_name() if torch.cuda.is_available() else "no GPU"
    return f"{_processor()}, {usable_cores()} cores, {accelerator}, torch {torch.__version__}"


def provenance(timed: bool = False) -> dict[str, str]:
    """Commit and machine, as fields of a record.

    Args:
        timed: add the current time, ISO 8601, UTC.
    """
    timestamp = {"time": datetime.now(UTC).isoformat(timespec="seconds")} if timed else {}
    return {"commit": this_commit(), "machine": this_machine(), **timestamp}


def _processor() -> str:
    """The processor's model name, or its architecture if the system does not provide a name."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()
