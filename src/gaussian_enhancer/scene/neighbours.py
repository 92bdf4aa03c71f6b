"""Choice of reference photos for a view.

The pose cost is NeRFLiX's (Zhou et al., CVPR 2023, ``inference/pose_matching.py``): centre distance plus 50 times one
minus the cosine between viewing directions. Scene units are arbitrary; distances are therefore divided by the
scene's median camera spacing. Where the target's depth is known, ``1 + cost`` is divided by the covisibility.
Axes: h w the target's size, n candidates.
"""

import math
import re
from collections.abc import Collection, Sequence
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.camera_geometry import camera_distances
from gaussian_enhancer.scene.rendered import RenderedView
from gaussian_enhancer.scene.scene import Photo
from gaussian_enhancer.types import Camera

AnyView = Photo | RenderedView
DIRECTION_WEIGHT = 50.0
SAMPLED = 2**12
"""Approximate number of the target's pixels from which its covisibility with a candidate is estimated."""


def pose_costs(target: Camera, candidates: Sequence[Camera], unit: float = 1.0) -> Float[Tensor, " n"]:
    """NeRFLiX's cost ``|c_t - c_i| / unit + 50 (1 - cos(d_t, d_i))`` for each candidate; lower is nearer.

    Args:
        target: camera of the view to enhance.
        candidates: cameras of the possible references.
        unit: length that distances are divided by; 1 gives the published cost.
    """
    centres = torch.stack([camera.centre for camera in candidates]).double()
    directions = torch.stack([camera.forward for camera in candidates]).double()
    distance = (centres - target.centre.double()).norm(dim=1) / unit
    cosine = functional.cosine_similarity(directions, target.forward.double()[None], dim=1)
    return distance + DIRECTION_WEIGHT * (1 - cosine)


def camera_spacing(cameras: Sequence[Camera]) -> float:
    """Median distance from each camera to its nearest neighbour, without coincident cameras; 1 if all coincide."""
    if len(cameras) < 2:
        return 1.0
    nearest_distances = camera_distances(cameras).fill_diagonal_(torch.inf).min(dim=1).values
    nonzero_distances = nearest_distances[nearest_distances > 0]
    return float(nonzero_distances.median()) if len(nonzero_distances) else 1.0


def covisibility(
    depth: Float[Tensor, "1 h w"], target: Camera, references: Sequence[Camera], *, stride: int = 4
) -> Float[Tensor, " n"]:
    """Share of the target's pixels with depth that project into each reference's image, in front of it (float64).

    Occlusion is not tested, since references are ranked before their depth is read.

    Args:
        depth: z depth of the target, 0 where nothing was hit.
        target: camera of the target.
        references: cameras that the pixels are projected into.
        stride: spacing of the tested pixels in each direction.
    """
    points = _surface(depth, target, stride)
    if len(points) == 0 or not references:
        return points.new_zeros(len(references))
    projections = torch.stack([camera.K.double() @ camera.world_to_camera[:3].double() for camera in references])
    x, y, z = (points @ projections[:, :, :3].mT + projections[:, None, :, 3]).unbind(-1)
    positive_z = z.clamp_min(1e-12)
    widths, heights = points.new_tensor([(camera.width, camera.height) for camera in references]).T[..., None]
    inside = (z > 0) & (x >= 0) & (y >= 0) & (x < widths * positive_z) & (y < heights * positive_z)
    return inside.double().mean(1)


