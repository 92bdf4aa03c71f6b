"""When views are drawn: small while the camera moves, at full size once it is still."""

import threading
import time
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from functools import partial

SETTLED = 0.25
"""Seconds without a movement after which a camera is still."""
ARRIVAL = 1.0
"""Seconds in which a new browser goes to the start; until then its camera is somewhere else."""


@dataclass
class _Due:
    """What is due for one viewer: a small view at once, and a full one from a time on."""

    small: bool
    full_at: float
    version: int


@dataclass(frozen=True)
class ViewTask:
    """A view to draw.

    Args:
        viewer: whose it is.
        full: at full size.
        version: of what the viewer asked for.
    """

    viewer: Hashable
    full: bool
    version: int


class ViewSchedule:
    """What is due, by viewer. A new camera takes the place of those that were not begun.

    Args:
        settled: seconds without a movement after which a camera is still.
    """

    def __init__(self, settled: float = SETTLED) -> None:
        self.settled = settled
        self._due: dict[Hashable, _Due] = {}
        self._versions: dict[Hashable, int] = {}

    def came(self, viewer: Hashable, now: float) -> None:
        """A viewer came: its first movement, to where it starts, is waited for.

        Args:
            viewer: who came.
            now: seconds of a steady clock.
        """
        self._due[viewer] = _Due(False, now + ARRIVAL, self._next(viewer))

    def moved(self, viewer: Hashable, now: float) -> None:
        """A viewer's camera moved: a small view is due at once, a full one when it is still.

        Args:
            viewer: whose camera.
            now: seconds of a steady clock.
        """
        self._due[viewer] = _Due(True, now + self.settled, self._next(viewer))

    def changed(self, viewer: Hashable, now: float) -> None:
        """What a viewer shows changed; its camera did not: a full view is due at once, or when the camera is still.

        Args:
            viewer: whose page.
            now: seconds of a steady clock.
        """
        waiting = self._due.get(viewer)
        moving = waiting is not None and waiting.small
        self._due[viewer] = _Due(moving, now + self.settled if moving else now, self._next(viewer))

    def forget(self, viewer: Hashable) -> None:
        """A viewer is gone."""
        self._due.pop(viewer, None)
        self._versions.pop(viewer, None)

    def take(self, now: float) -> ViewTask | None:
        """The next view to draw, small ones first; None where none is due yet.

        Args:
            now: seconds of a steady clock.
        """
        for viewer, due in self._due.items():
            if due.small:
                self._due.pop(viewer)  # to the end: viewers take turns
                self._due[viewer] = _Due(False, due.full_at, due.version)
                return ViewTask(viewer, False, due.version)
        for viewer, due in self._due.items():
            if due.full_at <= now:
                self._due.pop(viewer)
                return ViewTask(viewer, True, due.version)
        return None

    def wait(self, now: float) -> float | None:
        """Seconds until a view is due; None where none will be."""
        times = [now if due.small else due.full_at for due in self._due.values()]
        return max(0.0, min(times) - now) if times else None

    def superseded(self, task: ViewTask) -> bool:
        """Whether the viewer has asked for another view since, or is gone."""
        return self._versions.get(task.viewer) != task.version

    def _next(self, viewer: Hashable) -> int:
        self._versions[viewer] = self._versions.get(viewer, 0) + 1
        return self._versions[viewer]


class Worker:
    """A thread that draws what is due. Only a full view is given up for another; small ones are always completed.

    Args:
        draw: draws a view for a viewer: viewer, whether at full size, whether another took its place. An error
            ends the thread; `wait` raises it.
        schedule: what is due.
    """

    def __init__(
        self, draw: Callable[[Hashable, bool, Callable[[], bool]], None], schedule: ViewSchedule | None = None
    ) -> None:
        self._draw, self._schedule = draw, ViewSchedule() if schedule is None else schedule
        self._news = threading.Condition()
        self._stopped = False
        self._ended = threading.Event()
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="viewer", daemon=True)

    def start(self) -> None:
        """Begin to draw."""
        self._thread.start()

    def wait(self) -> None:
        """Wait until the thread ends; raise the error that ended it."""
        self._ended.wait()
        if self._error is not None:
            raise self._error

    def stop(self) -> None:
        """Complete what is being drawn and end the thread."""
        with self._news:
            self._stopped = True
            self._news.notify()
        if self._thread.is_alive():
            self._thread.join()

    def came(self, viewer: Hashable) -> None:
        """A viewer came."""
        self._tell(self._schedule.came, viewer)

    def moved(self, viewer: Hashable) -> None:
        """A viewer's camera moved."""
        self._tell(self._schedule.moved, viewer)

    def changed(self, viewer: Hashable) -> None:
        """What a viewer shows changed."""
        self._tell(self._schedule.changed, viewer)

    def forget(self, viewer: Hashable) -> None:
        """A viewer is gone."""
        with self._news:
            self._schedule.forget(viewer)

    def _tell(self, how: Callable[[Hashable, float], None], viewer: Hashable) -> None:
        with self._news:
            how(viewer, time.monotonic())
            self._news.notify()

    def _run(self) -> None:
        try:
            while (task := self._due()) is not None:
                self._draw(task.viewer, task.full, partial(self._superseded, task))
        except BaseException as error:  # raised by `wait`, in the thread that can end the program
            self._error = error
        finally:
            self._ended.set()

    def _superseded(self, task: ViewTask) -> bool:
        if not task.full:
            return False
        with self._news:
            return self._stopped or self._schedule.superseded(task)

    def _due(self) -> ViewTask | None:
        with self._news:
            while not self._stopped:
                now = time.monotonic()
                task = self._schedule.take(now)
                if task is not None:
                    return task
                self._news.wait(self._schedule.wait(now))
        return None
