"""Gates: which artefacts a sample gets, how strongly, in which order, and whether in a region only."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import torch

from gaussian_enhancer.errors import InputError

TYPES = (
    "blur",
    "noise",
    "sensor",
    "jpeg",
    "downsampling",
    "displacement",
    "needle",
    "banding",
    "cloudy",
    "floater",
    "colour",
)
"""Every type of stage 1; `gaussian_enhancer.degrade.manual.ARTEFACTS` has the function of each."""


@dataclass(frozen=True)
class Step:
    """One artefact that a gate let through.

    Args:
        type: one of `TYPES`.
        strength: in (0, 1].
        regional: whether it acts within a soft region alone.
    """

    type: str
    strength: float
    regional: bool = False


@runtime_checkable
class Gate(Protocol):
    """Decides, sample by sample, which artefacts are applied."""

    def draw(self, generator: torch.Generator) -> tuple[Step, ...]:
        """The steps of one sample, in the order in which they are applied.

        Args:
            generator: source of randomness.
        """
        ...


def switched_on(types: Mapping[str, bool]) -> tuple[str, ...]:
    """The types whose switch is on, in the order of `TYPES`; a type that is not named is on.

    Raises:
        InputError: a switch names no type.
    """
    unknown = [name for name in types if name not in TYPES]
    if unknown:
        raise InputError(f"gate.types.{unknown[0]}", "is no type of artefact", f"choose among {', '.join(TYPES)}")
    return tuple(name for name in TYPES if types.get(name, True))


@dataclass(frozen=True)
class NoGate:
    """Nothing passes: stage 1 returns the photo."""

    def draw(self, generator: torch.Generator) -> tuple[Step, ...]:
        """No steps."""
        return ()


@dataclass(frozen=True)
class AllGate:
    """Every type at once, each at a random strength: the naive way that the paper argues against.

    Args:
        types: switches by type; a type that is not named is on.
    """

    types: Mapping[str, bool] = field(default_factory=dict)

    def __post_init__(self) -> None:
        switched_on(self.types)

    def draw(self, generator: torch.Generator) -> tuple[Step, ...]:
        """All steps in random order, over the whole image."""
        strengths = torch.rand(len(TYPES), generator=generator).tolist()
        order = torch.randperm(len(TYPES), generator=generator).tolist()
        on = switched_on(self.types)
        return tuple(Step(TYPES[i], strengths[i]) for i in order if TYPES[i] in on and strengths[i] > 0)
