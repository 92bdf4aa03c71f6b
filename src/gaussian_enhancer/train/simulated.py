"""Crops whose render the simulator made from the photo, in place of a fit's.

Axes: b batch, h height, w width.
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from gaussian_enhancer.degrade.artefacts.rng import spawn
from gaussian_enhancer.degrade.artefacts.view import View
from gaussian_enhancer.degrade.simulator import Simulator
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.train.samples import Sample
from gaussian_enhancer.types import Batch


@dataclass(frozen=True)
class Simulation:
    """Which crops are simulated, and by which artefacts; both depend on the crop's seed alone, not on its batch.

    Args:
        simulator: photos in, renders out.
        share: chance that a held-out view's crop is simulated, in (0, 1]; a training view's always is.
        training_views: simulate on the runs' training views too. Their own renders are never used: they were fitted
            to the photos.
        validation: validate on simulated renders as well, as the training of a simulator does.

    Raises:
        InputError: the share is out of range, or a simulator would be trained on training views.
    """

    simulator: Simulator
    share: float
    training_views: bool = False
    validation: bool = False

    def __post_init__(self) -> None:
        if not 0 < self.share <= 1:
            raise InputError("simulation.share", f"is {self.share}", "give a share above 0 and up to 1")
        if self.validation and self.training_views:
            # Their own renders were fitted to their photos: no real degradation can be learnt from the pair.
            raise InputError("training_views", "are asked for by a simulator's training", "use held-out views alone")

    def is_simulated(self, seed: int) -> bool:
        """Whether the crop of a seed is simulated."""
        return float(torch.rand((), generator=_generators(seed)[0])) < self.share

    def __call__(self, batch: Batch, samples: Sequence[Sample], seeds: Sequence[int]) -> Batch:
        """The batch with render, depth and opacity of the chosen crops replaced; photos and references stay.

        The renders that were there are kept as ``real``.

        Only a held-out view's real render is shown to a second stage that asks for one: a training view's was fitted
        to its photo and is as good as it, so that no factor could be learnt from the two.

        Args:
            batch: crops, depth in units of the view's median.
            samples: what they belong to.
            seeds: of the crops.
        """
        batch = dataclasses.replace(batch, real=batch.views.render)
        chosen = [i for i in range(len(samples)) if not samples[i].held_out or self.is_simulated(seeds[i])]
        # What is unknown of one sample must not be taken from its neighbours in the batch.
        kinds = {_known(samples[i]): None for i in chosen}
        for kind in kinds:
            alike = [i for i in chosen if _known(samples[i]) == kind]
            batch = self._replace_renders(batch, alike, *kind, seeds=[seeds[i] for i in alike])
        return batch

    def _replace_renders(
        self, batch: Batch, chosen: list[int], held_out: bool, has_depth: bool, has_alpha: bool, seeds: list[int]
    ) -> Batch:
        views, index = batch.views, torch.tensor(chosen)

        def known(plane: Tensor | None, is_known: bool) -> Tensor | None:
            return plane[index] if plane is not None and is_known else None

        photo = batch.photo[index]
        if photo.shape[-2:] != views.render.shape[-2:]:  # of super-resolution
            photo = F.interpolate(photo, views.render.shape[-2:], mode="area")
        photos = View(photo, known(views.depth, has_depth), known(views.alpha, has_alpha))
        with torch.no_grad():
            simulated = self.simulator(
                photos, [_generators(seed)[1] for seed in seeds], views.render[index] if held_out else None
            )

        def put(plane: Tensor | None, other: Tensor | None) -> Tensor | None:
            return plane if plane is None or other is None else plane.index_copy(0, index, other)

        render = views.render.index_copy(0, index, simulated.image)
        depth, alpha = put(views.depth, simulated.depth), put(views.alpha, simulated.alpha)
        return dataclasses.replace(batch, views=dataclasses.replace(views, render=render, depth=depth, alpha=alpha))


def _known(sample: Sample) -> tuple[bool, bool, bool]:
    return sample.held_out, sample.has_depth, sample.has_alpha


def _generators(seed: int) -> tuple[torch.Generator, ...]:
    """Two sources that have nothing to do with each other, nor with the crop's place, which the seed itself draws."""
    return spawn(2, torch.Generator().manual_seed(seed))
