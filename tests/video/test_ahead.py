import threading

import pytest

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.video.ahead import compute_ahead


def test_items_come_in_their_order_from_another_thread():
    threads = set()

    def items():
        for index in range(7):
            threads.add(threading.get_ident())
            yield index

    assert list(compute_ahead(items(), 3)) == list(range(7))
    assert len(threads) == 1
    assert threading.get_ident() not in threads


def test_the_next_item_is_made_while_one_is_in_use():
    computed = threading.Event()

    def items():
        yield 0
        computed.set()
        yield 1

    stages = compute_ahead(items(), 1)
    assert next(stages) == 0
    assert computed.wait(60)
    assert list(stages) == [1]


def test_no_more_is_made_than_asked_for_and_none_after_an_early_end():
    started = []

    def items():
        for index in range(100):
            started.append(index)
            yield index

    stages = compute_ahead(items(), 2)
    assert next(stages) == 0
    stages.close()
    assert len(started) <= 3


def test_an_error_comes_in_its_turn():
    def items():
        yield 0
        raise InputError("frame 1", "is damaged", "delete it")

    stages = compute_ahead(items(), 3)
    assert next(stages) == 0
    with pytest.raises(InputError, match="frame 1"):
        next(stages)


def test_stages_can_be_chained():
    assert list(compute_ahead((2 * item for item in compute_ahead(range(5))), 1)) == [0, 2, 4, 6, 8]


def test_what_comes_before_ends_with_it():
    ended = []

    def items():
        try:
            yield from range(100)
        finally:
            ended.append(threading.get_ident())

    stages = compute_ahead((item for item in compute_ahead(items())), 1)
    assert next(stages) == 0
    stages.close()
    assert ended == [threading.get_ident()]


def test_ctrl_c_in_the_consumer_ends_every_stage():
    started, ended = [], threading.Event()

    def items():
        try:
            for index in range(100):
                started.append(index)
                yield index
        finally:
            ended.set()

    with pytest.raises(KeyboardInterrupt):
        stopped(compute_ahead(item for item in compute_ahead(items())))
    assert ended.is_set()
    assert len(started) < 10


def stopped(items):
    """Take one item and be interrupted while another is awaited."""
    next(items)
    items.throw(KeyboardInterrupt)
