"""Split of a capture into training and held-out photos, and choice of some of many views.

By the convention of the field, every 8th photo sorted by name is a test view (``idx % 8 == 0``; LLFF, 3DGS's
``dataset_readers.py``). Sparse fits keep every n-th of the remaining photos.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.typed import check_fields

Indices = tuple[int, ...]
T = TypeVar("T")


@dataclass(frozen=True)
class Split:
    """How a capture's photos are divided.

    Args:
        test_every: hold out every n-th photo; 0 holds none out. It has no effect where the capture's files state their
            own split and ``own`` is true.
        test_offset: index of the first held-out photo, in [0, test_every).
        train_every: keep every n-th training photo only (a sparse fit); 1 keeps all.
        unused_as_test: add the photos removed by ``train_every`` to the test views, as is done to make training pairs;
            otherwise they belong to neither split.
        own: use the split that the capture's files state, if any.

    Raises:
        InputError: a number is out of range.
    """

    test_every: int = 8
    test_offset: int = 0
    train_every: int = 1
    unused_as_test: bool = False
    own: bool = True

    def __post_init__(self) -> None:
        check_fields(self, "split.")
        if self.test_every < 0 or self.test_every == 1:
            raise InputError("split.test_every", f"is {self.test_every}", "give 0 (hold none out) or at least 2")
        if not 0 <= self.test_offset < max(self.test_every, 1):
            rule = f"give a number from 0 to {max(self.test_every, 1) - 1}"
            raise InputError("split.test_offset", f"is {self.test_offset}", rule)
        if self.train_every < 1:
            raise InputError("split.train_every", f"is {self.train_every}", "give at least 1")

    def __call__(self, count: int, file_split: tuple[Indices, Indices] | None = None) -> tuple[Indices, Indices]:
        """Training indices and test indices.

        Args:
            count: number of photos, which are sorted by name.
            file_split: training and test indices stated by the capture's files; None if they state none.

        Raises:
            InputError: no training photo remains.
        """
        train, test = (
            file_split if file_split is not None and self.own else every_nth(count, self.test_every, self.test_offset)
        )
        train, test = thin_training(train, test, self.train_every, self.unused_as_test)
        if not train:
            raise InputError("split", f"leaves none of {count} photos to fit to", "hold fewer photos out")
        return train, test


def every_nth(count: int, test_every: int = 8, test_offset: int = 0) -> tuple[Indices, Indices]:
    """Training and test indices; photo ``i`` is a test view if ``i % test_every == test_offset``."""
    if test_every == 0:
        return tuple(range(count)), ()
    test = tuple(range(test_offset, count, test_every))
    return tuple(i for i in range(count) if i % test_every != test_offset), test


def thin_training(
    train: Indices, test: Indices, train_every: int, unused_as_test: bool = False
) -> tuple[Indices, Indices]:
    """Keep every ``train_every``-th training index; move the others to the test indices or drop them."""
    kept = train[::train_every]
    if not unused_as_test:
        return kept, test
    return kept, tuple(sorted({*test, *train} - {*kept}))


def evenly_spaced(items: Sequence[T], count: int) -> tuple[T, ...]:
    """At most a number of items, evenly spaced from the first one on.

    Args:
        items: for instance views, in the order of the capture.
        count: largest number of items.
    """
    count = min(count, len(items))
    return tuple(items[i * len(items) // count] for i in range(count))
