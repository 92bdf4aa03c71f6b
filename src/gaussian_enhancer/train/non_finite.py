"""Handling of training samples that are not finite: they are detected, reported, counted and given no weight.

Axes: b batch.
"""

import dataclasses
import sys
from collections import Counter
from collections.abc import Iterable, Sequence
from operator import itemgetter

import torch
from jaxtyping import Bool
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.train.share import gather
from gaussian_enhancer.types import Batch

BAD_SHARE = 0.01
"""Default share of the samples that may be dropped."""
MIN_CROPS = 1000
"""Smallest crop count that the share of dropped crops is relative to, so that a single early bad crop is tolerated."""


class NonFiniteFilter:
    """Counts the samples that a training drops, and fails if they are too many.

    Args:
        share: share of all crops that may be dropped, in [0, 1].

    Raises:
        InputError: the share is not in [0, 1].
    """

    def __init__(self, share: float) -> None:
        refuse_share(share)
        self.share = share
        self.counts: dict[str, int] = {}

    def add(self, names: Iterable[str]) -> None:
        """Count dropped samples, and report each on standard error the first time."""
        for name in names:
            if name not in self.counts:
                print(f"dropped {name}: it is not finite", file=sys.stderr)
            self.counts[name] = self.counts.get(name, 0) + 1

    def refuse_many(self, crop_count: int) -> None:
        """Fail if this process has dropped too large a share of its crops.

        Args:
            crop_count: crops that this process has used so far.

        Raises:
            InputError: too large a share was dropped.
        """
        self._refuse(self.counts, crop_count, max(crop_count, MIN_CROPS))

    def refuse_many_of_all(self, crop_count: int) -> None:
        """Fail if all processes together have dropped too large a share. Every process has to call this.

        Args:
            crop_count: crops that all processes used over the whole training.

        Raises:
            InputError: too large a share was dropped.
        """
        self._refuse(self.dropped_by_all(), crop_count, crop_count)

    def dropped_by_all(self) -> dict[str, int]:
        """Number of drops of each sample over all processes. Every process has to call this."""
        return dict(sum((Counter(counts) for counts in gather([self.counts])), Counter()))

    def _refuse(self, dropped: dict[str, int], crop_count: int, divisor: int) -> None:
        """Fail if the number of dropped crops, divided by ``divisor``, is above the permitted share."""
        total = sum(dropped.values())
        if total > self.share * divisor:
            worst, count = max(dropped.items(), key=itemgetter(1))
            received = f"dropped {total} of {crop_count} crops that are not finite, most often {worst} ({count})"
            raise InputError("training", received, f"repair the sample, or set bad_share above {self.share:g}")


def refuse_share(share: float) -> None:
    """Refuse a share outside [0, 1].

    Raises:
        InputError: the share is not in [0, 1].
    """
    if not 0 <= share <= 1:
        raise InputError("bad_share", f"is {share}", "give a share from 0 to 1")


def finite_samples(batch: Batch) -> Bool[Tensor, " b"]:
    """Which samples have finite photos and inputs. Depth is not checked: non-finite values count as unknown."""
    views = batch.views
    images = {
        f.name: getattr(views, f.name) for f in dataclasses.fields(views) if f.name not in ("depth", "depth_unit")
    }
    sums = [image.flatten(1).float().sum(1) for image in (batch.photo, *images.values()) if image is not None]
    return torch.stack(sums).isfinite().all(0)


def zero_samples(batch: Batch, kept: Bool[Tensor, " b"]) -> Batch:
    """The batch with the samples that are not kept set to zero."""

    def zeroed(image: Tensor, finer: int = 1) -> Tensor:
        return torch.where(kept.view(-1, *[1] * (image.dim() - 1)), image, torch.zeros_like(image))

    return dataclasses.replace(batch, views=batch.views.map_images(zeroed), photo=zeroed(batch.photo))


def refuse_bad(bad: Sequence[str], count: int, share: float) -> None:
    """Report prepared samples that are not finite, and fail if they are too many.

    Args:
        bad: a message for each sample that is not finite.
        count: number of all prepared samples.
        share: share of the samples that may be bad.

    Raises:
        InputError: a larger share is bad.
    """
    for message in bad:
        print(f"dropped {message}", file=sys.stderr)
    if len(bad) > share * count:
        received = f"has {len(bad)} samples of {count} that are not finite, first {bad[0]}"
        raise InputError("training data", received, f"repair the samples, or set bad_share above {share:g}")
