"""Random generators of a batch of samples."""

import torch

from gaussian_enhancer.degrade.artefacts.rng import spawn


def spawn_seeded(count: int, seed: int = 0) -> tuple[torch.Generator, ...]:
    """As many generators as there are samples, from one seed."""
    return spawn(count, torch.Generator().manual_seed(seed))
