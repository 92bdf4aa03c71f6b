"""What the compressed formats share: bit fields to [0, 1], opacity bytes to logits, smallest-three rotations.

Axes: n Gaussians.
"""

import numpy as np
from jaxtyping import Float, Int, UInt, UInt8

SH_CONSTANT = 0.28209479177387814  # Y_0^0 = 1 / (2 sqrt(pi))


def bit_field(packed: UInt[np.ndarray, " n"], shift: int, bits: int) -> Float[np.ndarray, " n"]:
    """The unsigned field of ``bits`` bits above ``shift`` as a fraction of its largest value, in [0, 1]."""
    largest = (1 << bits) - 1
    return ((packed >> np.uint32(shift)) & np.uint32(largest)).astype(np.float64) / largest


def opacity_logits(opacity: UInt8[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Opacity bytes as logits. The ends stand for half a step inwards: a logit of 0 or 1 would be infinite."""
    fraction = np.clip(opacity.astype(np.float64), 0.5, 254.5) / 255.0
    return np.log(fraction / (1.0 - fraction))


def completed_rotation(three: Float[np.ndarray, "n 3"], largest: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n 4"]:
    """Unit quaternions from their three smallest components, in order, and where the largest belongs.

    The largest is the positive root of one minus the others' squares: q and -q are the same rotation.

    Args:
        three: the components that were stored, in the format's own order with the largest left out.
        largest: index of the left-out component, 0 to 3, in that order.
    """
    missing = np.sqrt(np.maximum(0.0, 1.0 - (three**2).sum(1)))
    slots = np.arange(4)[None, :]
    source = slots - (slots > largest[:, None])
    full = np.take_along_axis(three, np.minimum(source, 2), axis=1)
    full[np.arange(len(three)), largest] = missing
    return full
