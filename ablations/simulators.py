"""The rows of the simulator's studies: what makes simulated renders, by name."""

from collections.abc import Mapping

import torch

from gaussian_enhancer.degrade.adaptive import calibrated_on
from gaussian_enhancer.degrade.diffuse import Sampler
from gaussian_enhancer.degrade.gate import TYPES, AllGate, Gate, NoGate, RandomGate
from gaussian_enhancer.degrade.simulator import Simulator
from gaussian_enhancer.degrade.weights import diffused
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.measure.realism import Row
from gaussian_enhancer.scene.rendered import RenderedSet

GENERIC = ("blur", "noise", "jpeg")
"""What any image restoration simulates; nothing that only splats do. The same as conf/gate/naive.yaml."""


def rows(names: list[str], generator: str | None = None) -> Mapping[str, Row]:
    """Simulators by name.

    Args:
        names: of rows.
        generator: weights of stage 2, for the row ``tsds``.

    Raises:
        InputError: there is no such row, or ``tsds`` without weights.
    """
    makers: dict[str, Row] = {"none": none, "naive": naive, "all": every, "random": random, "adaptive": adaptive}
    unknown = [name for name in names if name not in (*makers, "tsds")]
    if unknown:
        raise InputError("--rows", f"names {unknown[0]!r}", f"choose among {', '.join((*makers, 'tsds'))}")
    if "tsds" in names:
        if generator is None:
            raise InputError("--rows tsds", "comes without weights", "name them with --generator")
        makers["tsds"] = two_stage(generator)
    return {name: makers[name] for name in names}


def none(splat: RenderedSet) -> Simulator:
    """The photo itself: how far real renders are from photos."""
    return Simulator(NoGate())


def naive(splat: RenderedSet) -> Simulator:
    """Blur, noise and JPEG, all at once."""
    return Simulator(AllGate({name: name in GENERIC for name in TYPES}))


def every(splat: RenderedSet) -> Simulator:
    """Every type of artefact at once."""
    return Simulator(AllGate())


def random(splat: RenderedSet) -> Simulator:
    """The paper's gate: random types in random order, some in regions only."""
    return Simulator(RandomGate())


def adaptive(splat: RenderedSet) -> Simulator:
    """Chances and strengths from the residuals of the splat's own training views."""
    return Simulator(adapted(splat))


def adapted(splat: RenderedSet) -> Gate:
    """The adaptive gate, calibrated on a splat's training views: never on the views that are held out."""
    return calibrated_on(splat, torch.Generator().manual_seed(0))


def two_stage(weights: str, sampler: Sampler | None = None) -> Row:
    """The adaptive gate and the learnt second stage."""
    second = diffused(weights, sampler)
    return lambda splat: Simulator(adapted(splat), second)
