"""Conversion of Hydra's errors about a command line to one-line messages."""

import io
import shlex
import traceback
from collections.abc import Sequence

from hydra.errors import MissingConfigException, OverrideParseException

from gaussian_enhancer.errors import InputError


class OverridesFilter:
    """A stream that drops one line of Hydra: the list of all overrides, which precedes the error of a job.

    Args:
        stream: standard error.
    """

    def __init__(self, stream: io.TextIOBase) -> None:
        self.stream = stream

    def write(self, text: str) -> int:
        """Write a text unless it is that line."""
        if text.startswith("Error executing job with overrides:"):
            return len(text)
        return self.stream.write(text)

    def __getattr__(self, name: str) -> object:
        return getattr(self.stream, name)


def is_hydra_error(error: BaseException) -> bool:
    """Whether an error was raised in Hydra's internal code, which composes configurations."""
    frames = [frame for frame, _ in traceback.walk_tb(error.__traceback__)]
    return bool(frames) and str(frames[-1].f_globals.get("__name__")).startswith("hydra._internal")


def to_input_error(error: Exception, job: str, overrides: Sequence[str] = ()) -> InputError:
    """Convert Hydra's error about a command line to an `InputError`.

    Args:
        error: as Hydra raised it.
        job: the job whose configuration was composed.
        overrides: of the command line.
    """
    lines = [line for line in str(error).splitlines() if line.strip() and "https://" not in line]
    message = lines[0] if lines else type(error).__name__
    if isinstance(error, OverrideParseException):
        name, sign, value = error.override.partition("=")
        quoted = shlex.quote(f'"{value}"')
        remedy = f"quote the value twice: {name}={quoted}" if sign else f"write {name}=VALUE"
        return InputError(f"override {error.override}", f"cannot be parsed ({message})", remedy)
    if isinstance(error, MissingConfigException) and error.missing_cfg_file and error.options:
        group, _, name = error.missing_cfg_file.rpartition("/")
        return InputError(group, f"has no choice {name!r}", f"choose {', '.join(sorted(error.options))}")
    start, end = "Could not override '", "'."
    if message.startswith(start):
        option = message.removeprefix(start).removesuffix(end)
        group = option.partition(".")[0]
        for override in overrides:  # Hydra applies single values before it knows the choices of a sweep
            if override.startswith(f"{group}=") and "," in override:
                remedy = f"make it part of the sweep: '{option}=choice(VALUE)'"
                return InputError(option, f"cannot be set beside the sweep {override}", remedy)
        remedy = f"see gaussian-enhancer {job} --help"
        return InputError(option, f"is no option of {job}", remedy)
    return InputError(f"command line of {job}", f"is refused ({message})", f"see gaussian-enhancer {job} --help")
