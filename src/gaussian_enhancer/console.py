"""Lines and progress bars on the terminal."""

from omegaconf import DictConfig
from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, TextColumn


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


def progress_bar(
    *columns: ProgressColumn, hidden: bool, console: Console | None = None, transient: bool = False
) -> Progress:
    """A progress bar: the description of the task, the bar, then the given columns.

    Args:
        columns: what stands right of the bar.
        hidden: whether nothing is shown.
        console: where the bar is shown; None for standard output.
        transient: whether the bar is removed at its end.
    """
    shown = TextColumn("{task.description}"), BarColumn(), *columns
    return Progress(*shown, console=console, disable=hidden, transient=transient)
