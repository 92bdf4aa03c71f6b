"""The interface of enhancement networks.

Axes: b batch, r references, h height, w width, H = scale h, W = scale w.
"""

import abc
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

from jaxtyping import Float
from torch import Tensor, nn

from gaussian_enhancer.types import NetworkInput


class Network(nn.Module, abc.ABC):
    """Maps network inputs to enhanced images.

    Images may have any size, and there may be any number of references, including none. An untrained network returns
    the render: bit-identical at scale 1, bicubically upsampled at larger scales.
    """

    scale: ClassVar[int] = 1
    """Resolution of the enhanced image relative to the render's: 1 or 4."""
    stride: int = 1
    """Tiles start at multiples of this number of render pixels."""
    design: dict[str, Any]
    """The plain values that determine the network: ``network``, which is the class's name, and its parameters."""

    def describe(self, arguments: Mapping[str, Any]) -> None:
        """Set ``design`` to the class's name and the constructor's arguments, with sequences of numbers as lists.

        Args:
            arguments: ``locals()`` of the constructor, before it defines other variables.
        """
        parameters = {name: value for name, value in arguments.items() if name not in ("self", "__class__")}
        plain_values = {
            name: list(value) if isinstance(value, Sequence) and not isinstance(value, str) else value
            for name, value in parameters.items()
        }
        self.design = {"network": type(self).__name__, **plain_values}

    @abc.abstractmethod
    def stages(self, views: NetworkInput) -> tuple[Float[Tensor, "b 3 _ _"], ...]:
        """Enhanced images of all scales of the network, coarse to fine; the last is the result."""

    def forward(self, views: NetworkInput) -> Float[Tensor, "b 3 H W"]:
        """Enhance renders; returns the finest image of `stages`."""
        return self.stages(views)[-1]


class CachesReferences(Network):
    """A network whose reference features do not depend on the target and can be cached.

    If references are not warped to the target, a photo's features are the same for all targets.
    """

    @abc.abstractmethod
    def encode(self, views: NetworkInput) -> tuple[Float[Tensor, "b r _ _ _"], ...]:
        """Features of the references at all scales; the features of a reference depend on that reference only."""

    @abc.abstractmethod
    def stages(
        self, views: NetworkInput, encoded: tuple[Float[Tensor, "b r _ _ _"], ...] | None = None
    ) -> tuple[Float[Tensor, "b 3 _ _"], ...]:
        """Enhanced images of all scales of the network, coarse to fine; the last is the result."""

    def forward(
        self, views: NetworkInput, encoded: tuple[Float[Tensor, "b r _ _ _"], ...] | None = None
    ) -> Float[Tensor, "b 3 H W"]:
        """Enhance renders of any size; returns the finest image of `stages`.

        Args:
            views: input of the network.
            encoded: result of `encode` for these references, in the same order; None computes it.
        """
        return self.stages(views, encoded)[-1]
