"""The views that the simulator degrades, and the protocol of an artefact: a function from views to views.

Axes: b batch, h height, w width.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.types import Movable

ONSET = 0.1
"""Strength up to which `fade_in` fades a change in."""


@dataclass(frozen=True)
class View(Movable):
    """A batch of images with the depth and opacity that a rasteriser would render with them.

    Args:
        image: sRGB in [0, 1].
        depth: z in scene units, 0 where nothing was hit; None where unknown.
        alpha: opacity in [0, 1]; None where unknown.

    Raises:
        InputError: the image is not a non-empty batch of three floating-point channels, or depth or opacity have
            another size.
    """

    image: Float[Tensor, "b 3 h w"]
    depth: Float[Tensor, "b 1 h w"] | None = None
    alpha: Float[Tensor, "b 1 h w"] | None = None

    def __post_init__(self) -> None:
        shape = tuple(self.image.shape)
        if len(shape) != 4 or shape[1] != 3 or 0 in shape:
            raise InputError("image", f"has the shape {shape}", "give (batch, 3, height, width), nothing empty")
        if not self.image.is_floating_point():
            raise InputError("image", f"is {self.image.dtype}", "give floating-point colours in [0, 1]")
        for name, plane in (("depth", self.depth), ("alpha", self.alpha)):
            if plane is not None and tuple(plane.shape) != (shape[0], 1, *shape[2:]):
                received = f"has the shape {tuple(plane.shape)} beside an image of {shape}"
                raise InputError(name, received, "give (batch, 1, height, width) of the image's size")

    def __len__(self) -> int:
        return self.image.shape[0]

    def __getitem__(self, index: Int64[Tensor, " n"]) -> "View":
        """Select samples of the batch by index."""
        depth, alpha = (None if plane is None else plane[index] for plane in (self.depth, self.alpha))
        return View(self.image[index], depth, alpha)

    def with_samples(self, index: Int64[Tensor, " n"], samples: "View") -> "View":
        """Replace the indexed samples of the batch. Depth or opacity stays as it is where the new samples have none."""

        def overwrite(plane: Tensor | None, new: Tensor | None) -> Tensor | None:
            return plane if plane is None or new is None else plane.index_copy(0, index, new.to(plane.dtype))

        image = self.image.index_copy(0, index, samples.image.to(self.image.dtype))
        return View(image, overwrite(self.depth, samples.depth), overwrite(self.alpha, samples.alpha))


@runtime_checkable
class Artefact(Protocol):
    """One kind of artefact, as a pure function.

    Strength 0 returns a sample unchanged. With the same generators, a larger strength gives a larger change. All random
    numbers of a sample come from its own generator, so that its result does not depend on the rest of the batch.
    """

    def __call__(self, view: View, strength: Float[Tensor, " b"], generators: Sequence[torch.Generator]) -> View:
        """Degrade views.

        Args:
            view: views to degrade.
            strength: strength for each sample, from 0 (no change) to 1 (the worst case in splat renders).
            generators: one source of randomness for each sample, on the CPU.
        """
        ...


def per_sample(strength: Float[Tensor, " b"]) -> Float[Tensor, "b 1 1 1"]:
    """Reshape strengths for broadcasting with images."""
    return strength[:, None, None, None]


def fade_in(view: View, image: Float[Tensor, "b 3 h w"], strength: Float[Tensor, " b"]) -> View:
    """Change the image to a degraded one: in proportion to the strength up to 0.1 (`ONSET`), and fully from there on.

    Args:
        view: views to degrade; depth and opacity stay unchanged.
        image: the degraded image.
        strength: strength for each sample, [0, 1].
    """
    fade = per_sample((strength / ONSET).clamp(max=1))
    return replace(view, image=view.image + fade * (image - view.image))
