"""Cases of extreme splats: needles, singular covariances, disks seen edge-on, near plane, opacity, focal lengths.

All are rendered by `splat.render.render` at 24x32 pixels (height by width).

Axes: n Gaussians.
"""

import math
from collections.abc import Callable, Iterator
from functools import partial

import torch
from torch import Tensor, nn

from ablations.stability.case import PRECISIONS, Case, Problem, Tolerance
from gaussian_enhancer.splat.methods import METHODS, Method, MipSplatting, TwoDGS
from gaussian_enhancer.splat.render import render
from gaussian_enhancer.types import Camera, Gaussians, identity_camera

TOLERANCE: Tolerance = {precision.name: (0.01, 0.02) for precision in PRECISIONS}
WHY = "a share that lies at the threshold 1/255 may be drawn in one precision and left out in another"

HEIGHT, WIDTH, COUNT = 24, 32, 12
WITH_DEPTH = ("harmonics", "log_scale_90", "log_scale_-1e30")


def cases() -> Iterator[Case]:
    """The cases of this family, for every splatting method that they apply to."""
    for method, splat_method in METHODS.items():
        disks = isinstance(splat_method, TwoDGS)
        kinds = {
            "ordinary": "nothing; what the others are to be compared with",
            "needles": "one axis 10^6 times as long as the others",
            "near_singular": "covariances on the image with condition numbers over 10^12",
            "near_plane": "centres at the near plane, a hair before and behind it, at and behind the camera",
            "behind": "all centres behind the camera",
            "opaque": "60 layers of opacity 1",
            "one_place": "all Gaussians in one place, equal depths",
            "not_finite": "one centre NaN, one scale infinite: as if they were not there",
            "harmonics": "spherical harmonics NaN, infinite and 1e20: as if they were not there; depth is held as well",
            "log_scale_90": "a log scale of 90: as if it were not there; depth is held as well",
            "log_scale_-1e30": "a log scale of -10^30: as if it were not there; depth is held as well",
            **({"edge_on": "disks seen exactly from the side, and nearly"} if disks else {}),
        }
        for kind, about in kinds.items():
            yield _case(f"{kind}_{method}", about, kind, method, float(WIDTH))
        for name, focal in (("focal_1", 1.0), ("focal_1e5", 1e5)):
            yield _case(f"{name}_{method}", f"a focal length of {focal:g} px", "ordinary", method, focal)


def _case(name: str, about: str, kind: str, method: str, focal: float) -> Case:
    return Case("splats", name, about, partial(problem, kind, method, focal), TOLERANCE, WHY)


def problem(kind: str, method: str, focal: float) -> Problem:
    """Rendering of an extreme splat.

    Args:
        kind: what is extreme about it; a key of `_CHANGES`.
        method: splatting method; a key of `METHODS`.
        focal: focal length in pixels.
    """
    splat_method = METHODS[method]
    splat = _gaussians(2 if isinstance(splat_method, TwoDGS) else 3, 60 if kind == "opaque" else COUNT, focal)
    splat = _CHANGES[kind](splat)
    if isinstance(splat_method, MipSplatting):
        splat["smoothing"] = torch.full((len(splat["means"]),), 0.01, dtype=torch.float64)
    camera = identity_camera(HEIGHT, WIDTH, focal, torch.float64)
    with_depth = kind in WITH_DEPTH
    return Problem(
        partial(_drawn, splat_method, camera, with_depth),
        splat,
        fixed=("smoothing",),
        share=0.99 if with_depth else 1.0,
    )


def _drawn(
    method: Method, camera: Camera, with_depth: bool, module: nn.Module | None, splat: dict[str, Tensor]
) -> Tensor:
    image = render(Gaussians(**splat), camera, method, (0.2, 0.4, 0.6))
    return torch.cat([image.colour, image.alpha, image.depth] if with_depth else [image.colour, image.alpha])


