"""Stages of a pipeline that work at the same time."""

from collections import deque
from collections.abc import Generator, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar, cast

T = TypeVar("T")
END = object()


def ahead(items: Iterable[T], count: int = 2) -> Iterator[T]:
    """Yield the items of an iterable, which a thread of its own makes while earlier ones are in use.

    Rendering, networks and encoders release Python's lock, so that stages that are chained by this overlap, and the
    slowest one sets the pace. An error that an item raises is raised here in its turn. When the consumer stops early,
    the item in work is completed and no other is begun; then a generator of items is closed, and with it the stages
    before it.

    Args:
        items: made one after the other, in one thread.
        count: how many are made ahead at most; each stays in memory until it is used.
    """
    source = iter(items)

    def made() -> object:
        return next(source, END)

    try:
        with ThreadPoolExecutor(1) as executor:
            waiting: deque[Future[object]] = deque(executor.submit(made) for _ in range(count))
            try:
                while (item := waiting.popleft().result()) is not END:
                    waiting.append(executor.submit(made))
                    yield cast(T, item)
            finally:
                for one in waiting:
                    one.cancel()
    finally:
        if isinstance(source, Generator):
            source.close()
