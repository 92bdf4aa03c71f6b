"""What Hydra says of a command line that it refuses, in one line."""

import io
import traceback

from hydra.errors import MissingConfigException, OverrideParseException

from gaussian_enhancer.errors import InputError


class WithoutOverrides:
    """A stream without the line that Hydra writes before it raises a job's error: all overrides, mistaken or not.

    Args:
        stream: standard error.
    """

    def __init__(self, stream: io.TextIOBase) -> None:
        self.stream = stream

    def write(self, text: str) -> int:
        """Write a text, unless it is Hydra's line."""
        if text.startswith("Error executing job with overrides:"):
            return len(text)
        return self.stream.write(text)

    def __getattr__(self, name: str) -> object:
        return getattr(self.stream, name)


def raised_by_hydra(error: BaseException) -> bool:
    """Whether an error comes out of Hydra's own code, where it composes a configuration."""
    frames = [frame for frame, _ in traceback.walk_tb(error.__traceback__)]
    return bool(frames) and str(frames[-1].f_globals.get("__name__")).startswith("hydra._internal")


def refusal(error: Exception, job: str) -> InputError:
    """Why Hydra refuses a command line, as the user's mistake.

    Args:
        error: as Hydra raised it.
        job: whose configuration was composed.
    """
    lines = [line for line in str(error).splitlines() if line.strip() and "https://" not in line]
    said = lines[0] if lines else type(error).__name__
    if isinstance(error, OverrideParseException):
        name, sign, value = error.override.partition("=")
        remedy = f"""quote the value twice: {name}='"{value}"'""" if sign else f"write {name}=VALUE"
        return InputError(f"override {error.override}", f"cannot be parsed ({lines[-1]})", remedy)
    if isinstance(error, MissingConfigException) and error.missing_cfg_file and error.options:
        group, _, name = error.missing_cfg_file.rpartition("/")
        return InputError(group, f"has no choice {name!r}", f"choose {', '.join(sorted(error.options))}")
    start, end = "Could not override '", "'."
    if said.startswith(start):
        option = said.removeprefix(start).removesuffix(end)
        remedy = f"see gaussian-enhancer {job} --help, or add a key of your own: +{option}=VALUE"
        return InputError(option, f"is no option of {job}", remedy)
    return InputError(f"command line of {job}", f"is refused ({said})", f"see gaussian-enhancer {job} --help")
