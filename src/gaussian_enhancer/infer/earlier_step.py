"""Combines the enhanced views of a fit with those of an earlier step of the same fit.

An earlier step errs differently where the photos leave a fit undetermined, and a long fit often errs more there, since
it has adapted to its own photos. Its enhanced view is used where both differ and the references decide between them.

Axes: h height, w width.
"""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

DIFFERENCE = 0.04
"""Root mean squared difference of the enhanced views at which half of the earlier one's weight is used."""
DIFFERENCE_WINDOW = 13
"""Side in pixels of the windows over which that difference is averaged."""
ERROR_WINDOW = 41
"""Side in pixels of the windows over which the renders' errors, and their difference, are averaged."""
LEAST_ERROR = 1e-4
"""Added to mean squared errors, so that renders that enhancement hardly changes have equal weights."""
LEAST_DIFFERENCE = 1e-6
"""Added to mean squared differences, so that equal renders count as undecided."""
UNDECIDED, DECIDED = 0.8, 0.5
"""Shares of the renders' squared difference left after enhancement, at which none and all of the weight is used."""


def combine_with_earlier(
    enhanced: Float[Tensor, "3 h w"],
    earlier: Float[Tensor, "3 h w"],
    render: Float[Tensor, "3 h w"],
    earlier_render: Float[Tensor, "3 h w"],
) -> Float[Tensor, "3 h w"]:
    """The enhanced view, moved towards that of an earlier step by a share that is the product of three factors.

    - The weight of the earlier step, (e1 E1)^2 / ((e1 E1)^2 + (e2 E2)^2). Enhancement changes a render where photos
      contradict it, so e, the estimated squared error of a render around a pixel, is its mean squared difference from
      the mean of both enhanced views. E is that of the whole view.
    - d^2 / (d^2 + `DIFFERENCE`^2), where d^2 is the mean squared difference of the enhanced views around a pixel.
      Averaging blurs detail, which is worth it only where they differ clearly.
    - Evidence: 1 where enhancement removes at least half of the renders' squared difference, and 0 where it removes at
      most a fifth, since no photo decides there.

    Args:
        enhanced: enhanced view of the last step.
        earlier: enhanced view of the earlier step.
        render: render of the last step.
        earlier_render: render of the earlier step.
    """
    middle = (enhanced + earlier) / 2
    first, second = (_weighted_error(image, middle) for image in (render, earlier_render))
    difference = _squared_difference(enhanced, earlier)
    before, after = (
        _window_mean(squared, ERROR_WINDOW) + LEAST_DIFFERENCE
        for squared in (_squared_difference(render, earlier_render), difference)
    )
    evidence = ((UNDECIDED - after / before) / (UNDECIDED - DECIDED)).clamp(0, 1)
    nearby = _window_mean(difference, DIFFERENCE_WINDOW)
    share = first / (first + second) * nearby / (nearby + DIFFERENCE**2) * evidence
    return torch.lerp(enhanced, earlier, share.expand_as(enhanced))


def _weighted_error(render: Float[Tensor, "3 h w"], truth: Float[Tensor, "3 h w"]) -> Float[Tensor, "1 h w"]:
    """The square of a render's estimated squared error around each pixel times that of the view."""
    error = _squared_difference(render, truth)
    return ((_window_mean(error, ERROR_WINDOW) + LEAST_ERROR) * (error.mean() + LEAST_ERROR)).square()


def _squared_difference(image: Float[Tensor, "3 h w"], other: Float[Tensor, "3 h w"]) -> Float[Tensor, "1 h w"]:
    """Squared difference, averaged over the colour channels."""
    return (image - other).square().mean(0, keepdim=True)


def _window_mean(values: Float[Tensor, "1 h w"], side: int) -> Float[Tensor, "1 h w"]:
    """Mean over a square window around each pixel, inside the image."""
    half = side // 2
    rows = F.avg_pool2d(values, (side, 1), 1, (half, 0), count_include_pad=False)
    return F.avg_pool2d(rows, (1, side), 1, (0, half), count_include_pad=False)
