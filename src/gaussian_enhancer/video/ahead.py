"""Concurrent stages of a pipeline."""

from collections import deque
from collections.abc import Generator, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from typing import TypeVar, cast

T = TypeVar("T")
END = object()


def compute_ahead(items: Iterable[T], count: int = 2) -> Iterator[T]:
    """Yield the items of an iterable, which a separate thread computes in advance.

    Rendering, networks and encoders release Python's global interpreter lock. So stages that are chained by this
    function overlap, and the slowest one sets the pace. An error of an item is raised when the item's turn comes. When
    the consumer stops early, the current item is completed and no other is started. Then the iterable is closed if it
    is a generator, and with it the stages before it.

    Args:
        items: the items, which are computed one after the other in one thread.
        count: maximum number of items computed in advance; each stays in memory until it is used.
    """
    source = iter(items)
    compute_next = partial(next, source, END)
    try:
        with ThreadPoolExecutor(1) as executor:
            pending: deque[Future[object]] = deque(executor.submit(compute_next) for _ in range(count))
            try:
                while (item := pending.popleft().result()) is not END:
                    pending.append(executor.submit(compute_next))
                    yield cast(T, item)
            finally:
                for future in pending:
                    future.cancel()
    finally:
        if isinstance(source, Generator):
            source.close()
