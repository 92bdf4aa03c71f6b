"""Scheduling of views: they are drawn small while the camera moves, and at full size once it is still.

A viewer is a browser that shows the page; it is given by its identifier. Times are seconds of a monotonic clock.
"""

import threading
import time
from collections.abc import Callable, Hashable
from dataclasses import dataclass, replace
from functools import partial

SETTLE_SECONDS = 0.25
"""Seconds without a movement after which a camera is still."""
INITIAL_MOVE_SECONDS = 1.0
"""Seconds in which a new browser moves its camera to the initial pose."""


@dataclass(frozen=True)
class _PendingViews:
    """Pending views of one viewer.

    Args:
        small: whether a small view is due at once.
        full_at: time at which the full view is due.
        version: number of the viewer's request.
    """

    small: bool
    full_at: float
    version: int


@dataclass(frozen=True)
class ViewTask:
    """A view to draw.

    Args:
        viewer: the viewer that it is drawn for.
        full: whether it is drawn at full size.
        version: number of the viewer's request.
    """

    viewer: Hashable
    full: bool
    version: int


class ViewSchedule:
    """Pending views by viewer. A new camera replaces pending views that are not being drawn yet.

    Args:
        settle_seconds: seconds without a movement after which a camera is still.
    """

    def __init__(self, settle_seconds: float = SETTLE_SECONDS) -> None:
        self.settle_seconds = settle_seconds
        self._pending: dict[Hashable, _PendingViews] = {}
        self._versions: dict[Hashable, int] = {}

    def add_viewer(self, viewer: Hashable, now: float) -> None:
        """Register a new viewer. Its full view is due after the movement to the initial pose.

        Args:
            viewer: the viewer.
            now: the present time.
        """
        self._pending[viewer] = _PendingViews(False, now + INITIAL_MOVE_SECONDS, self._next(viewer))

    def camera_moved(self, viewer: Hashable, now: float) -> None:
        """Register a movement of a viewer's camera: a small view is due at once, a full one when the camera is still.

        Args:
            viewer: the viewer.
            now: the present time.
        """
        self._pending[viewer] = _PendingViews(True, now + self.settle_seconds, self._next(viewer))

    def content_changed(self, viewer: Hashable, now: float) -> None:
        """Register a change of what is shown, with the same camera.

        A full view is due at once. A pending small view means that the camera is moving; then the full view is due when
        the camera is still.

        Args:
            viewer: the viewer.
            now: the present time.
        """
        pending = self._pending.get(viewer)
        moving = pending is not None and pending.small
        self._pending[viewer] = _PendingViews(moving, now + self.settle_seconds if moving else now, self._next(viewer))

    def remove_viewer(self, viewer: Hashable) -> None:
        """Remove a viewer that disconnected."""
        self._pending.pop(viewer, None)
        self._versions.pop(viewer, None)

    def take(self, now: float) -> ViewTask | None:
        """Take the next view to draw, small ones first; None where none is due yet.

        Args:
            now: the present time.
        """
        for viewer, pending in self._pending.items():
            if pending.small:
                self._pending.pop(viewer)  # inserted again at the end, so that viewers take turns
                self._pending[viewer] = replace(pending, small=False)
                return ViewTask(viewer, False, pending.version)
        for viewer, pending in self._pending.items():
            if pending.full_at <= now:
                self._pending.pop(viewer)
                return ViewTask(viewer, True, pending.version)
        return None

    def wait(self, now: float) -> float | None:
        """Seconds until a view is due; None where none is pending."""
        times = [now if pending.small else pending.full_at for pending in self._pending.values()]
        return max(0.0, min(times) - now) if times else None

    def is_superseded(self, task: ViewTask) -> bool:
        """Whether the viewer has asked for another view since, or has disconnected."""
        return self._versions.get(task.viewer) != task.version

    def _next(self, viewer: Hashable) -> int:
        self._versions[viewer] = self._versions.get(viewer, 0) + 1
        return self._versions[viewer]


class Worker:
    """A thread that draws pending views. Only a full view is abandoned for a newer one; small ones are completed.

    Args:
        draw: draws a view; it is called with the viewer, whether to draw at full size, and a function that returns
            whether the view is superseded. An error ends the thread; `wait` raises it.
        schedule: the pending views.
    """

    def __init__(
        self, draw: Callable[[Hashable, bool, Callable[[], bool]], None], schedule: ViewSchedule | None = None
    ) -> None:
        self._draw, self._schedule = draw, ViewSchedule() if schedule is None else schedule
        self._condition = threading.Condition()
        self._stopped = False
        self._ended = threading.Event()
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="viewer", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def wait(self) -> None:
        """Wait until the thread ends; raise the error that ended it."""
        self._ended.wait()
        if self._error is not None:
            raise self._error

    def stop(self) -> None:
        """Complete the view that is being drawn, and end the thread."""
        with self._condition:
            self._stopped = True
            self._condition.notify()
        if self._thread.is_alive():
            self._thread.join()

    def add_viewer(self, viewer: Hashable) -> None:
        """Register a new viewer."""
        self._report(self._schedule.add_viewer, viewer)

    def camera_moved(self, viewer: Hashable) -> None:
        """Register a movement of a viewer's camera."""
        self._report(self._schedule.camera_moved, viewer)

    def content_changed(self, viewer: Hashable) -> None:
        """Register a change of what a viewer shows."""
        self._report(self._schedule.content_changed, viewer)

    def remove_viewer(self, viewer: Hashable) -> None:
        """Remove a viewer that disconnected."""
        with self._condition:
            self._schedule.remove_viewer(viewer)

    def _report(self, register: Callable[[Hashable, float], None], viewer: Hashable) -> None:
        with self._condition:
            register(viewer, time.monotonic())
            self._condition.notify()

    def _run(self) -> None:
        try:
            while (task := self._next_task()) is not None:
                self._draw(task.viewer, task.full, partial(self._superseded, task))
        except BaseException as error:  # raised by `wait`, in the thread that can end the program
            self._error = error
        finally:
            self._ended.set()

    def _superseded(self, task: ViewTask) -> bool:
        if not task.full:
            return False
        with self._condition:
            return self._stopped or self._schedule.is_superseded(task)

    def _next_task(self) -> ViewTask | None:
        with self._condition:
            while not self._stopped:
                now = time.monotonic()
                task = self._schedule.take(now)
                if task is not None:
                    return task
                self._condition.wait(self._schedule.wait(now))
        return None
