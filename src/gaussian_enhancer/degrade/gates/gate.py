"""Gates: choose the artefacts of a sample, their strengths and order, and whether they act only in a region."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol, runtime_checkable

import torch

from gaussian_enhancer.degrade.artefact_types import TYPES
from gaussian_enhancer.degrade.artefacts.rng import named_generator
from gaussian_enhancer.errors import InputError


@dataclass(frozen=True)
class ArtefactStep:
    """One artefact that a gate has chosen.

    Args:
        type: one of `TYPES`.
        strength: strength in (0, 1].
        regional: whether it acts only within a soft region.

    Raises:
        InputError: the type is unknown or the strength out of range.
    """

    type: str
    strength: float
    regional: bool = False

    def __post_init__(self) -> None:
        check_types("step", (self.type,))
        if not 0 < self.strength <= 1:
            raise InputError(f"strength of {self.type}", f"is {self.strength}", "give a number in (0, 1]")


@runtime_checkable
class Gate(Protocol):
    """Decides for each sample which artefacts are applied."""

    def draw(self, generator: torch.Generator) -> tuple[ArtefactStep, ...]:
        """Draw the steps of one sample, in the order in which they are applied.

        Args:
            generator: source of randomness.
        """
        ...


def check_types(where: str, names: Iterable[str]) -> None:
    """Refuse names that are not in `TYPES`.

    Args:
        where: setting that the names come from, for the error message.
        names: names to check.

    Raises:
        InputError: a name is not a type.
    """
    for name in names:
        if name not in TYPES:
            raise InputError(f"{where}.{name}", "is no type of artefact", f"choose among {', '.join(TYPES)}")


def enabled_types(types: Mapping[str, object]) -> tuple[str, ...]:
    """The types whose switch is on, in the order of `TYPES`; a type that is not named is on.

    Raises:
        InputError: a switch names no type, or is neither true nor false.
    """
    check_types("gate.types", types)
    for name, switch in types.items():
        if not isinstance(switch, bool):
            raise InputError(f"gate.types.{name}", f"is {switch!r}", "give true or false")
    return tuple(name for name in TYPES if types.get(name, True))


def check_probability(where: str, value: object) -> None:
    """Refuse a value outside [0, 1].

    Raises:
        InputError: the value is not a number in [0, 1].
    """
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value <= 1:
        raise InputError(where, f"is {value!r}", "give a number from 0 to 1")


@dataclass(frozen=True)
class NoGate:
    """Gate that chooses no artefacts: stage 1 returns the photo."""

    def draw(self, generator: torch.Generator) -> tuple[ArtefactStep, ...]:
        """Return no steps."""
        return ()


@dataclass(frozen=True)
class AllGate:
    """Gate that chooses every type, each at a random strength; the paper's negative example.

    Args:
        types: switches by type; a type that is not named is on.
    """

    types: Mapping[str, bool] = field(default_factory=dict)

    def __post_init__(self) -> None:
        enabled_types(self.types)

    def draw(self, generator: torch.Generator) -> tuple[ArtefactStep, ...]:
        """Draw steps of all enabled types in random order, over the whole image."""
        enabled = enabled_types(self.types)
        return tuple(
            ArtefactStep(entry.type, entry.strength) for entry in draw_type_numbers(generator) if entry.type in enabled
        )


@dataclass(frozen=True)
class RandomGate:
    """The paper's gate: each type is chosen with a probability, at a random strength, sometimes only in a region.

    With the defaults, 3.3 of 11 types are applied on average, and one sample in 50 stays clean. Switching types off
    does not affect the others: the same generator gives them the same random numbers, strengths and order.

    Args:
        types: switches by type; a type that is not named is on.
        chance: probability that a type is chosen.
        chances: probabilities by type, for types that differ from ``chance``.
        regional: probability that a chosen type acts only within a soft region.

    Raises:
        InputError: a switch or a chance names no type, or a probability is out of range.
    """

    types: Mapping[str, bool] = field(default_factory=dict)
    chance: float = 0.3
    chances: Mapping[str, float] = field(default_factory=dict)
    regional: float = 0.5

    def __post_init__(self) -> None:
        enabled_types(self.types)
        check_types("gate.chances", self.chances)
        check_probability("gate.chance", self.chance)
        check_probability("gate.regional", self.regional)
        for name, value in self.chances.items():
            check_probability(f"gate.chances.{name}", value)

    def draw(self, generator: torch.Generator) -> tuple[ArtefactStep, ...]:
        """Draw the steps of one sample, in random order."""
        enabled = enabled_types(self.types)
        return tuple(
            ArtefactStep(entry.type, entry.strength, entry.region < self.regional)
            for entry in draw_type_numbers(generator)
            if entry.type in enabled and entry.selection < self.chances.get(entry.type, self.chance)
        )


class TypeDraw(NamedTuple):
    """Random numbers drawn for one type.

    Args:
        type: one of `TYPES`.
        selection: uniform in [0, 1); the type is chosen if its probability is larger.
        strength: uniform in (0, 1].
        region: uniform in [0, 1); the type acts only within a region if the probability ``regional`` is larger.
    """

    type: str
    selection: float
    strength: float
    region: float


def draw_type_numbers(generator: torch.Generator) -> tuple[TypeDraw, ...]:
    """Draw the random numbers of every type, in random order.

    They do not depend on the settings of a gate. Each type has its own generator, so that adding a type does not change
    the numbers of the other types or their relative order.
    """
    seed = int(torch.randint(2**62, (), generator=generator))
    draws = []
    for name in TYPES:
        type_generator = named_generator(name, seed)
        selection, strength, region, order = torch.rand(4, generator=type_generator, dtype=torch.float64).tolist()
        draws.append((order, TypeDraw(name, selection, 1 - strength, region)))
    return tuple(entry for _, entry in sorted(draws))
