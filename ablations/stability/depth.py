"""Cases of extreme depth: zero, infinite, NaN, tiny, huge, constant; in the warp and in the network."""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import torch
from torch import Tensor, nn

from ablations.stability.case import Case, Problem, Tolerance
from ablations.stability.geometry import as_target, plane, textured_depth
from ablations.stability.images import network_inputs, run_network, shipped_network
from gaussian_enhancer.align.alignment import Reprojected
from gaussian_enhancer.types import Camera

WARPED: Tolerance = {
    "float32": (2e-3, 1e-2),
    "bfloat16": (0.02, 0.05),
    "float16": (5e-3, 0.02),
    "autocast bfloat16": (2e-3, 1e-2),
    "autocast float16": (2e-3, 1e-2),
}
WHY = "geometry is computed in single precision; one pixel in a hundred may fall to the other side of a threshold"


def cases() -> Iterator[Case]:
    """The cases of this family."""
    for name, (about, _) in DEPTHS.items():
        yield Case("depth", f"{name}_warp", f"{about}, to warp through", partial(warp_problem, name), WARPED, WHY)
        yield Case("depth", f"{name}_network", f"{about}, to modulate with", partial(depth_input_problem, name))


def warp_problem(name: str) -> Problem:
    """Two references warped through a depth map."""
    target, references = as_target(plane()), [plane(0.2, name="a.png"), plane(-0.3, name="b.png")]
    depth = DEPTHS[name][1](textured_depth())
    inputs = {"render": target.image, "depth": depth, "first": references[0].image, "second": references[1].image}
    cameras = [view.camera for view in (target, *references) if view.camera is not None]
    return Problem(partial(_warped, cameras), inputs, fixed=("depth", "render"), share=0.99)


def _warped(cameras: list[Camera], module: nn.Module | None, inputs: dict[str, Tensor]) -> Tensor:
    opaque = torch.ones_like(inputs["depth"])
    target = replace(as_target(plane()), image=inputs["render"], depth=inputs["depth"], alpha=opaque)
    references = [
        replace(plane(), name=name, image=inputs[name], camera=camera, render=None, depth=None)
        for name, camera in zip(("first", "second"), cameras[1:], strict=True)
    ]
    aligned = Reprojected(match_colour=False, photo_consistency=None)(replace(target, camera=cameras[0]), references, 2)
    order = [aligned.names.index(name) for name in ("first", "second")]
    return torch.cat([aligned.references, aligned.visibility], 1)[order]


def depth_input_problem(name: str) -> Problem:
    """The network with a depth map among its inputs."""
    views = network_inputs("noise", 1)
    views["depth"] = DEPTHS[name][1](views["depth"])
    network = shipped_network("lr_tiny")
    return Problem(run_network, views, network, fixed=("depth",))


def _everywhere(value: float) -> Callable[[Tensor], Tensor]:
    return partial(torch.full_like, fill_value=value)


def _here_and_there(value: float) -> Callable[[Tensor], Tensor]:
    def change(depth: Tensor) -> Tensor:
        changed = depth.clone()
        changed[..., ::3, ::2] = value
        return changed

    return change


def _scaled(factor: float) -> Callable[[Tensor], Tensor]:
    def change(depth: Tensor) -> Tensor:
        return depth * factor

    return change


DEPTHS: dict[str, tuple[str, Callable[[Tensor], Tensor]]] = {
    "zero": ("no depth anywhere", _everywhere(0.0)),
    "infinite": ("infinite depth everywhere", _everywhere(math.inf)),
    "nan": ("NaN everywhere", _everywhere(math.nan)),
    "some_nan": ("NaN here and there", _here_and_there(math.nan)),
    "some_infinite": ("infinite here and there", _here_and_there(math.inf)),
    "some_zero": ("holes here and there", _here_and_there(0.0)),
    "negative": ("negative depth everywhere", _everywhere(-2.0)),
    "tiny": ("depth of 1e-8 everywhere", _everywhere(1e-8)),
    "huge": ("depth of 1e8 everywhere", _everywhere(1e8)),
    "1e38": ("depth of 1e38 everywhere", _everywhere(1e38)),
    "some_1e38": ("depth of 1e38 here and there", _here_and_there(1e38)),
    "both": ("1e8, and 1e-8 here and there", lambda depth: _here_and_there(1e-8)(_everywhere(1e8)(depth))),
    "equal": ("one depth", _everywhere(3.0)),
    "unit_1e-4": ("a scene in units of 10^4", _scaled(1e-4)),
    "unit_1e6": ("a scene in units of 10^-6", _scaled(1e6)),
}
"""Depth maps by name: description, and function that makes them from an ordinary one."""
