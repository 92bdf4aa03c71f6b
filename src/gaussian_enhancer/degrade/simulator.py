"""The two-stage degradation simulator (TSDS), which makes simulated splat renders from photos.

Axes: b batch, h height, w width.
"""

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.degrade.artefacts.rng import spawn
from gaussian_enhancer.degrade.artefacts.view import View
from gaussian_enhancer.degrade.gates.gate import Gate
from gaussian_enhancer.degrade.manual import degrade
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.types import quantise_8_bit


@runtime_checkable
class SecondStage(Protocol):
    """Stage 2: maps stage 1's output to more realistic renders."""

    def __call__(
        self, manual: View, generators: Sequence[torch.Generator], real: Float[Tensor, "b 3 h w"] | None = None
    ) -> View:
        """Bring manually degraded views closer to real renders.

        Args:
            manual: stage 1's output M.
            generators: one source of randomness for each sample, on the CPU.
            real: real renders R of the same views, for second stages that extract their factors from them.

        Raises:
            InputError: the second stage needs real renders and there are none.
        """
        ...


class NoSecondStage:
    """No stage 2: returns stage 1's output unchanged."""

    def __call__(
        self, manual: View, generators: Sequence[torch.Generator], real: Float[Tensor, "b 3 h w"] | None = None
    ) -> View:
        """Return the views unchanged."""
        return manual


class Simulator:
    """TSDS (paper, algorithm 1): M = stage 1 (G), L = stage 2 (M).

    Args:
        gate: decides which artefacts stage 1 applies.
        generator: stage 2; None for none.
    """

    def __init__(self, gate: Gate, generator: SecondStage | None = None) -> None:
        self.gate = gate
        self.second_stage = NoSecondStage() if generator is None else generator

    def __call__(
        self,
        view: View,
        generators: torch.Generator | Sequence[torch.Generator],
        real: Float[Tensor, "b 3 h w"] | None = None,
    ) -> View:
        """Simulate splat renders of photographed views; colours are in [0, 1], rounded to 8 bits like renders on disk.

        Artefacts are computed at least in float32, outside autocast, because half precision can represent neither pixel
        positions nor 8-bit steps. Views in half precision are returned in float32.

        Args:
            view: photos, with depth and opacity if known.
            generators: one source of randomness for each sample, or one that all are seeded from; on the CPU.
            real: real renders of the same views, for second stages that need them.

        Raises:
            InputError: a photo is not finite.
        """
        if not bool(torch.isfinite(view.image).all()):
            raise InputError("photo", "has colours that are not finite", "give colours in [0, 1]")
        if view.image.dtype in (torch.float16, torch.bfloat16):
            view, real = view.to(torch.float32), None if real is None else real.float()
        if isinstance(generators, torch.Generator):
            generators = spawn(len(view), generators)
        steps = [self.gate.draw(generator) for generator in generators]
        with torch.autocast(view.image.device.type, enabled=False):
            refined = self.second_stage(degrade(view, steps, generators), generators, real)
        return View(quantise_8_bit(refined.image), refined.depth, refined.alpha)
