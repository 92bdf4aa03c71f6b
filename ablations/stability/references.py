"""Cases of extreme references: without information, at the target's own place, of odd sizes, or not finite."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import torch
from torch import Tensor, nn

from ablations.stability.case import Case, Problem
from ablations.stability.depth import WARPED
from ablations.stability.geometry import as_target, plane, shifted
from ablations.stability.images import network_inputs, run_network, shipped_network
from gaussian_enhancer.align.alignment import LoadedView, Reprojected, Unwarped, Warp
from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.network.network import Network
from gaussian_enhancer.types import NetworkInput

ABOUT = {
    "identical": "the target's own render from the target's place",
    "black": "black photos",
    "missing": "no reference",
    "half_size": "photos of half the size",
    "odd_size": "a photo one pixel wide beside one four times as fine",
    "behind": "photos taken from behind the plane",
    "same_place": "three photos of one camera",
}
WHY = "geometry and colours are computed in single precision or better"
NAMES = ("a.png", "b.png", "c.png")


def cases() -> Iterator[Case]:
    """The cases of this family: references after each alignment, and as inputs of the network."""
    case = partial(Case, "references")
    for name, about in ABOUT.items():
        for alignment in WARPS:
            build = partial(alignment_problem, name, alignment)
            yield case(f"{name}_{alignment}", about, build, WARPED, WHY, ("forward",))
    yield case("unseen_network", "references of visibility 0 that hold huge numbers", unseen_problem)
    for field in ("render", "references", "alpha"):
        about, build = f"NaN in one pixel of the {field}", partial(nan_problem, field)
        yield case(f"nan_in_{field}", about, build, passes=("forward",))
    for field in ("render", "references"):
        about, build = f"1e30 in a patch of the {field}", partial(large_value_problem, field)
        yield case(f"1e30_in_{field}", about, build, passes=("forward",))


WARPS: dict[str, Warp] = {"reprojected": Reprojected(), "unwarped": Unwarped()}


def alignment_problem(name: str, alignment: str) -> Problem:
    """References aligned to the target's pixels."""
    return Problem(partial(_aligned, name, alignment), {"render": as_target(plane()).image}, share=0.99)


def _aligned(name: str, alignment: str, module: nn.Module | None, inputs: dict[str, Tensor]) -> Tensor:
    dtype = inputs["render"].dtype
    target = replace(_cast_view(as_target(plane()), dtype), image=inputs["render"])
    views = [_cast_view(view, dtype) for view in references(name, target)]
    aligned_set = WARPS[alignment](target, views, 3)
    channels = torch.cat([aligned_set.references, aligned_set.visibility], 1)
    # Equal references may be returned in any order.
    return channels.sum(0) if len(channels) else torch.cat([inputs["render"], inputs["render"][:1]]) * 0


def references(name: str, target: LoadedView) -> Sequence[LoadedView]:
    """The references of a case."""
    ordinary = [plane(shift, name=view_name) for shift, view_name in zip((0.2, -0.2, 0.4), NAMES, strict=True)]
    if name == "identical":
        return [replace(target, name=NAMES[0], render=target.image)]
    if name == "black":
        return [replace(view, image=torch.zeros_like(view.image)) for view in ordinary]
    if name == "missing":
        return []
    if name == "half_size":
        return [replace(view, image=view.image[:, ::2, ::2], alpha=None) for view in ordinary]
    if name == "odd_size":
        fine = ordinary[1].image.repeat_interleave(4, -1).repeat_interleave(4, -2)
        return [
            replace(ordinary[0], image=ordinary[0].image[:, :, :1], render=None, alpha=None),
            replace(ordinary[1], image=fine, alpha=None),
        ]
    if name == "behind":
        return [replace(view, camera=shifted(0.1, behind=True)) for view in ordinary]
    return [replace(ordinary[0], name=view_name) for view_name in NAMES]


def _cast_view(view: LoadedView, dtype: torch.dtype) -> LoadedView:
    """A view with its images converted to a dtype; its camera is unchanged."""
    images = {name: getattr(view, name) for name in ("image", "depth", "alpha", "render")}
    converted = {name: None if image is None else image.to(dtype) for name, image in images.items()}
    return replace(view, **converted)  # type: ignore[arg-type]


def unseen_problem() -> Problem:
    """The network with large values in references of zero visibility."""
    views = network_inputs("noise", 1)
    views["visibility"] = torch.zeros_like(views["visibility"])
    views["references"] = views["references"] * 0 + 1e3
    return Problem(run_network, views, shipped_network("lr_tiny"))


def nan_problem(field: str) -> Problem:
    """A view with NaN in one pixel, enhanced as in the job enhance."""
    views = network_inputs("noise", 1)
    views[field].view(-1)[17] = math.nan
    return Problem(_enhanced, views, shipped_network("lr_tiny"))


def large_value_problem(field: str) -> Problem:
    """A view with a patch of 1e30, whose square is not finite in float32, enhanced as in the job enhance."""
    views = network_inputs("noise", 1)
    views[field][..., 4:12, 4:12] = 1e30
    return Problem(_enhanced, views, shipped_network("lr_tiny"))


def _enhanced(module: nn.Module | None, inputs: dict[str, Tensor]) -> Tensor:
    if not isinstance(module, Network):
        raise TypeError(f"{type(module).__name__} is no network")
    return SetEnhancer(module, ReferenceConfig(), precision="float32").enhance(NetworkInput(**inputs))  # type: ignore[arg-type]
