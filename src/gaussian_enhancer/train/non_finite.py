"""Training samples that are not finite: found, named, counted, and left without weight.

Axes: b batch.
"""

import dataclasses
import sys
from collections import Counter
from collections.abc import Iterable, Sequence

import torch
from jaxtyping import Bool
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.train.share import gather
from gaussian_enhancer.types import Batch

BAD_SHARE = 0.01
"""Default share of the samples that may be dropped."""
FEWEST = 1000
"""Crops that are counted at least before their share is judged: one bad crop among the first ten is no tenth of all."""


class NonFiniteFilter:
    """What a training left out.

    Args:
        share: of all crops that may be dropped, in [0, 1].

    Raises:
        InputError: the share is none.
    """

    def __init__(self, share: float) -> None:
        refuse_share(share)
        self.share = share
        self.counts: dict[str, int] = {}

    def add(self, names: Iterable[str]) -> None:
        """Count samples; each is named on standard error the first time."""
        for name in names:
            if name not in self.counts:
                print(f"dropped {name}: it is not finite", file=sys.stderr)
            self.counts[name] = self.counts.get(name, 0) + 1

    def refuse_many(self, seen: int) -> None:
        """Fail where this process has dropped too large a share of its crops.

        Args:
            seen: crops that it had so far.

        Raises:
            InputError: it has.
        """
        _refuse_sample(self.counts, self.share, seen, max(seen, FEWEST))

    def refuse_many_of_all(self, seen: int) -> None:
        """Fail where all processes together have dropped too large a share; all of them have to ask.

        Args:
            seen: crops that they had from first to last.

        Raises:
            InputError: they have.
        """
        _refuse_sample(self.dropped_by_all(), self.share, seen, seen)

    def dropped_by_all(self) -> dict[str, int]:
        """What all processes dropped, by name; all of them have to ask."""
        return dict(sum((Counter(one) for one in gather([self.counts])), Counter()))


def _refuse_sample(counts: dict[str, int], share: float, seen: int, base: int) -> None:
    total = sum(counts.values())
    if total > share * base:
        worst = max(counts, key=lambda name: counts[name])
        received = f"dropped {total} of {seen} crops that are not finite, most often {worst} ({counts[worst]})"
        raise InputError("training", received, f"mend the sample, or allow more than bad_share={share:g}")


def refuse_share(share: float) -> None:
    """Refuse a value that is no share.

    Raises:
        InputError: it is not in [0, 1].
    """
    if not 0 <= share <= 1:
        raise InputError("bad_share", f"is {share}", "give a share from 0 to 1")


def finite_samples(batch: Batch) -> Bool[Tensor, " b"]:
    """Which samples are finite in all that a network reads; depth that is not finite counts as unknown, and is."""
    views = batch.views
    images = {
        f.name: getattr(views, f.name) for f in dataclasses.fields(views) if f.name not in ("depth", "depth_unit")
    }
    sums = [image.flatten(1).float().sum(1) for image in (batch.photo, *images.values()) if image is not None]
    return torch.stack(sums).isfinite().all(0)


def zero_samples(batch: Batch, kept: Bool[Tensor, " b"]) -> Batch:
    """The batch with zeros in place of the samples that are not kept."""

    def zeroed(image: Tensor, finer: int = 1) -> Tensor:
        return torch.where(kept.view(-1, *[1] * (image.dim() - 1)), image, torch.zeros_like(image))

    return dataclasses.replace(batch, views=batch.views.map_images(zeroed), photo=zeroed(batch.photo))


def refuse_bad(bad: Sequence[str], count: int, share: float) -> None:
    """Name prepared samples that are not finite, and fail where they are too many.

    Args:
        bad: each with what is wrong.
        count: of all prepared samples.
        share: of them that may be bad.

    Raises:
        InputError: they are more.
    """
    for one in bad:
        print(f"dropped {one}", file=sys.stderr)
    if len(bad) > share * count:
        received = f"has {len(bad)} samples of {count} that are not finite, first {bad[0]}"
        raise InputError("training data", received, f"mend them, or allow more than bad_share={share:g}")
