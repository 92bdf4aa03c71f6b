"""Choice of reference photos for a view.

The pose cost is NeRFLiX's (Zhou et al., CVPR 2023, ``inference/pose_matching.py``): centre distance plus 50 times one
minus the cosine between viewing directions. Scene units are arbitrary, so that distances are divided by the scene's
median camera spacing. Where the target's depth is known, the cost is weighed by covisibility.
Axes: h w the target's size, n candidates.
"""

import math
import re
from collections.abc import Collection, Sequence

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.rendered import RenderedView
from gaussian_enhancer.scene.scene import Photo
from gaussian_enhancer.types import Camera

View = Photo | RenderedView
DIRECTION_WEIGHT = 50.0
SAMPLED = 2**12
"""Pixels by which it is judged how much of a target a candidate shows."""


def pose_costs(target: Camera, candidates: Sequence[Camera], unit: float = 1.0) -> Float[Tensor, " n"]:
    """NeRFLiX's cost ``|c_t - c_i| / unit + 50 (1 - cos(d_t, d_i))`` for each candidate; lower is nearer.

    Args:
        target: the view that is to be enhanced.
        candidates: the views that could serve it.
        unit: length that distances are divided by; 1 is the published cost.
    """
    centres = torch.stack([camera.centre for camera in candidates]).double()
    directions = torch.stack([camera.forward for camera in candidates]).double()
    distance = (centres - target.centre.double()).norm(dim=1) / unit
    cosine = functional.cosine_similarity(directions, target.forward.double()[None], dim=1)
    return distance + DIRECTION_WEIGHT * (1 - cosine)


def camera_spacing(cameras: Sequence[Camera]) -> float:
    """Median distance of each camera to its nearest other one; cameras at the same place are left out, 1 if all are."""
    if len(cameras) < 2:
        return 1.0
    centres = torch.stack([camera.centre for camera in cameras]).double()
    distances = torch.cdist(centres, centres, compute_mode="donot_use_mm_for_euclid_dist")
    distances.fill_diagonal_(torch.inf)
    nearest = distances.min(dim=1).values
    apart = nearest[nearest > 1e-9 * centres.abs().max()]
    return float(apart.median()) if len(apart) else 1.0


def covisibility(
    depth: Float[Tensor, "1 h w"], target: Camera, references: Sequence[Camera], *, stride: int = 4
) -> Float[Tensor, " n"]:
    """Share of the target's pixels with depth that land inside each reference's image, in front of it (float64).

    What another surface hides is not looked for: references are ranked before their depth is read.

    Args:
        depth: z depth of the target, 0 where nothing was hit.
        target: its camera.
        references: the cameras that the pixels are projected into.
        stride: every how many pixels one is tried, in each direction.
    """
    points = _surface(depth, target, stride)
    if len(points) == 0 or not references:
        return points.new_zeros(len(references))
    projections = torch.stack([one.K.double() @ one.world_to_camera[:3].double() for one in references])
    x, y, z = (points @ projections[:, :, :3].mT + projections[:, None, :, 3]).unbind(-1)
    ahead = z.clamp_min(1e-12)
    widths, heights = (points.new_tensor([getattr(one, side) for one in references]) for side in ("width", "height"))
    inside = (z > 0) & (x >= 0) & (y >= 0) & (x < widths[:, None] * ahead) & (y < heights[:, None] * ahead)
    return inside.double().mean(1)


def rank_references(
    target: View,
    candidates: Sequence[View],
    count: int,
    *,
    depth: Float[Tensor, "1 h w"] | None = None,
    kept: Collection[int] = (),
    hysteresis: float = 1.0,
) -> tuple[int, ...]:
    """Indices of the ``count`` best references among the candidates, best first.

    Candidates with the target's own name are never taken. With cameras the order is by pose cost and, where depth is
    given, by ``(1 + cost) / covisibility``: a reference that sees half of the target must be twice as near. Without
    cameras the nearest names in natural order are taken.

    Covisibility is that of some 4,000 pixels, evenly spread, however large the view: captures may have hundreds of
    candidates.

    Args:
        target: the view that is to be enhanced.
        candidates: training views; test views do not belong here.
        count: how many to return at most.
        depth: rendered z depth of the target.
        kept: indices of candidates that the frame before referred to.
        hysteresis: factor on the cost of these, in (0, 1]: another must be clearly better to take the place of one.
            Without cameras it has no effect.

    Raises:
        InputError: ``count`` is below 1, or only some candidates have cameras.
    """
    if count < 1:
        raise InputError("reference count", f"is {count}", "ask for at least 1")
    others = [i for i, view in enumerate(candidates) if view.name != target.name]
    cameras = [camera for i in others if (camera := candidates[i].camera) is not None]
    if target.camera is None or not cameras:
        return _nearest_names(target.name, [candidates[i].name for i in others], others)[:count]
    if len(cameras) < len(others):
        bare = next(candidates[i].name for i in others if candidates[i].camera is None)
        raise InputError(f"reference {bare}", "has no camera while others have one", "give cameras for all or for none")
    costs = pose_costs(target.camera, cameras, camera_spacing(cameras))
    if depth is not None:
        stride = max(4, math.isqrt(depth.shape[-2] * depth.shape[-1] // SAMPLED))
        costs = (1 + costs) / covisibility(depth, target.camera, cameras, stride=stride).clamp_min(1e-6)
    costs = torch.where(torch.tensor([i in kept for i in others]), hysteresis * costs, costs)
    return tuple(others[i] for i in torch.argsort(costs, stable=True)[:count].tolist())


def _surface(depth: Float[Tensor, "1 h w"], camera: Camera, stride: int) -> Float[Tensor, "p 3"]:
    """World positions (float64) of every stride-th pixel that has depth; the depth map may be of another size."""
    height, width = depth.shape[1:]
    y, x = torch.meshgrid(torch.arange(0, height, stride), torch.arange(0, width, stride), indexing="ij")
    z = depth[0, ::stride, ::stride].detach().cpu().double()
    K = camera.resized(height, width).K.double()
    hit = (z > 0) & torch.isfinite(z)
    pixels = torch.stack([x + 0.5, y + 0.5, torch.ones_like(x)], -1).to(z)[hit]
    local = pixels @ torch.linalg.inv(K).T * z[hit][:, None]
    return (local - camera.world_to_camera[:3, 3].double()) @ camera.rotation.double()


def _nearest_names(target: str, names: list[str], indices: list[int]) -> tuple[int, ...]:
    """Indices by the number of names between each name and the target's; earlier names first among equals."""
    ordered = sorted(zip(names, indices, strict=True), key=lambda pair: _natural(pair[0]))
    position = sum(_natural(name) < _natural(target) for name, _ in ordered)
    gaps = [(position - k if k < position else k - position + 1, index) for k, (_, index) in enumerate(ordered)]
    return tuple(index for _, index in sorted(gaps, key=lambda pair: pair[0]))


def _natural(name: str) -> tuple[tuple[int, int, str], ...]:
    """Sort key in which 10 follows 9."""
    parts = re.findall(r"\d+|\D+", name.rsplit(".", 1)[0])
    return tuple((0, int(part), "") if part.isdigit() else (1, 0, part) for part in parts)
