"""The progress bar of a fit: step, loss, PSNR and number of Gaussians.

Axes: h height, w width.
"""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from types import TracebackType

from jaxtyping import Float
from rich.console import Console
from rich.progress import MofNCompleteColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from torch import Tensor

from gaussian_enhancer.console import progress_bar

EVERY = 10
"""Steps between two readings of the loss; each reading waits for the device."""


@contextmanager
def waiting_bar(title: str, shown: bool) -> Iterator[None]:
    """Show a bar without a total on a terminal's standard error while something is prepared, then remove it.

    Args:
        title: what is prepared.
        shown: whether to show it.
    """
    console = Console(stderr=True)
    hidden = not (shown and console.is_terminal)
    with progress_bar(TimeElapsedColumn(), hidden=hidden, console=console, transient=True) as bar:
        bar.add_task(title, total=None)
        yield


class FitProgress:
    """Progress bar of a fit on standard error; does nothing if ``shown`` is false.

    Args:
        steps: number of steps of the whole fit.
        title: what is fitted.
        shown: whether to show it.
    """

    def __init__(self, steps: int, title: str, shown: bool) -> None:
        columns = MofNCompleteColumn(), TextColumn("{task.fields[state]}"), TimeRemainingColumn()
        self._bar = progress_bar(*columns, hidden=not shown, console=Console(stderr=True))
        self._task = self._bar.add_task(title, total=steps or None, state="")
        self._loss: float | None = None
        self._error: float | None = None

    def __enter__(self) -> "FitProgress":
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()

    def update(self, step: int, loss: Tensor, difference: Float[Tensor, "3 h w"], count: int) -> None:
        """Show the state after a step; loss and squared error are exponential moving averages.

        Args:
            step: steps done.
            loss: loss of this step.
            difference: render minus photo of this step.
            count: number of Gaussians.
        """
        if self._bar.disable or (step % EVERY and step > 1):
            return
        self._loss = _update_mean(self._loss, float(loss))
        self._error = _update_mean(self._error, float(difference.square().mean()))
        psnr = -10 * math.log10(max(self._error, 1e-10))
        state = f"loss {self._loss:.4f}  {psnr:.2f} dB  {count} Gaussians"
        self._bar.update(self._task, completed=step, state=state)

    def update_views(self, views: int, total: int) -> None:
        """Show how many views the plane sweep has done."""
        self._bar.update(self._task, completed=views, total=total)


def _update_mean(mean: float | None, value: float) -> float:
    """Exponential moving average."""
    return value if mean is None else 0.9 * mean + 0.1 * value
