"""The three rendering methods of this package (3DGS, 2DGS, Mip-Splatting), as plain values.

A method determines a Gaussian's footprint in the image. Sorting, blending and thresholds are the same for all methods.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.types import Gaussians


@dataclass(frozen=True)
class ThreeDGS:
    """Ellipsoids projected by the local affine approximation: cov2d = J W S W^T J^T + dilation I.

    Source: Kerbl et al., 3D Gaussian Splatting, SIGGRAPH 2023; Zwicker et al., EWA Splatting, 2002.

    Args:
        dilation: variance in square pixels that is added to every footprint, so that none falls between pixels.
    """

    name: ClassVar[str] = "3dgs"
    dilation: float = 0.3


@dataclass(frozen=True)
class TwoDGS:
    """Flat disks intersected exactly by each pixel's ray, with a screen-space low-pass of half a pixel.

    Source: Huang et al., 2D Gaussian Splatting, SIGGRAPH 2024.
    """

    name: ClassVar[str] = "2dgs"


@dataclass(frozen=True)
class MipSplatting:
    """Ellipsoids smoothed in 3D by the sampling limit and in 2D by a pixel-sized filter that preserves energy.

    3D: scales -> sqrt(s^2 + f^2) and opacity *= prod(s / sqrt(s^2 + f^2)), f the Gaussians' ``smoothing``.
    2D: cov2d + dilation I and opacity *= sqrt(det(cov2d) / det(cov2d + dilation I)).
    Source: Yu et al., Mip-Splatting, CVPR 2024, equations 9 and 10.

    Args:
        dilation: variance of the 2D filter in square pixels.
    """

    name: ClassVar[str] = "mip_splatting"
    dilation: float = 0.1


Method = ThreeDGS | TwoDGS | MipSplatting

METHODS: Mapping[str, Method] = {method.name: method for method in (ThreeDGS(), TwoDGS(), MipSplatting())}
"""The methods with their usual parameters, by name."""


def check_axes(gaussians: Gaussians, method: Method) -> None:
    """Refuse ellipsoids for a method that draws disks, and disks for one that draws ellipsoids.

    Raises:
        InputError: the number of scale axes does not match the method.
    """
    required_axes = 2 if isinstance(method, TwoDGS) else 3
    scale_axes = gaussians.log_scales.shape[1]
    if scale_axes != required_axes:
        remedy = f"use one with {required_axes}, or another method"
        raise InputError(f"splat for method {method.name}", f"has {scale_axes} scale axes", remedy)


def choose_method(name: str, gaussians: Gaussians) -> Method:
    """Return the rendering method with a given name.

    Args:
        name: "3dgs", "2dgs", "mip_splatting", or "auto": disks are drawn by 2DGS, ellipsoids with a 3D filter by
            Mip-Splatting, other ellipsoids by 3DGS.
        gaussians: the splat.

    Raises:
        InputError: the name is unknown.
    """
    disks = gaussians.log_scales.shape[1] == 2
    automatic = TwoDGS() if disks else ThreeDGS() if gaussians.smoothing is None else MipSplatting()
    methods: dict[str, Method] = {"auto": automatic, **METHODS}
    if name not in methods:
        raise InputError("method", f"is {name!r}", f"choose {', '.join(methods)}")
    return methods[name]
