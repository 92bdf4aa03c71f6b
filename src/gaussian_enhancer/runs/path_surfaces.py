"""Refusal of camera paths that pass through surfaces or that show nothing of the splat."""

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
import torch

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.runs.rendered_capture import SplatRenderer
from gaussian_enhancer.types import Camera

T = TypeVar("T")

MAX_PATH_VIEWS, MAX_CAPTURE_VIEWS = 48, 8
"""Maximum numbers of views rendered of the path and of the capture, evenly spread."""
LONGER_SIDE = 48
"""Longer side of these views in pixels."""
NEAR_RATIO = 0.03
"""A surface nearer than this share of the capture's typical depth counts as touching the camera."""
MIN_OPACITY = 0.5
"""Minimum opacity of a pixel that shows a surface."""
MAX_NEAR_SHARE = 0.5
"""A camera counts as inside a surface if more than this share of its view touches the camera."""
MIN_OPAQUE_SHARE = 0.05
"""Minimum share of a view that must show a surface."""
REMEDY = "lay the path elsewhere, an orbit or spiral with another radius="


def refuse_inside(path: Sequence[Camera], cameras: Sequence[Camera], renderer: SplatRenderer, subject: object) -> None:
    """Refuse a path if a view is mostly filled by a surface close to the camera, or shows almost nothing.

    Args:
        path: cameras of the path.
        cameras: cameras of the capture, from which the typical depth of surfaces is computed.
        renderer: renders the splat.
        subject: name of the path in the error.

    Raises:
        InputError: a camera is inside a surface, or sees nothing of the splat.
    """
    capture_depths = [
        depth
        for camera in _evenly_spread(cameras, MAX_CAPTURE_VIEWS)
        if (depth := _visible_depths(camera, renderer)[0]) is not None
    ]
    if not capture_depths:
        return
    typical_depth = float(torch.stack([depth.median() for depth in capture_depths]).median())
    for number in _evenly_spread(range(len(path)), MAX_PATH_VIEWS):
        depth, opaque_share = _visible_depths(path[number], renderer)
        frame_name = f"frame {number + 1} of {len(path)}"
        if depth is None or opaque_share < MIN_OPAQUE_SHARE:
            raise InputError(subject, f"sees nothing of the splat at {frame_name}", REMEDY)
        near_share = opaque_share * float((depth < NEAR_RATIO * typical_depth).float().mean())
        if near_share > MAX_NEAR_SHARE:
            cause = f"{near_share:.0%} of the view is nearer than {NEAR_RATIO:.0%} of the usual depth"
            raise InputError(subject, f"is inside a surface at {frame_name}: {cause}", REMEDY)


def _visible_depths(camera: Camera, renderer: SplatRenderer) -> tuple[torch.Tensor | None, float]:
    """Depths of the opaque pixels of a small render, None if there are none, and the share of opaque pixels."""
    scale = min(1.0, LONGER_SIDE / max(camera.height, camera.width))
    render = renderer(camera.resized(max(1, round(camera.height * scale)), max(1, round(camera.width * scale))))
    opaque = render.alpha > MIN_OPACITY
    return (render.surface[opaque] if bool(opaque.any()) else None), float(opaque.float().mean())


def _evenly_spread(items: Sequence[T], count: int) -> list[T]:
    """At most ``count`` items, evenly spread from the first to the last."""
    return [items[round(i)] for i in np.linspace(0, len(items) - 1, min(count, len(items)))]
