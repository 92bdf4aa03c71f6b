"""Lines and progress bars on the terminal."""

from omegaconf import DictConfig
from rich.console import Console


def print_line(console: Console, text: object) -> None:
    """Print a text unchanged: brackets in paths are no markup, and only the terminal wraps long lines."""
    console.print(str(text), highlight=False, soft_wrap=True, markup=False)


def hides_progress(cfg: DictConfig, console: Console) -> bool:
    """Whether a job shows no progress bar: the user asked for none, or the output is not a terminal.

    Args:
        cfg: configuration of a job, with ``runtime.progress``.
        console: where the bar would be shown.
    """
    return not (cfg.runtime.progress and console.is_terminal)
