"""Stage 1 of the simulator: the steps that a gate chose, applied to a batch.

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

    Samples that take the same type in the same place of their order are computed together. What is drawn for a step
    follows from its sample and its type: it does not depend on which other steps there are.

    Args:
        view: photos.
        steps: of each sample, as a gate drew them.
        generators: one source of randomness for each sample.
    """
    seeds = [int(torch.randint(2**62, (), generator=generator)) for generator in generators]
    for position in range(max((len(one) for one in steps), default=0)):
        current = [one[position] if position < len(one) else None for one in steps]
        for name in dict.fromkeys(step.type for step in current if step is not None):
            chosen = [i for i, step in enumerate(current) if step is not None and step.type == name]
            same_type = [step for step in current if step is not None and step.type == name]
            view = _apply(view, chosen, same_type, [named_generator(name, seeds[i]) for i in chosen])
    return view


def _apply(view: View, chosen: list[int], steps: Sequence[ArtefactStep], generators: Sequence[torch.Generator]) -> View:
    index = torch.tensor(chosen, device=view.image.device)
    before = view[index]
    strength = torch.tensor([step.strength for step in steps]).to(view.image)
    after = ARTEFACTS[steps[0].type](before, strength, generators)
    height, width = view.image.shape[-2:]
    regions = soft_region(height, width, generators, view.image)
    whole = torch.tensor([not step.regional for step in steps], device=view.image.device)[:, None, None, None]
    return view.with_samples(
        index, blend_in_region(before, after, torch.where(whole, torch.ones_like(regions), regions))
    )
