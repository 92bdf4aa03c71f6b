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
    """Maps views to enhanced images.

    Sides of any length and any number of references, none included, are taken. Untrained, it returns the render: bit
    for bit at scale 1, bicubically enlarged above it.
    """

    scale: ClassVar[int] = 1
    """How many times finer the enhanced image is than the render: 1 or 4."""
    stride: int = 1
    """Tiles start at multiples of this many pixels of the render."""
    design: dict[str, Any]
    """The plain values that it is built from: ``network``, the class's name, and its parameters."""

    def describe(self, arguments: Mapping[str, Any]) -> None:
        """Set ``design`` to the class's name and the constructor's arguments, sequences of numbers as lists.

        Args:
            arguments: ``locals()`` of the constructor, before it binds anything else.
        """
        arguments_used = {name: value for name, value in arguments.items() if name not in ("self", "__class__")}
        plain = {
            name: list(value) if isinstance(value, Sequence) and not isinstance(value, str) else value
            for name, value in arguments_used.items()
        }
        self.design = {"network": type(self).__name__, **plain}

    @abc.abstractmethod
    def stages(self, views: NetworkInput) -> tuple[Float[Tensor, "b 3 _ _"], ...]:
        """Enhanced images of all the network's scales, coarse to fine; the last is the result."""

    def forward(self, views: NetworkInput) -> Float[Tensor, "b 3 H W"]:
        """Enhance."""
        return self.stages(views)[-1]


class CachesReferences(Network):
    """A network whose reference features do not depend on the target and can be cached.

    Where references are not warped to the target, a photo's features are the same for every target.
    """

    @abc.abstractmethod
    def encode(self, views: NetworkInput) -> tuple[Float[Tensor, "b r _ _ _"], ...]:
        """Features of the references at all scales; each depends on its reference alone."""

    @abc.abstractmethod
    def stages(
        self, views: NetworkInput, encoded: tuple[Float[Tensor, "b r _ _ _"], ...] | None = None
    ) -> tuple[Float[Tensor, "b 3 _ _"], ...]:
        """Enhanced images of all the network's scales, coarse to fine; the last is the result."""

    def forward(
        self, views: NetworkInput, encoded: tuple[Float[Tensor, "b r _ _ _"], ...] | None = None
    ) -> Float[Tensor, "b 3 H W"]:
        """Enhance renders of any size.

        Args:
            views: what is known of the targets.
            encoded: what `encode` gave for these references, in this order.
        """
        return self.stages(views, encoded)[-1]
