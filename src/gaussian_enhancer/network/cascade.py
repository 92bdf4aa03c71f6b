"""Cascade: enhancement at the render's resolution, then super-resolution by 4.

Axes: b batch, h height, w width, H = 4 h, W = 4 w.
"""

import dataclasses
import math

from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.network.colour_clamping import check_window, clamp_to_references
from gaussian_enhancer.network.network import Network
from gaussian_enhancer.types import NetworkInput, single_precision


class Cascade(Network):
    """Two networks, of which the second receives the first network's output in place of the render.

    Super-resolution is trained on few scenes, since photos 4 times as fine are scarce. Errors at the render's own
    resolution are corrected by a network trained on many scenes. Both are trained together. Untrained, the cascade
    returns the upsampled render.

    Args:
        first: network that enhances at the render's resolution.
        second: network that enhances to 4 times the resolution.
        colour_clamping: side of the window that limits the colours of the first network's output
            (`clamp_to_references`); 0 sets no limit, which is required if references are not warped.

    Raises:
        InputError: the networks' scales are not 1 and 4, or the window has no centre.
    """

    scale = 4

    def __init__(self, first: Network, second: Network, colour_clamping: int = 3) -> None:
        super().__init__()
        if (first.scale, second.scale) != (1, self.scale):
            received = f"is made of networks that enlarge {first.scale} and {second.scale} times"
            raise InputError(
                "fusion", received, f"give one that keeps the size, and one that enlarges {self.scale} times"
            )
        if colour_clamping:
            check_window(colour_clamping)
        self.design = {
            "network": type(self).__name__,
            "first": first.design,
            "second": second.design,
            "colour_clamping": colour_clamping,
        }
        self.first, self.second, self.colour_clamping = first, second, colour_clamping
        self.stride = math.lcm(first.stride, second.stride)

    def stages(self, views: NetworkInput) -> tuple[Float[Tensor, "b 3 _ _"], ...]:
        """The first network's image, then the images of all scales of the second.

        Images are in single precision between the networks, since the gradient of clamping depends on the side of a
        limit on which a colour lies.
        """
        dtype = views.render.dtype
        views = views.map_images(lambda image, _: single_precision(image))
        enhanced = self.first(dataclasses.replace(views, fine_references=None))
        if self.colour_clamping:
            enhanced = clamp_to_references(enhanced, views, self.colour_clamping, clamp_unseen=True)
        finer = self.second.stages(dataclasses.replace(views, render=enhanced))
        return tuple(image.to(dtype) for image in (enhanced, *finer))
