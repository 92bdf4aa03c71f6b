"""Conditions for fused inference in bfloat16, and access of kernels to features.

Axes: b batch, c channels, h height, w width.
"""

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.compiled import kernel_lock

__all__ = ["can_fuse", "can_use_kernels", "empty_features", "kernel_lock", "kernel_words", "plane"]

SUPPORTED_DTYPES = (torch.float32, torch.bfloat16)


def can_use_kernels(*images: Tensor | None) -> bool:
    """Whether compiled kernels may replace PyTorch's operations.

    This requires plain tensors on the CPU, no gradient, and nothing that observes operations (compilers, tracers,
    operation counters).

    Args:
        images: inputs of the computation; None is ignored.
    """
    tensors = [image for image in images if image is not None]
    return (
        all(type(x) is Tensor and x.device.type == "cpu" and x.dtype in SUPPORTED_DTYPES for x in tensors)
        and not (torch.is_grad_enabled() and any(x.requires_grad for x in tensors))
        and not torch.compiler.is_compiling()
        and not torch.jit.is_tracing()
        and torch._C._len_torch_dispatch_stack() == 0
    )


def can_fuse(*images: Tensor | None) -> bool:
    """Whether fused operations may be used: inference in bfloat16 autocast without gradients, and `can_use_kernels`.

    Args:
        images: inputs of the computation; None is ignored.
    """
    return (
        not torch.is_grad_enabled()
        and torch.is_autocast_enabled("cpu")
        and torch.get_autocast_dtype("cpu") == torch.bfloat16
        and can_use_kernels(*images)
    )


def empty_features(batch: int, channels: int, height: int, width: int) -> Float[Tensor, "b c h w"]:
    """Uninitialised features in bfloat16 and channels-last memory."""
    return torch.empty(batch, height, width, channels, dtype=torch.bfloat16).permute(0, 3, 1, 2)


def kernel_words(features: Float[Tensor, "b c h w"], word: type[np.unsignedinteger] = np.uint16) -> np.ndarray:
    """View of bfloat16 features for kernels: (b, h, w, c), without a copy if memory is channels-last.

    Args:
        features: features in bfloat16.
        word: type as which the bits are viewed; 32 bits hold two channels.
    """
    return features.permute(0, 2, 3, 1).contiguous().view(torch.int16).numpy().view(word)


def plane(image: Tensor) -> np.ndarray:
    """View of an image for kernels, in single precision; without a copy if it is contiguous and float32."""
    return image.float().contiguous().numpy()
