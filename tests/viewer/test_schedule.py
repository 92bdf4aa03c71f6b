import threading

import pytest

from gaussian_enhancer.viewer.schedule import INITIAL_MOVE_SECONDS, ViewSchedule, ViewTask, Worker


def test_a_moving_camera_is_drawn_small_and_a_still_one_at_full_size():
    schedule = ViewSchedule(settle_seconds=0.5)
    assert schedule.take(0.0) is None
    assert schedule.wait(0.0) is None
    schedule.camera_moved("a", 0.0)
    assert schedule.wait(0.0) == 0
    assert schedule.take(0.1) == ViewTask("a", False, 1)
    assert schedule.take(0.4) is None
    assert schedule.wait(0.4) == pytest.approx(0.1)
    schedule.camera_moved("a", 0.45)
    assert schedule.take(0.5) == ViewTask("a", False, 2)
    assert schedule.take(0.9) is None
    assert schedule.take(0.95) == ViewTask("a", True, 2)
    assert schedule.take(9.0) is None


def test_a_viewer_that_came_is_waited_for_until_it_moves():
    schedule = ViewSchedule(settle_seconds=0.5)
    schedule.add_viewer("a", 0.0)
    assert schedule.take(INITIAL_MOVE_SECONDS - 0.01) is None
    assert schedule.take(INITIAL_MOVE_SECONDS) == ViewTask("a", True, 1)
    schedule.add_viewer("b", 2.0)
    schedule.camera_moved("b", 2.1)
    assert schedule.take(2.1) == ViewTask("b", False, 2)


def test_only_the_last_camera_is_drawn():
    schedule = ViewSchedule()
    for now in range(10):
        schedule.camera_moved("a", float(now))
    assert schedule.take(9.0) == ViewTask("a", False, 10)
    assert schedule.take(9.0) is None


def test_another_mode_is_drawn_at_full_size_unless_the_camera_moves():
    schedule = ViewSchedule(settle_seconds=0.5)
    schedule.content_changed("a", 0.0)
    assert schedule.take(0.0) == ViewTask("a", True, 1)
    schedule.camera_moved("a", 1.0)
    schedule.content_changed("a", 1.1)
    assert schedule.take(1.1) == ViewTask("a", False, 3)
    assert schedule.take(1.5) is None
    assert schedule.take(1.6) == ViewTask("a", True, 3)


def test_viewers_take_turns_and_small_views_come_first():
    schedule = ViewSchedule(settle_seconds=0.0)
    schedule.content_changed("a", 0.0)
    schedule.camera_moved("b", 0.0)
    schedule.camera_moved("c", 0.0)
    assert [schedule.take(0.0).viewer for _ in range(2)] == ["b", "c"]
    schedule.camera_moved("b", 0.0)
    assert schedule.take(0.0) == ViewTask("b", False, 2)
    assert [(task.viewer, task.full) for task in iter(lambda: schedule.take(0.0), None)] == [
        ("a", True), ("c", True), ("b", True),
    ]  # fmt: skip


def test_what_was_asked_for_since_takes_the_place():
    schedule = ViewSchedule(settle_seconds=0.0)
    schedule.content_changed("a", 0.0)
    task = schedule.take(0.0)
    assert task is not None
    assert not schedule.is_superseded(task)
    schedule.camera_moved("a", 0.1)
    assert schedule.is_superseded(task)
    schedule.remove_viewer("a")
    assert schedule.take(9.0) is None
    assert schedule.is_superseded(ViewTask("a", True, 2))


def test_the_worker_draws_until_it_is_stopped_and_gives_up_full_views_alone():
    drawn, started, go_on = [], threading.Event(), threading.Event()

    def draw(viewer, full, superseded):
        started.set()
        assert go_on.wait(30)
        drawn.append((viewer, full, superseded()))
        if len(drawn) == 3:
            completed.set()

    completed = threading.Event()
    worker = Worker(draw, ViewSchedule(settle_seconds=0.0))
    worker.start()
    worker.content_changed("a")
    assert started.wait(30)
    worker.camera_moved("a")
    go_on.set()
    assert completed.wait(30)
    worker.stop()
    assert drawn == [("a", True, True), ("a", False, False), ("a", True, False)]
    worker.camera_moved("a")
    worker.wait()
    assert len(drawn) == 3


def test_an_error_ends_the_worker_and_reaches_who_waits():
    def draw(*_):
        raise ZeroDivisionError("of the network")

    worker = Worker(draw)
    worker.start()
    worker.camera_moved("a")
    with pytest.raises(ZeroDivisionError, match="of the network"):
        worker.wait()
    worker.stop()
