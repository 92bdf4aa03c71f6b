"""Training augmentation: random crops, flips and rotations, dropped references, and varied light and exposure.

Axes: p planes, q planes that are kept, h height, w width, s side of a crop, b batch.
"""

import dataclasses
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor

from gaussian_enhancer.train.samples import FIXED_PLANES, PLANES_PER_REFERENCE
from gaussian_enhancer.types import Batch


@dataclass(frozen=True)
class Augmentation:
    """Random crops, flips and rotations, dropped references, and jittered light and exposure.

    Args:
        crop: side of the square crops in pixels, a multiple of 16.
        drop_all: probability that all references of a sample are dropped, so that the network also learns to enhance a
            render alone.
        drop_renders: probability that a batch has no renders of the references' views, as in a folder of finished
            renders.
        exposure: standard deviation of a reference's log gain relative to the target's, and half of it per channel in
            addition; imitates what remains after colour matching.
        overfit: upper limit of the random share by which each sample's renders of the references' views are moved
            towards the photos. Imitates splats of more steps and Gaussians, which render their training views better
            but new views hardly better.
        light: standard deviation of a log gain per channel that is common to all images of a sample.
        every_reference: keep all references of a sample in their order; ``drop_all`` is ignored.
    """

    crop: int = 128
    drop_all: float = 0.1
    drop_renders: float = 0.15
    exposure: float = 0.04
    overfit: float = 0.0
    light: float = 0.1
    every_reference: bool = False

    def random_crop(
        self, planes: UInt8[np.ndarray, "p _ _"], generator: torch.Generator, finer: int = 1
    ) -> UInt8[np.ndarray, "p s s"]:
        """A random square crop, mirrored and rotated by multiples of 90 degrees; small images are padded by reflection.

        The same seed gives the same crop of a sample's planes and of its finer planes.

        Args:
            planes: those of one sample.
            generator: source of randomness.
            finer: resolution of the planes as a multiple of the render's.
        """
        crop, (height, width) = finer * self.crop, planes.shape[1:]
        top = finer * _random_below(max(1, height // finer - self.crop + 1), generator)
        left = finer * _random_below(max(1, width // finer - self.crop + 1), generator)
        piece = np.array(planes[:, top : top + crop, left : left + crop])
        while piece.shape[1] < crop or piece.shape[2] < crop:
            padding = [(0, min(crop - side, side)) for side in piece.shape[1:]]
            piece = np.pad(piece, [(0, 0), *padding], mode="symmetric")
        if _random_below(2, generator):
            piece = piece[:, :, ::-1]
        return np.ascontiguousarray(np.rot90(piece, _random_below(4, generator), axes=(1, 2)))

    def drop_references(
        self,
        planes: UInt8[np.ndarray, "p s s"],
        generator: torch.Generator,
        fixed_planes: int = FIXED_PLANES,
        planes_per_reference: int = PLANES_PER_REFERENCE,
    ) -> UInt8[np.ndarray, "q s s"]:
        """Keep a random number of references, in half of the cases the best-ranked, in the others a random selection.

        No reference is kept with probability ``drop_all``; all are kept with ``every_reference``.

        Args:
            planes: those of one crop.
            generator: source of randomness.
            fixed_planes: number of planes before those of the references.
            planes_per_reference: number of planes per reference.
        """
        if self.every_reference:
            return planes
        references = planes[fixed_planes:].reshape(-1, planes_per_reference, *planes.shape[1:])
        count = len(references)
        if count == 0 or float(torch.rand((), generator=generator)) < self.drop_all:
            return planes[:fixed_planes]
        kept_count = 1 + _random_below(count, generator)
        by_rank = _random_below(2, generator)
        order = list(range(count)) if by_rank else torch.randperm(count, generator=generator).tolist()
        return np.concatenate([planes[:fixed_planes], *references[order[:kept_count]]])

    def relight(self, batch: Batch, generator: torch.Generator, start: int = 0, total_size: int | None = None) -> Batch:
        """Apply random gains to whole samples (light) and to their references (exposure).

        The ``overfit`` and ``drop_renders`` augmentations are applied to the references' renders as well.

        Args:
            batch: a batch of crops, or one process's part of it.
            generator: source of randomness.
            start: position of the first crop in the whole batch.
            total_size: size of the whole batch; random values do not depend on its split. None: this is all of it.
        """
        views = batch.views
        size, count = views.references.shape[:2]
        total_size, rows = size if total_size is None else total_size, slice(start, start + size)
        light = torch.exp(self.light * torch.randn(total_size, 3, 1, 1, generator=generator)[rows])
        reference_noise = torch.randn(total_size, count, 1, 1, 1, generator=generator)[rows]
        channel_noise = torch.randn(total_size, count, 3, 1, 1, generator=generator)[rows]
        exposure = torch.exp(self.exposure * (reference_noise + 0.5 * channel_noise))

        def lit(image: Tensor, gain: Tensor) -> Tensor:
            return (image * gain).clamp(0, 1)

        renders = views.reference_renders
        if renders is not None and self.overfit > 0:
            share = self.overfit * torch.rand(total_size, 1, 1, 1, 1, generator=generator)[rows]
            renders = torch.lerp(renders, views.references, share)
        if renders is not None:
            is_dropped = float(torch.rand((), generator=generator)) < self.drop_renders
            renders = None if is_dropped else lit(renders, light[:, None])
        gain, fine_references = light[:, None] * exposure, views.fine_references
        views = dataclasses.replace(
            views,
            render=lit(views.render, light),
            references=lit(views.references, gain),
            reference_renders=renders,
            fine_references=None if fine_references is None else lit(fine_references, gain),
        )
        real = None if batch.real is None else lit(batch.real, light)
        return dataclasses.replace(batch, views=views, photo=lit(batch.photo, light), real=real)


def _random_below(limit: int, generator: torch.Generator) -> int:
    return int(torch.randint(limit, (), generator=generator))
