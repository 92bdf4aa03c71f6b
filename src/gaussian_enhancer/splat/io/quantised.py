"""Decoding for the compressed formats: bit fields to [0, 1], opacity bytes to logits, smallest-three rotations.

Axes: n Gaussians.
"""

import numpy as np
import torch
from jaxtyping import Float, Int, UInt, UInt8


def float_tensor(values: np.ndarray) -> torch.Tensor:
    """The values as a contiguous float32 tensor."""
    return torch.from_numpy(np.ascontiguousarray(values, dtype=np.float32))


def bit_field(packed: UInt[np.ndarray, " n"], shift: int, bits: int) -> Float[np.ndarray, " n"]:
    """The unsigned field of ``bits`` bits above ``shift`` as a fraction of its largest value, in [0, 1]."""
    largest = (1 << bits) - 1
    return ((packed >> np.uint32(shift)) & np.uint32(largest)).astype(np.float64) / largest


def opacity_logits(opacity: UInt8[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Convert opacity bytes to logits; 0 and 255 are moved half a step inwards, where the logit is finite."""
    fraction = np.clip(opacity.astype(np.float64), 0.5, 254.5) / 255.0
    return np.log(fraction / (1.0 - fraction))


def complete_quaternion(three: Float[np.ndarray, "n 3"], largest: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n 4"]:
    """Unit quaternions from their three smallest components, in order, and the index of the largest.

    The largest is the root of one minus the sum of the others' squares. It may be taken as positive, since q and -q are
    the same rotation.

    Args:
        three: the stored components, in the format's order without the largest.
        largest: index of the largest component in that order, 0 to 3.
    """
    largest_values = np.sqrt(np.maximum(0.0, 1.0 - (three**2).sum(1)))
    positions = np.arange(4)[None, :]
    source_columns = positions - (positions > largest[:, None])
    quaternions = np.take_along_axis(three, np.minimum(source_columns, 2), axis=1)
    quaternions[np.arange(len(three)), largest] = largest_values
    return quaternions
