"""Refusing camera paths that pass through surfaces, or that look past everything."""

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
import torch

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.runs.rendered_capture import SplatRenderer
from gaussian_enhancer.types import Camera

T = TypeVar("T")

OF_PATH, OF_CAPTURE = 48, 8
"""Views that are rendered at most, evenly spread."""
SIDE = 48
"""Longer side of these views in pixels."""
NEAR = 0.03
"""Share of the capture's usual depth within which a surface is at the lens."""
OPAQUE = 0.5
"""Opacity from which a pixel shows a surface."""
MOST, LEAST = 0.5, 0.05
"""Share of a view at the lens from which on a camera counts as inside a surface; least share that shows anything."""
REMEDY = "lay the path elsewhere, an orbit or spiral with another radius="


def refuse_inside(path: Sequence[Camera], cameras: Sequence[Camera], renderer: SplatRenderer, subject: object) -> None:
    """Refuse a path of which a view is mostly filled by a surface at the lens, or shows nothing.

    Args:
        path: cameras of the path.
        cameras: those of the capture, which tell how far away its surfaces usually are.
        renderer: renders the splat.
        subject: what the path is called, in the error.

    Raises:
        InputError: a camera is inside a surface, or sees nothing of the splat.
    """
    usual = [
        depth
        for camera in _evenly_spread(cameras, OF_CAPTURE)
        if (depth := _visible_depths(camera, renderer)[0]) is not None
    ]
    if not usual:
        return
    typical = float(torch.stack([depth.median() for depth in usual]).median())
    for number in _evenly_spread(range(len(path)), OF_PATH):
        depth, share = _visible_depths(path[number], renderer)
        frame_name = f"frame {number + 1} of {len(path)}"
        if depth is None or share < LEAST:
            raise InputError(subject, f"sees nothing of the splat at {frame_name}", REMEDY)
        close = share * float((depth < NEAR * typical).float().mean())
        if close > MOST:
            near = f"{close:.0%} of the view is nearer than {NEAR:.0%} of the usual depth"
            raise InputError(subject, f"is inside a surface at {frame_name}: {near}", REMEDY)


def _visible_depths(camera: Camera, renderer: SplatRenderer) -> tuple[torch.Tensor | None, float]:
    """Depths of a small view where it shows a surface, None where it shows none, and the share that does."""
    scale = min(1.0, SIDE / max(camera.height, camera.width))
    render = renderer(camera.resized(max(1, round(camera.height * scale)), max(1, round(camera.width * scale))))
    opaque = render.alpha > OPAQUE
    return (render.surface[opaque] if bool(opaque.any()) else None), float(opaque.float().mean())


def _evenly_spread(items: Sequence[T], count: int) -> list[T]:
    """At most so many of the items, evenly spread from the first to the last."""
    return [items[round(i)] for i in np.linspace(0, len(items) - 1, min(count, len(items)))]
