"""Stage 1 of the simulator: applies the artefacts that a gate chose to a batch.

Axes: b batch, h height, w width.
"""

from collections.abc import Sequence

import torch

from gaussian_enhancer.degrade.artefact_types import ARTEFACTS
from gaussian_enhancer.degrade.artefacts.region import blend_in_region, soft_region
from gaussian_enhancer.degrade.artefacts.rng import named_generator
from gaussian_enhancer.degrade.artefacts.view import View
from gaussian_enhancer.degrade.gates.gate import ArtefactStep


def degrade(view: View, steps: Sequence[Sequence[ArtefactStep]], generators: Sequence[torch.Generator]) -> View:
    """Apply to each sample its own steps in its own order.

    Samples with the same type at the same position of their order are processed as one batch. The random numbers of a
    step depend only on its sample and its type, not on the other steps.

    Args:
        view: photos.
        steps: steps of each sample, as drawn by a gate.
        generators: one source of randomness for each sample.
    """
    seeds = [int(torch.randint(2**62, (), generator=generator)) for generator in generators]
    for position in range(max((len(sample_steps) for sample_steps in steps), default=0)):
        current = [sample_steps[position] if position < len(sample_steps) else None for sample_steps in steps]
        for name in dict.fromkeys(step.type for step in current if step is not None):
            type_steps = {i: step for i, step in enumerate(current) if step is not None and step.type == name}
            type_generators = [named_generator(name, seeds[i]) for i in type_steps]
            view = _apply(view, list(type_steps), list(type_steps.values()), type_generators)
    return view


def _apply(
    view: View, indices: list[int], steps: Sequence[ArtefactStep], generators: Sequence[torch.Generator]
) -> View:
    """Apply steps of one type to the samples of a batch with these indices."""
    index = torch.tensor(indices, device=view.image.device)
    selected = view[index]
    strength = torch.tensor([step.strength for step in steps]).to(view.image)
    degraded = ARTEFACTS[steps[0].type](selected, strength, generators)
    height, width = view.image.shape[-2:]
    soft_regions = soft_region(height, width, generators, view.image)
    is_regional = torch.tensor([step.regional for step in steps], device=view.image.device)[:, None, None, None]
    region = torch.where(is_regional, soft_regions, torch.ones_like(soft_regions))
    return view.with_samples(index, blend_in_region(selected, degraded, region))