def choose_references(
    target: AnyView,
    candidates: Sequence[AnyView],
    count: int,
    *,
    depth: Float[Tensor, "1 h w"] | None = None,
    previous_references: Collection[int] = (),
    hysteresis: float = 1.0,
) -> tuple[int, ...]:
    """Indices of the ``count`` best references among the candidates, best first.

    Candidates with the target's own name, whatever its ending, are excluded: they are its ground truth.

    With cameras, candidates are ordered by pose cost or, where depth is given, by ``(1 + cost) / covisibility``: a
    reference that sees half of the target must have half the ``1 + cost`` to rank equally. Without cameras, the names
    nearest to the target's in natural order are chosen.

    Covisibility is estimated from about 4,000 evenly spaced pixels whatever the size of the view, since captures may
    have hundreds of candidates. Views below 256x256 pixels use every 4th pixel in each direction.

    Args:
        target: the view to enhance.
        candidates: training views; must not contain test views.
        count: maximum number of references to return.
        depth: rendered z depth of the target.
        previous_references: indices of the candidates that were references of the previous frame.
        hysteresis: factor on the cost of the ``previous_references``, in (0, 1]. With a factor below 1 another
            candidate must be clearly better to replace one of them. It has no effect without cameras.

    Raises:
        InputError: ``count`` is below 1, or only some candidates have cameras.
    """
    if count < 1:
        raise InputError("reference count", f"is {count}", "ask for at least 1")
    own_stem = Path(target.name).stem  # render and photo of one view may have different endings
    eligible = [i for i, view in enumerate(candidates) if Path(view.name).stem != own_stem]
    cameras = [camera for i in eligible if (camera := candidates[i].camera) is not None]
    if target.camera is None or not cameras:
        return _nearest_names(target.name, [candidates[i].name for i in eligible], eligible)[:count]
    if len(cameras) < len(eligible):
        name_without_camera = next(candidates[i].name for i in eligible if candidates[i].camera is None)
        received, remedy = "has no camera while others have one", "give cameras for all or for none"
        raise InputError(f"reference {name_without_camera}", received, remedy)
    costs = pose_costs(target.camera, cameras, camera_spacing(cameras))
    if depth is not None:
        stride = max(4, math.isqrt(depth.shape[-2] * depth.shape[-1] // SAMPLED))
        costs = (1 + costs) / covisibility(depth, target.camera, cameras, stride=stride).clamp_min(1e-6)
    costs = torch.where(torch.tensor([i in previous_references for i in eligible]), hysteresis * costs, costs)
    return tuple(eligible[i] for i in torch.argsort(costs, stable=True)[:count].tolist())


def _surface(depth: Float[Tensor, "1 h w"], camera: Camera, stride: int) -> Float[Tensor, "p 3"]:
    """World positions (float64) of the pixels with depth on a grid of spacing ``stride``.

    The depth map may differ in size from the camera.
    """
    height, width = depth.shape[1:]
    y, x = torch.meshgrid(torch.arange(0, height, stride), torch.arange(0, width, stride), indexing="ij")
    z = depth[0, ::stride, ::stride].detach().cpu().double()
    K = camera.resized(height, width).K.double()
    valid = (z > 0) & torch.isfinite(z)
    pixels = torch.stack([x + 0.5, y + 0.5, torch.ones_like(x)], -1).to(z)[valid]
    camera_points = pixels @ torch.linalg.inv(K).T * z[valid][:, None]
    return (camera_points - camera.world_to_camera[:3, 3].double()) @ camera.rotation.double()


def _nearest_names(target: str, names: list[str], indices: list[int]) -> tuple[int, ...]:
    """Indices sorted by how many names lie between each name and the target's; ties put earlier names first."""
    ordered = sorted(zip(names, indices, strict=True), key=lambda pair: _natural(pair[0]))
    position = sum(_natural(name) < _natural(target) for name, _ in ordered)
    gaps = [(position - k if k < position else k - position + 1, index) for k, (_, index) in enumerate(ordered)]
    return tuple(index for _, index in sorted(gaps, key=lambda pair: pair[0]))


def _natural(name: str) -> tuple[tuple[int, int, str], ...]:
    """Sort key for natural order, in which 10 follows 9."""
    parts = re.findall(r"\d+|\D+", name.rsplit(".", 1)[0])
    return tuple((0, int(part), "") if part.isdecimal() else (1, 0, part) for part in parts)
