"""Replacement of a fit's renders by renders that the simulator makes from the photos.

Axes: b batch, h height, w width.
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F

from gaussian_enhancer.degrade.artefacts.rng import spawn
from gaussian_enhancer.degrade.artefacts.view import View
from gaussian_enhancer.degrade.simulator import Simulator
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.train.samples import Sample
from gaussian_enhancer.types import Batch


@dataclass(frozen=True)
class Simulation:
    """Chooses the crops to simulate, and simulates them. The result depends on the crop's seed only, not on its batch.

    Args:
        simulator: makes simulated renders from photos.
        share: probability that a crop of a held-out view is simulated, in (0, 1]; crops of training views always are.
        training_views: simulate on the runs' training views too. Their own renders are never used, because they were
            fitted to the photos.
        validation: validate on simulated renders as well; used to train a simulator.

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
            # Renders of training views were fitted to the photos: such pairs show no real degradation.
            raise InputError("training_views", "cannot be used to train a simulator", "use held-out views only")

    def is_simulated(self, seed: int) -> bool:
        """Whether the crop of a held-out view with this seed is simulated."""
        return float(torch.rand((), generator=_generators(seed)[0])) < self.share

    def __call__(self, batch: Batch, samples: Sequence[Sample], seeds: Sequence[int]) -> Batch:
        """The batch with simulated render, depth and opacity in the chosen crops; photos and references stay.

        The original renders are kept as ``real``.

        Only the real renders of held-out views are passed to the simulator's second stage. The render of a training
        view was fitted to its photo and is nearly equal to it, so that no degradation factors can be extracted.

        Args:
            batch: crops, depth in units of the view's median.
            samples: the sample of each crop.
            seeds: the seed of each crop.
        """
        batch = dataclasses.replace(batch, real=batch.views.render)
        simulated = [i for i in range(len(samples)) if not samples[i].held_out or self.is_simulated(seeds[i])]
        # Crops are grouped by what is known of them: unknown depth or opacity must not be simulated as if known.
        for known_parts in dict.fromkeys(_known_parts(samples[i]) for i in simulated):
            group = [i for i in simulated if _known_parts(samples[i]) == known_parts]
            batch = self._replace_renders(batch, group, *known_parts, seeds=[seeds[i] for i in group])
        return batch

    def _replace_renders(
        self, batch: Batch, indices: list[int], held_out: bool, has_depth: bool, has_alpha: bool, seeds: list[int]
    ) -> Batch:
        """The batch with simulated render, depth and opacity in the crops with these indices."""
        views, index = batch.views, torch.tensor(indices)
        photo = batch.photo[index]
        if photo.shape[-2:] != views.render.shape[-2:]:  # super-resolution: the photo is finer
            photo = F.interpolate(photo, views.render.shape[-2:], mode="area")
        depth, alpha = (
            plane[index] if plane is not None and is_known else None
            for plane, is_known in ((views.depth, has_depth), (views.alpha, has_alpha))
        )
        generators = [_generators(seed)[1] for seed in seeds]
        with torch.no_grad():
            simulated = self.simulator(View(photo, depth, alpha), generators, views.render[index] if held_out else None)
        replaced = View(views.render, views.depth, views.alpha).with_samples(index, simulated)
        views = dataclasses.replace(views, render=replaced.image, depth=replaced.depth, alpha=replaced.alpha)
        return dataclasses.replace(batch, views=views)


def _known_parts(sample: Sample) -> tuple[bool, bool, bool]:
    return sample.held_out, sample.has_depth, sample.has_alpha


def _generators(seed: int) -> tuple[torch.Generator, ...]:
    """Two generators, independent of each other and of the generator seeded directly, which draws the crop."""
    return spawn(2, torch.Generator().manual_seed(seed))
