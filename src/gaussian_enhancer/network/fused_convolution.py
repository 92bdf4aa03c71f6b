"""Convolutions fused with a per-channel scale, a sum and an activation in one pass over memory.

Axes: b batch, c input channels, d output channels, h height, w width.
"""

from typing import Any

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from gaussian_enhancer.network.bfloat16 import can_fuse


def convolution(
    x: Float[Tensor, "b c h w"],
    layer: nn.Conv2d,
    *,
    scale: Float[Tensor, "d 1 1"] | None = None,
    plus: Float[Tensor, "b d _ _"] | None = None,
    relu: bool = False,
) -> Float[Tensor, "b d _ _"]:
    """relu(plus + scale * layer(x)); each part is optional.

    Where `can_fuse` holds, oneDNN does all of this while it writes the result, and the scale is applied to the weights.

    Args:
        x: features.
        layer: the convolution.
        scale: factor of each output channel.
        plus: summand.
        relu: whether to apply a ReLU.
    """
    if _ONEDNN is not None and x.dtype == torch.bfloat16 and can_fuse(x, plus):
        return _convolve_fused(x, layer, scale, plus, relu)
    result: Tensor = layer(x)
    if scale is not None:
        result = scale.to(result.dtype) * result
    if plus is not None:
        result = plus + result
    return F.relu(result) if relu else result


def _convolve_fused(x: Tensor, layer: nn.Conv2d, scale: Tensor | None, plus: Tensor | None, relu: bool) -> Tensor:
    """Compute `convolution` with one oneDNN operation."""
    weight, bias = layer.weight, layer.bias
    if scale is not None:
        weight, bias = weight * scale[:, None], None if bias is None else bias * scale[:, 0, 0]
    values = weight.to(x.dtype), None if bias is None else bias.to(x.dtype)
    shape = layer.padding, layer.stride, layer.dilation, layer.groups
    activation = "relu" if relu else None
    if plus is None:
        result: Tensor = _ONEDNN(x, *values, *shape, activation or "none", [], "")
    else:
        result = _ONEDNN.binary(x, plus, *values, *shape, "add", 1.0, activation, [], "")
    return result


def _operation() -> Any:
    """Torch's entry point to oneDNN's convolutions with post-operations, which its compiler uses; None if missing."""
    if not torch.backends.mkldnn.is_available():
        return None
    try:
        return torch.ops.mkldnn._convolution_pointwise
    except AttributeError:
        return None


_ONEDNN = _operation()
