"""The simulators that studies compare, by the name of their row."""

from collections.abc import Mapping, Sequence

import torch

from ablations.realism.realism import Row
from gaussian_enhancer.degrade.artefact_types import TYPES
from gaussian_enhancer.degrade.gates.adaptive import calibrate_on_splat
from gaussian_enhancer.degrade.gates.gate import AllGate, Gate, NoGate, RandomGate
from gaussian_enhancer.degrade.generative.diffusion import Sampler
from gaussian_enhancer.degrade.generative.weights import diffused
from gaussian_enhancer.degrade.simulator import Simulator
from gaussian_enhancer.errors import InputError, refuse_unknown
from gaussian_enhancer.scene.rendered import RenderedSet

GENERIC = ("blur", "noise", "jpeg")
"""Degradations of general image restoration, without artefacts of splats; as in conf/gate/naive.yaml."""
PHOTOS = 4
"""Number of training photos on which the artefact types' responses are measured."""


class AdaptedGates:
    """Adaptive gates of splats, each calibrated once on the splat's training views, never on those held out."""

    def __init__(self) -> None:
        self.calibrated: list[tuple[RenderedSet, Gate]] = []

    def __call__(self, splat: RenderedSet) -> Gate:
        """The gate of a splat."""
        for calibrated_splat, gate in self.calibrated:
            if calibrated_splat is splat:
                return gate
        self.calibrated.append((splat, calibrate_on_splat(splat, torch.Generator().manual_seed(0), photos=PHOTOS)))
        return self.calibrated[-1][1]


def rows(names: Sequence[str], generator: str | None = None, steps: int = 8) -> Mapping[str, Row]:
    """Simulators by name.

    Args:
        names: of rows.
        generator: weights of stage 2, for the row ``tsds``.
        steps: of the diffusion's sampler.

    Raises:
        InputError: there is no such row, or a second stage comes without weights.
    """
    adapted = AdaptedGates()
    generic = AllGate({name: name in GENERIC for name in TYPES})  # blur, noise and JPEG, all at once
    makers: dict[str, Row] = {
        "none": lambda _: Simulator(NoGate()),  # the photo itself: the distance of real renders from photos
        "naive": lambda _: Simulator(generic),
        "all": lambda _: Simulator(AllGate()),  # every type of artefact at once
        "random": lambda _: Simulator(RandomGate()),  # the paper's gate: random types in random order, some in regions
        "adaptive": lambda splat: Simulator(adapted(splat)),
    }
    refuse_unknown("rows", names, (*makers, "tsds"))
    if "tsds" in names:
        if generator is None:
            raise InputError("rows", "names a second stage without weights", "add generator_weights=simulator")
        second = diffused(generator, Sampler(steps))
        makers["tsds"] = lambda splat: Simulator(adapted(splat), second)
    return {name: makers[name] for name in names}
