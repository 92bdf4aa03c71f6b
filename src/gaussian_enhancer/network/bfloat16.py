"""Conditions for fused inference in bfloat16, and how kernels access features.

Axes: b batch, c channels, h height, w width.
"""

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.splat.compiled import kernel_lock

__all__ = ["can_fuse", "can_use_kernels", "empty_features", "kernel_lock", "kernel_words", "plane"]

PLAIN = (torch.float32, torch.bfloat16)


def can_use_kernels(*images: Tensor | None) -> bool:
    """Whether compiled kernels may take the place of PyTorch's operations.

    They need plain tensors on the CPU, no gradient, and that nothing observes operations: compilers, tracers, counters.

    Args:
        images: what is computed on; None is left out.
    """
    tensors = [image for image in images if image is not None]
    return (
        all(type(x) is Tensor and x.device.type == "cpu" and x.dtype in PLAIN for x in tensors)
        and not (torch.is_grad_enabled() and any(x.requires_grad for x in tensors))
        and not torch.compiler.is_compiling()
        and not torch.jit.is_tracing()
        and torch._C._len_torch_dispatch_stack() == 0
    )


def can_fuse(*images: Tensor | None) -> bool:
    """Whether inference is in bfloat16 (by autocast, without gradients) and `can_use_kernels`: fused ways may be taken.

    Args:
        images: what is computed on; None is left out.
    """
    return (
        not torch.is_grad_enabled()
        and torch.is_autocast_enabled("cpu")
        and torch.get_autocast_dtype("cpu") == torch.bfloat16
        and can_use_kernels(*images)
    )


def empty_features(batch: int, channels: int, height: int, width: int) -> Float[Tensor, "b c h w"]:
    """Features in bfloat16 and channels-last memory, whose values are not set."""
    return torch.empty(batch, height, width, channels, dtype=torch.bfloat16).permute(0, 3, 1, 2)


def kernel_words(features: Float[Tensor, "b c h w"], word: type[np.unsignedinteger] = np.uint16) -> np.ndarray:
    """Features in bfloat16 as kernels read and write them: (b, h, w, c), without a copy where memory is channels-last.

    Args:
        features: in bfloat16.
        word: what the bits are seen as; 32 bits hold two channels.
    """
    return features.permute(0, 2, 3, 1).contiguous().view(torch.int16).numpy().view(word)


def plane(image: Tensor) -> np.ndarray:
    """An image as kernels read and write it, in single precision, without a copy where it is that and contiguous."""
    return image.float().contiguous().numpy()
