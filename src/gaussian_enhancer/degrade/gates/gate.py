"""Gates: which artefacts a sample gets, how strongly, in which order, and whether in a region only."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol, runtime_checkable

import torch

from gaussian_enhancer.degrade.artefact_types import TYPES
from gaussian_enhancer.degrade.artefacts.rng import named_generator
from gaussian_enhancer.errors import InputError


@dataclass(frozen=True)
class ArtefactStep:
    """One artefact that a gate let through.

    Args:
        type: one of `TYPES`.
        strength: in (0, 1].
        regional: whether it acts within a soft region alone.

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
    """Decides, sample by sample, which artefacts are applied."""

    def draw(self, generator: torch.Generator) -> tuple[ArtefactStep, ...]:
        """The steps of one sample, in the order in which they are applied.

        Args:
            generator: source of randomness.
        """
        ...


def check_types(where: str, names: Iterable[str]) -> None:
    """Refuse names that are no types.

    Args:
        where: what the names came from, as the user knows it.
        names: to be looked up in `TYPES`.

    Raises:
        InputError: a name is no type.
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
        InputError: the value is no number in [0, 1].
    """
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value <= 1:
        raise InputError(where, f"is {value!r}", "give a number from 0 to 1")


@dataclass(frozen=True)
class NoGate:
    """Nothing passes: stage 1 returns the photo."""

    def draw(self, generator: torch.Generator) -> tuple[ArtefactStep, ...]:
        """No steps."""
        return ()


@dataclass(frozen=True)
class AllGate:
    """Every type at once, each at a random strength; the paper's negative example.

    Args:
        types: switches by type; a type that is not named is on.
    """

    types: Mapping[str, bool] = field(default_factory=dict)

    def __post_init__(self) -> None:
        enabled_types(self.types)

    def draw(self, generator: torch.Generator) -> tuple[ArtefactStep, ...]:
        """All steps in random order, over the whole image."""
        on = enabled_types(self.types)
        return tuple(ArtefactStep(entry.type, entry.strength) for entry in draw_lots(generator) if entry.type in on)


@dataclass(frozen=True)
class RandomGate:
    """The paper's gate: each type passes with a probability, at a random strength, sometimes in a region only.

    With the defaults 3.3 types of 11 act on average, and one sample of 50 stays clean. Which types are switched off
    changes nothing about the others: the same generator draws the same chances, strengths and order for them.

    Args:
        types: switches by type; a type that is not named is on.
        chance: probability that a type passes.
        chances: probabilities by type, for types that differ from ``chance``.
        regional: probability that a type that passed acts within a soft region alone.

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
        """The steps whose lot fell below their chance, in random order."""
        on = enabled_types(self.types)
        return tuple(
            ArtefactStep(entry.type, entry.strength, entry.place < self.regional)
            for entry in draw_lots(generator)
            if entry.type in on and entry.lot < self.chances.get(entry.type, self.chance)
        )


class Drawn(NamedTuple):
    """Random numbers drawn for one type.

    Args:
        type: one of `TYPES`.
        lot: uniform in [0, 1); the type passes where its chance is larger.
        strength: uniform in (0, 1].
        place: uniform in [0, 1); the type acts within a region where the regional chance is larger.
    """

    type: str
    lot: float
    strength: float
    place: float


def draw_lots(generator: torch.Generator) -> tuple[Drawn, ...]:
    """Lots for every type, in random order; gates that share a generator's state differ by their settings alone.

    Each type has a generator of its own, so that a new type leaves the lots of the others, and their order, as they
    were.
    """
    seed = int(torch.randint(2**62, (), generator=generator))
    lots = {}
    for name in TYPES:
        lot, strength, position, order = torch.rand(
            4, generator=named_generator(name, seed), dtype=torch.float64
        ).tolist()
        lots[name] = order, Drawn(name, lot, 1 - strength, position)
    return tuple(entry for _, entry in sorted(lots.values()))
