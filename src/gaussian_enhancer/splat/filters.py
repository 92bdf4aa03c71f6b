"""Mip-Splatting's 3D low-pass filter, whose size follows from how finely the training photos sample each Gaussian.

Axes: n Gaussians.
"""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.types import Camera

FILTER_VARIANCE = 0.2
SCREEN_MARGIN = 0.15


@torch.no_grad()
def filter_size(means: Float[Tensor, "n 3"], cameras: Sequence[Camera], *, near: float = 0.01) -> Float[Tensor, " n"]:
    """Standard deviation of the 3D filter that removes detail finer than the finest sampling by any photo.

    f = sqrt(0.2) min z / focal over the cameras that see the Gaussian (Yu et al., Mip-Splatting, CVPR 2024, equations 7
    to 9, with their factor 0.2). A camera sees a Gaussian whose centre lies beyond z = near and projects into its image
    enlarged by 15% on every side (the margin of the authors' implementation). Of a camera's two focal lengths the
    longer counts, since it samples more finely. A Gaussian that no camera sees gets the largest size of the others, as
    in the authors' implementation.

    Args:
        means: centres in the world.
        cameras: the cameras that the splat is fitted to, on any device.
        near: smallest z in scene units at which a camera sees a Gaussian.

    Raises:
        InputError: if there are Gaussians but no camera sees any of them.
    """
    spacing = means.new_full((len(means),), torch.inf)
    for camera in cameras:
        points = means @ camera.rotation.to(means).T + camera.world_to_camera[:3, 3].to(means)
        z = points[:, 2]
        projected = points @ camera.K.to(means).T
        position = projected[:, :2] / projected[:, 2:] / means.new_tensor((camera.width, camera.height))
        inside = (position > -SCREEN_MARGIN) & (position < 1 + SCREEN_MARGIN)
        focal = camera.K.diagonal()[:2].max().to(means)
        spacing = torch.where((z > near) & inside.all(-1), torch.minimum(spacing, z / focal), spacing)
    finite = spacing.isfinite()
    if len(means) and not finite.any():
        received = f"{len(cameras)} see none of the {len(means)} Gaussians"
        raise InputError("training cameras", received, "give the cameras that the splat was fitted to")
    largest = spacing[finite].max() if len(means) else 0.0
    return FILTER_VARIANCE**0.5 * torch.where(finite, spacing, largest)


def apply_3d_filter(
    scales: Float[Tensor, "n 3"], opacities: Float[Tensor, " n"], smoothing: Float[Tensor, " n"]
) -> tuple[Float[Tensor, "n 3"], Float[Tensor, " n"]]:
    """Convolve Gaussians with the 3D filter: s -> sqrt(s^2 + f^2), opacity *= prod s / sqrt(s^2 + f^2).

    Source: Yu et al., Mip-Splatting, CVPR 2024, equation 9. The factor is a product of ratios, so that the
    determinants of small Gaussians do not underflow.

    Args:
        scales: standard deviations, world units.
        opacities: peak opacities in [0, 1].
        smoothing: the filter's standard deviation f, world units.
    """
    filtered_scales = torch.sqrt(scales.square() + smoothing[:, None].square())
    return filtered_scales, opacities * (scales / filtered_scales).prod(-1)