def _gaussians(axes: int, count: int, focal: float) -> dict[str, Tensor]:
    """Gaussians in front of the camera that cover a few pixels each, at any focal length."""
    generator = torch.Generator().manual_seed(5)
    uniform = torch.rand(count, 3, generator=generator, dtype=torch.float64)
    z = 2 + uniform[:, 2:]
    image_axes = (uniform[:, :2] - 0.5) * torch.tensor([WIDTH, HEIGHT]) / focal * z
    size = 3 * z / focal * (0.5 + torch.rand(count, axes, generator=generator, dtype=torch.float64))
    return {
        "means": torch.cat([image_axes, z], 1),
        "log_scales": size.log(),
        "quaternions": torch.nn.functional.normalize(
            torch.randn(count, 4, generator=generator, dtype=torch.float64), dim=1
        ),
        "opacity_logits": torch.randn(count, generator=generator, dtype=torch.float64),
        "sh": 0.5 * torch.randn(count, 4, 3, generator=generator, dtype=torch.float64),
    }


def _needles(splat: dict[str, Tensor]) -> dict[str, Tensor]:
    log_scales = splat["log_scales"].clone()
    log_scales[:, 1:] = log_scales[:, :1] - math.log(1e6)
    return {**splat, "log_scales": log_scales}


def _near_singular(splat: dict[str, Tensor]) -> dict[str, Tensor]:
    log_scales = splat["log_scales"].clone()
    log_scales[:, 0] = math.log(1e5)  # over 10^6 px long and less than one wide
    log_scales[:, 1:] = math.log(1e-4)
    return {**splat, "log_scales": log_scales}


def _near_plane(splat: dict[str, Tensor]) -> dict[str, Tensor]:
    means = splat["means"].clone()
    means[:6, 2] = torch.tensor([0.01, 0.0101, 0.0099, 0.0, -0.01, -2.0], dtype=torch.float64)
    means[:6, :2] *= 1e-3
    log_scales = splat["log_scales"].clone()
    log_scales[:6] -= 5
    return {**splat, "means": means, "log_scales": log_scales}


def _behind(splat: dict[str, Tensor]) -> dict[str, Tensor]:
    return {**splat, "means": splat["means"] * torch.tensor([1.0, 1.0, -1.0], dtype=torch.float64)}


def _opaque(splat: dict[str, Tensor]) -> dict[str, Tensor]:
    return {**splat, "opacity_logits": torch.full_like(splat["opacity_logits"], 15.0)}  # 1 to seven digits


def _one_place(splat: dict[str, Tensor]) -> dict[str, Tensor]:
    return {**splat, "means": splat["means"][:1].expand_as(splat["means"]).clone()}


def _not_finite(splat: dict[str, Tensor]) -> dict[str, Tensor]:
    means, log_scales = splat["means"].clone(), splat["log_scales"].clone()
    means[0, 1], log_scales[1, 0] = math.nan, math.inf
    return {**splat, "means": means, "log_scales": log_scales}


def _harmonics(splat: dict[str, Tensor]) -> dict[str, Tensor]:
    harmonics = splat["sh"].clone()
    harmonics[0, 0], harmonics[1, 2, 0], harmonics[2, 3, 1], harmonics[3, 0, 2] = math.nan, math.inf, -math.inf, 1e20
    return {**splat, "sh": harmonics}


def _log_scale(value: float, splat: dict[str, Tensor]) -> dict[str, Tensor]:
    log_scales = splat["log_scales"].clone()
    log_scales[0, 0], log_scales[1] = value, value
    return {**splat, "log_scales": log_scales}


def _edge_on(splat: dict[str, Tensor]) -> dict[str, Tensor]:
    """Disks with the normal perpendicular to the ray through their centre; every other one is tilted by about 10^-4."""
    half = math.sqrt(0.5)
    quaternions = torch.tensor([half, half, 0.0, 0.0], dtype=torch.float64).repeat(
        COUNT, 1
    )  # about x: the normal points along y
    quaternions[::2, 1] += 1e-4
    means = splat["means"].clone()
    means[:, 1] = 0
    return {**splat, "quaternions": quaternions, "means": means}


_CHANGES: dict[str, Callable[[dict[str, Tensor]], dict[str, Tensor]]] = {
    "ordinary": dict,
    "needles": _needles,
    "near_singular": _near_singular,
    "near_plane": _near_plane,
    "behind": _behind,
    "opaque": _opaque,
    "one_place": _one_place,
    "not_finite": _not_finite,
    "harmonics": _harmonics,
    "log_scale_90": partial(_log_scale, 90.0),
    "log_scale_-1e30": partial(_log_scale, -1e30),
    "edge_on": _edge_on,
}
