"""Features of references that serve many targets.

Axes: b batch, r references, c channels, i, j sides of the features.
"""

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.network.network import CachesReferences
from gaussian_enhancer.types import NetworkInput


class ReferenceFeatures:
    """The features of the references that were used last, for references that are not warped.

    They are kept by the reference's name, the size that it is read in, and what is known of it. Names must be unique:
    one cache serves one set of views.

    Args:
        network: what encodes references and takes their features.
        capacity: of how many references features are kept; one target never needs more than 8.
    """

    def __init__(self, network: CachesReferences, capacity: int = 24) -> None:
        self.network, self.capacity = network, max(8, capacity)
        self.kept: OrderedDict[tuple[object, ...], tuple[Tensor, ...]] = OrderedDict()

    def __call__(self, views: NetworkInput, names: Sequence[str]) -> tuple[Float[Tensor, "b r c _ _"], ...] | None:
        """What the network's ``encode`` gives for the views; None where there is no reference.

        Args:
            views: of one target.
            names: of its references.
        """
        if not names:
            return None
        own = [self._features(views, index, name) for index, name in enumerate(names)]
        return tuple(torch.cat(scale, dim=1) for scale in zip(*own, strict=True))

    def _features(self, views: NetworkInput, index: int, name: str) -> tuple[Float[Tensor, "b 1 c _ _"], ...]:
        known = views.reference_renders is not None, views.fine_references is not None
        key = (name, tuple(views.render.shape[-2:]), *known)
        if key not in self.kept:
            self.kept[key] = self.network.encode(_alone(views, index))
        self.kept.move_to_end(key)
        while len(self.kept) > self.capacity:
            self.kept.popitem(last=False)
        return self.kept[key]


def _alone(views: NetworkInput, index: int) -> NetworkInput:
    """The views with one of the references, and of the target only what its size is told by."""

    def one(images: Tensor | None) -> Tensor | None:
        return None if images is None else images[:, index : index + 1]

    return replace(
        views,
        references=views.references[:, index : index + 1],
        visibility=views.visibility[:, index : index + 1],
        reference_renders=one(views.reference_renders),
        fine_references=one(views.fine_references),
        depth=None,
        alpha=None,
        depth_unit=None,
    )
