"""Selection, reading and alignment of references for the network.

Axes: r references, h height, w width.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache, partial

import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from gaussian_enhancer.align.alignment import AlignedReferences, LoadedView, Reprojected, Warp
from gaussian_enhancer.align.depth_normalisation import depth_unit
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.neighbours import choose_references
from gaussian_enhancer.scene.rendered import RenderedView
from gaussian_enhancer.types import NetworkInput


@dataclass(frozen=True)
class ReferenceConfig:
    """How references are chosen and aligned. Stored with the weights, so that training and inference agree.

    Args:
        warp: method that aligns references to the target's grid.
        references: maximum number of references for the network, 0 to 8.
        candidates: number of nearby views that are considered, at least ``references``.
        fine: also align the references' photos to a grid 4 times as fine, for super-resolution.
    """

    warp: Warp = field(default_factory=Reprojected)
    references: int = 3
    candidates: int = 5
    fine: bool = False

    def __post_init__(self) -> None:
        if not 0 <= self.references <= 8:
            raise InputError("references", f"is {self.references}", "ask for 0 to 8 references")
        if self.candidates < self.references:
            raise InputError(
                "candidates", f"is {self.candidates} for {self.references} references", "consider at least as many"
            )

    def can_align(self, view: RenderedView) -> bool:
        """Whether references can be aligned to a target. Warping requires the target's camera and depth."""
        return not isinstance(self.warp, Reprojected) or (view.camera is not None and view.read_depth is not None)

    def nearest_candidates(self, target: LoadedView, view: RenderedView, pool: "ReferencePool") -> tuple[int, ...]:
        """Indices of the pool's candidate references for a target, nearest first."""
        if not self.references:
            return ()
        return choose_references(view, pool.views, self.candidates, depth=target.depth)

    def align(
        self, target: LoadedView, view: RenderedView, pool: "ReferencePool", candidates: Sequence[int] | None = None
    ) -> AlignedReferences:
        """Align the best references of a pool to the target's grid, on the target's device.

        Args:
            target: pixels of the target.
            view: the target, which is never used as its own reference.
            pool: pool of references.
            candidates: indices of the candidates in the pool, nearest first; None selects them by `nearest_candidates`.
        """
        indices = self.nearest_candidates(target, view, pool) if candidates is None else tuple(candidates)
        device = target.image.device
        return self.warp(target, [pool.read(index, self.fine).to_device(device) for index in indices], self.references)


class ReferencePool:
    """The references of a set, with a cache of the pixels read last, since targets share references.

    Args:
        views: training views with photos.
        capacity: number of cached references.
    """

    def __init__(self, views: Sequence[RenderedView], capacity: int = 24) -> None:
        self.views = tuple(views)
        self._read_cached: Callable[[int, bool], LoadedView] = lru_cache(maxsize=capacity)(self._read)
        self._read_fine_cached: Callable[[int], Tensor] = lru_cache(maxsize=-(-capacity // 4))(self._read_fine)

    def read(self, index: int, fine: bool = False) -> LoadedView:
        """Read the pixels of a reference; with ``fine``, its finer photo can be read as well.

        Finer photos are rounded to 8 bits; the cache holds a quarter as many of them.

        Raises:
            InputError: there is no photo, or no finer photo, or a file is damaged.
        """
        return self._read_cached(index, fine)

    def _read_fine(self, index: int) -> UInt8[Tensor, "3 _ _"]:
        read_photo = self.views[index].read_fine_photo
        if read_photo is None:
            raise ValueError(f"reference {index} has no fine photo")
        return torch.stack([channel.mul(255).round_().clamp_(0, 255).byte() for channel in read_photo()])

    def _read(self, index: int, fine: bool) -> LoadedView:
        view = self.views[index]
        if view.read_photo is None:
            raise InputError(view.name, "has no photo to refer to", "give the photo, or leave the view out")
        depth = view.read_depth() if view.read_depth is not None else None
        render = view.read() if view.read is not None else None
        if fine and view.read_fine_photo is None:
            raise InputError(
                view.name,
                "has no photo of 4 times its render's resolution",
                "give photos of 4 times the render's resolution",
            )
        read_fine = partial(self._read_fine_cached, index) if fine else None
        return LoadedView(view.name, view.read_photo(), view.camera, depth, render=render, read_fine=read_fine)


def read_target(view: RenderedView) -> LoadedView:
    """Read the pixels of a target.

    Raises:
        InputError: the view has no render, or its depth or opacity has another size.
    """
    if view.read is None:
        raise InputError(view.name, "has no render to enhance", "render it first")
    image = view.read()
    depth = view.read_depth() if view.read_depth is not None else None
    alpha = view.read_alpha() if view.read_alpha is not None else None
    for plane_name, plane in (("depth", depth), ("alpha", alpha)):
        if plane is not None and plane.shape[-2:] != image.shape[-2:]:
            sizes = [f"{p.shape[-1]}x{p.shape[-2]}" for p in (plane, image)]
            raise InputError(view.name, f"has {plane_name} of {sizes[0]} for a render of {sizes[1]}", "render it again")
    return LoadedView(view.name, image, view.camera, depth, alpha)


def build_network_input(
    target: LoadedView, aligned: AlignedReferences, unit: Float[Tensor, "1"] | None = None
) -> NetworkInput:
    """Build a batch of one for the network.

    Args:
        target: pixels of the target, or of a part of it.
        aligned: references on the target's grid.
        unit: the length that counts as 1 in depth; None uses the unit of the target's own depth.
    """
    depth = None if target.depth is None else target.depth[None]
    return NetworkInput(
        target.image[None],
        aligned.references[None],
        aligned.visibility[None],
        depth,
        None if target.alpha is None else target.alpha[None],
        None if depth is None else depth_unit(depth) if unit is None else unit,
        None if aligned.renders is None else aligned.renders[None],
        None if aligned.fine is None else aligned.fine[None],
    )
