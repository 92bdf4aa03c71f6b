"""What training varies: where a sample is cut out, how it is turned, which references it has and in which light.

Axes: p planes, h height, w width, s side of a crop, b batch.
"""

import dataclasses
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor

from gaussian_enhancer.train.samples import EACH, FIXED
from gaussian_enhancer.types import Batch


@dataclass(frozen=True)
class Augmentation:
    """Random crops and turns, dropped references, and jittered exposure.

    Args:
        crop: side of the square crops in pixels, a multiple of 16.
        drop_all: chance that a sample has no reference, so that the network also serves renders alone.
        drop_renders: chance that a batch comes without the splat's renders of the references' views, as a folder of
            finished renders does.
        exposure: standard deviation of a reference's log gain beside the target's, per reference and half of it per
            channel: what colour matching leaves.
        overfit: largest share of the references' errors, photo less the splat's own render of its view, that a sample
            loses: splats of more steps and Gaussians render what they were fitted to better, and new views hardly so.
        light: standard deviation of a log gain per channel that all images of a sample share.
        every_reference: keep all references of a sample in their order, whatever ``drop_all`` is.
    """

    crop: int = 128
    drop_all: float = 0.1
    drop_renders: float = 0.15
    exposure: float = 0.04
    overfit: float = 0.0
    light: float = 0.1
    every_reference: bool = False

    def cut(
        self, planes: UInt8[np.ndarray, "p _ _"], generator: torch.Generator, finer: int = 1
    ) -> UInt8[np.ndarray, "p s s"]:
        """A random square, flipped and turned; images smaller than it are continued by reflection.

        The same seed finds the same place in planes of the same sample that are finer.

        Args:
            planes: of one sample.
            generator: source of randomness.
            finer: how many times as fine as the render the planes are.
        """
        crop, (height, width) = finer * self.crop, planes.shape[1:]
        top = finer * _random_below(max(1, height // finer - self.crop + 1), generator)
        left = finer * _random_below(max(1, width // finer - self.crop + 1), generator)
        piece = np.array(planes[:, top : top + crop, left : left + crop])
        while piece.shape[1] < crop or piece.shape[2] < crop:
            grow = [(0, min(crop - side, side)) for side in piece.shape[1:]]
            piece = np.pad(piece, [(0, 0), *grow], mode="symmetric")
        if _random_below(2, generator):
            piece = piece[:, :, ::-1]
        return np.ascontiguousarray(np.rot90(piece, _random_below(4, generator), axes=(1, 2)))

    def drop(
        self,
        planes: UInt8[np.ndarray, "p s s"],
        generator: torch.Generator,
        fixed: int = FIXED,
        each: int = EACH,
    ) -> UInt8[np.ndarray, "q s s"]:
        """Keep a random number of references, the better ones first more often than not; all with ``every_reference``.

        Args:
            planes: of one crop.
            generator: source of randomness.
            fixed: planes before the references'.
            each: planes of a reference.
        """
        if self.every_reference:
            return planes
        count = (len(planes) - fixed) // each
        if count == 0 or float(torch.rand((), generator=generator)) < self.drop_all:
            return planes[:fixed]
        kept_count = 1 + _random_below(count, generator)
        order = (
            list(range(count)) if _random_below(2, generator) else torch.randperm(count, generator=generator).tolist()
        )
        chosen = [planes[fixed + each * i : fixed + each * (i + 1)] for i in order[:kept_count]]
        return np.concatenate([planes[:fixed], *chosen])

    def relight(self, batch: Batch, generator: torch.Generator, start: int = 0, whole: int | None = None) -> Batch:
        """Change the light of whole samples, and the exposure of their references.

        Args:
            batch: crops.
            generator: source of randomness.
            start: place of the first crop in the whole batch that these are a part of.
            whole: size of that batch; what is drawn is the same in whichever parts it comes. None: these are all.
        """
        views = batch.views
        size, count = views.references.shape[:2]
        whole, part = size if whole is None else whole, slice(start, start + size)
        light = torch.exp(self.light * torch.randn(whole, 3, 1, 1, generator=generator)[part])
        one = torch.randn(whole, count, 1, 1, 1, generator=generator)[part]
        each = torch.randn(whole, count, 3, 1, 1, generator=generator)[part]
        exposure = torch.exp(self.exposure * (one + 0.5 * each))

        def lit(image: Tensor, gain: Tensor) -> Tensor:
            return (image * gain).clamp(0, 1)

        renders = views.reference_renders
        if renders is not None and self.overfit > 0:
            lost = self.overfit * torch.rand(whole, 1, 1, 1, 1, generator=generator)[part]
            renders = torch.lerp(renders, views.references, lost)
        if renders is not None:
            non_finite = float(torch.rand((), generator=generator)) < self.drop_renders
            renders = None if non_finite else lit(renders, light[:, None])
        gain, fine = light[:, None] * exposure, views.fine_references
        views = dataclasses.replace(
            views,
            render=lit(views.render, light),
            references=lit(views.references, gain),
            reference_renders=renders,
            fine_references=None if fine is None else lit(fine, gain),
        )
        real = None if batch.real is None else lit(batch.real, light)
        return dataclasses.replace(batch, views=views, photo=lit(batch.photo, light), real=real)


def _random_below(limit: int, generator: torch.Generator) -> int:
    return int(torch.randint(limit, (), generator=generator))
