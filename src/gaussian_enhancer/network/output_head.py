"""Output head: converts decoded values to the enhanced image.

Axes: b batch, r references, h height, w width, i = h / 2, j = w / 2.
"""

from dataclasses import dataclass
from typing import ClassVar, Protocol, runtime_checkable

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.network.bfloat16 import can_fuse, kernel_lock, plane
from gaussian_enhancer.network.fuse import weighted_sum
from gaussian_enhancer.types import NetworkInput

OUTPUTS = 6


@runtime_checkable
class Output(Protocol):
    """A frozen dataclass that selects the output head. If all decoded values are zero, the result is the render."""

    @property
    def outputs(self) -> int:
        """Number of decoded channels."""
        ...

    def __call__(
        self, decoded: Float[Tensor, "b o h w"], views: NetworkInput, trust: Float[Tensor, "b r 1 i j"]
    ) -> Float[Tensor, "b 3 h w"]:
        """Compose the image; see `compose` for the arguments."""
        ...


def compose(
    decoded: Float[Tensor, "b 6 h w"], views: NetworkInput, trust: Float[Tensor, "b r 1 i j"]
) -> Float[Tensor, "b 3 h w"]:
    """Render + confidence x residual + sum_i trust_i (g (photo_i - render) + k (photo_i - render_i)).

    render_i is the splat's own render of reference i's view. The last term adds the splat's error as observed from a
    training camera. In contrast to the second term, which copies the photo's pixels, it tolerates a difference in
    exposure and, on smooth surfaces, misalignment. If all decoded values are zero, the result is the render, bit for
    bit.

    Args:
        decoded: residual (3), confidence before its sigmoid, g and k.
        views: render and references.
        trust: weight of each reference, at half resolution.
    """
    render, visibility = views.render, views.visibility
    images = decoded, render, views.references, visibility, views.reference_renders, trust
    if decoded.dtype == torch.bfloat16 and visibility.shape[1] and can_fuse(*images):
        return _compose_compiled(decoded, views, trust)
    decoded = decoded.to(render.dtype)
    enhanced = render + torch.sigmoid(decoded[:, 3:4]) * decoded[:, :3]
    if views.references.shape[1] == 0:
        return enhanced
    weight = F.interpolate(trust.flatten(0, 1).to(render.dtype), scale_factor=2, mode="bilinear")
    weight = weight.unflatten(0, visibility.shape[:2]) * (visibility > 0)
    photos = weighted_sum(weight, views.references)  # g and k are the same for all references
    enhanced = enhanced + decoded[:, 4:5] * torch.addcmul(photos, weight.sum(1), render, value=-1)
    if views.reference_renders is None:
        return enhanced
    residuals = photos
    for i in range(visibility.shape[1]):
        residuals = torch.addcmul(residuals, weight[:, i], views.reference_renders[:, i], value=-1)
    return enhanced + decoded[:, 5:6] * residuals


def _compose_compiled(
    decoded: Float[Tensor, "b 6 h w"], views: NetworkInput, trust: Float[Tensor, "b r 1 i j"]
) -> Float[Tensor, "b 3 h w"]:
    """Compiled version of `compose` in one pass over memory, where `can_fuse` holds and there is a reference."""
    from gaussian_enhancer.network.bfloat16_kernels import compose as kernel

    result = torch.empty_like(views.render, memory_format=torch.contiguous_format)
    has_renders = views.reference_renders is not None
    renders = views.references if views.reference_renders is None else views.reference_renders
    words = decoded.contiguous().view(torch.int16).numpy().view(np.uint16)
    with kernel_lock:
        for b, image in enumerate(result):
            inputs = (plane(images[b]) for images in (views.render, views.references, renders, views.visibility))
            kernel(words[b], *inputs, plane(trust[b, :, 0]), np.float32(has_renders), image.numpy())
    return result


@dataclass(frozen=True)
class Gated:
    """Choice of an output with confidence and with pixels of the references; see `compose`."""

    outputs: ClassVar[int] = OUTPUTS

    def __call__(
        self, decoded: Float[Tensor, "b 6 h w"], views: NetworkInput, trust: Float[Tensor, "b r 1 i j"]
    ) -> Float[Tensor, "b 3 h w"]:
        """Compose the image."""
        return compose(decoded, views, trust)


@dataclass(frozen=True)
class Residual:
    """Choice of an output with the residual only, render + residual, as in the paper."""

    outputs: ClassVar[int] = 3

    def __call__(
        self, decoded: Float[Tensor, "b 3 h w"], views: NetworkInput, trust: Float[Tensor, "b r 1 i j"]
    ) -> Float[Tensor, "b 3 h w"]:
        """Add the decoded residual."""
        return views.render + decoded.to(views.render.dtype)
