"""A cache of the network's features of references.

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
    """Least-recently-used cache of reference features, for references that are not warped.

    The key is the reference's name, the target's size, and whether the reference's render and fine photo are known.
    Names must be unique, so one cache serves one set of views.

    Args:
        network: the network, which encodes references.
        capacity: number of references whose features are kept, at least 8, which is the most that a target needs.
    """

    def __init__(self, network: CachesReferences, capacity: int = 24) -> None:
        self.network, self.capacity = network, max(8, capacity)
        self.entries: OrderedDict[tuple[object, ...], tuple[Tensor, ...]] = OrderedDict()

    def __call__(self, views: NetworkInput, names: Sequence[str]) -> tuple[Float[Tensor, "b r c _ _"], ...] | None:
        """The features of a target's references, as the network's ``encode`` returns them; None without references.

        Args:
            views: the network's input for one target.
            names: names of its references.
        """
        if not names:
            return None
        features = [self._features(views, index, name) for index, name in enumerate(names)]
        return tuple(torch.cat(scale, dim=1) for scale in zip(*features, strict=True))

    def _features(self, views: NetworkInput, index: int, name: str) -> tuple[Float[Tensor, "b 1 c _ _"], ...]:
        size = tuple(views.render.shape[-2:])
        key = name, size, views.reference_renders is not None, views.fine_references is not None
        if key not in self.entries:
            self.entries[key] = self.network.encode(_one_reference(views, index))
        self.entries.move_to_end(key)
        while len(self.entries) > self.capacity:
            self.entries.popitem(last=False)
        return self.entries[key]


def _one_reference(views: NetworkInput, index: int) -> NetworkInput:
    """The network's input with one reference, and without the target's depth and opacity."""

    def select(images: Tensor | None) -> Tensor | None:
        return None if images is None else images[:, index : index + 1]

    return replace(
        views,
        references=views.references[:, index : index + 1],
        visibility=views.visibility[:, index : index + 1],
        reference_renders=select(views.reference_renders),
        fine_references=select(views.fine_references),
        depth=None,
        alpha=None,
        depth_unit=None,
    )
