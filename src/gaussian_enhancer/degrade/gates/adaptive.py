"""The adaptive gate: probabilities and strengths of artefacts, calibrated to the errors of a scene's renders."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.degrade.artefact_types import TYPES
from gaussian_enhancer.degrade.gates.calibration import measure_responses, solve_gate
from gaussian_enhancer.degrade.gates.fingerprint import ENERGIES, Fingerprint, fingerprint_of_training_views
from gaussian_enhancer.degrade.gates.gate import (
    ArtefactStep,
    Gate,
    check_probability,
    check_types,
    draw_type_numbers,
    enabled_types,
)
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import matching_paths, write_json
from gaussian_enhancer.scene.json_file import get_member, get_number, read_json
from gaussian_enhancer.scene.rendered import RenderedSet
from gaussian_enhancer.scene.splits import evenly_spaced


class Growth(NamedTuple):
    """Power law from the error energy of training views to that of held-out views: factor * energy ^ power.

    Args:
        factor: factor, > 0.
        power: exponent. Below 1, the two differ least for bad renders, whose fit has not overfitted its photos.
    """

    factor: float
    power: float = 1.0


HELD_OUT_GROWTH: Mapping[str, Growth] = {
    "blur": Growth(0.52, 0.88),
    "noise": Growth(0.88, 0.97),
    "anisotropy": Growth(0.39, 0.87),
    "banding": Growth(0.10, 0.63),
    "low_frequency": Growth(0.57, 0.73),
    "floater": Growth(0.81, 0.83),
}
"""Growth of each energy from training views, where fingerprints are measured, to held-out views, which are simulated.

Fitted by least squares in the logarithms over 72 snapshots of 24 training runs (docs/results/fingerprints.jsonl, made
by ablations/fingerprints.py). Single scenes deviate strongly, for low frequencies by a factor of three in either
direction. A capture with enough photos should be calibrated on held-out photos, without growth.
"""


REGIONAL = 0.5
"""Default probability that a chosen type acts only within a soft region, also in the calibration."""


@dataclass(frozen=True)
class AdaptiveGate:
    """Gate in which each type has its own probability and its own largest strength.

    Args:
        chances: probability by type; 0 for a type that is not named.
        limits: largest strength by type, in (0, 1]; 1 for a type that is not named.
        regional: probability that a chosen type acts only within a soft region.
        types: switches by type; a type that is not named is on.

    Raises:
        InputError: a name is not a type, or a number is out of range.
    """

    chances: Mapping[str, float]
    limits: Mapping[str, float] = field(default_factory=dict)
    regional: float = REGIONAL
    types: Mapping[str, bool] = field(default_factory=dict)

    def __post_init__(self) -> None:
        enabled_types(self.types)
        check_types("gate.chances", self.chances)
        check_types("gate.limits", self.limits)
        check_probability("gate.regional", self.regional)
        for name, value in (*self.chances.items(), *self.limits.items()):
            check_probability(f"gate's chance or limit of {name}", value)
        for name, value in self.limits.items():
            if value == 0:
                raise InputError(f"gate.limits.{name}", "is 0", "give a number above 0, or a chance of 0")

    def draw(self, generator: torch.Generator) -> tuple[ArtefactStep, ...]:
        """Draw the steps of one sample, in random order."""
        enabled = enabled_types(self.types)
        return tuple(
            ArtefactStep(entry.type, entry.strength * self.limits.get(entry.type, 1.0), entry.region < self.regional)
            for entry in draw_type_numbers(generator)
            if entry.type in enabled and entry.selection < self.chances.get(entry.type, 0.0)
        )

    @property
    def disabled_types(self) -> tuple[str, ...]:
        """Types that are never drawn, because their probability is 0 or they are switched off."""
        enabled = enabled_types(self.types)
        return tuple(name for name in TYPES if name not in enabled or self.chances.get(name, 0.0) == 0)

    def table(self) -> str:
        """Probabilities and limits, one type per line, and the types that are left out, for the terminal."""
        shown = [name for name in self.chances if name not in self.disabled_types]
        lines = [f"{name:<14}{self.chances[name]:8.3f}{self.limits.get(name, 1.0):8.3f}" for name in shown]
        footer = [f"left out: {', '.join(self.disabled_types)}"] if self.disabled_types else []
        return "\n".join((f"{'type':<14}{'chance':>8}{'limit':>8}", *lines, *footer))

    def to_file(self, path: str | Path) -> None:
        """Write probabilities, limits and ``regional`` as JSON, atomically; switches are not saved.

        Raises:
            InputError: the file cannot be written.
        """
        record = {"chances": dict(self.chances), "limits": dict(self.limits), "regional": self.regional}
        write_json(path, record, indent=1)

    @classmethod
    def from_file(cls, path: str | Path, types: Mapping[str, bool] | None = None) -> "AdaptiveGate":
        """Read a gate from a file written by `to_file`.

        Args:
            path: the file.
            types: switches by type; a type that is not named is on.

        Raises:
            InputError: the file is missing or malformed, lacks an entry, or has a value that is out of range.
        """
        record = read_json(Path(path))
        chances, limits = (_numbers(record, key, path) for key in ("chances", "limits"))
        return cls(chances, limits, get_number(record, "regional", path), types or {})


def _numbers(record: object, key: str, path: str | Path) -> dict[str, float]:
    entries = get_member(record, key, path)
    if not isinstance(entries, dict):
        raise InputError(path, f"has {key} = {entries!r}", "give a number for each type")
    return {name: get_number(entries, name, f"{path}, {key}") for name in entries}


@dataclass(frozen=True)
class MixedGate:
    """Gate that draws each sample by one of several gates, chosen with equal probability.

    Args:
        gates: gates, for instance of different scenes.

    Raises:
        InputError: there are no gates.
    """

    gates: Sequence[Gate]

    def __post_init__(self) -> None:
        if not self.gates:
            raise InputError("gate.file", "names no file", "give at least one")

    def draw(self, generator: torch.Generator) -> tuple[ArtefactStep, ...]:
        """Draw the steps of one sample by a random one of the gates."""
        return self.gates[int(torch.randint(len(self.gates), (), generator=generator))].draw(generator)


def adaptive_gate(file: str | Sequence[str], types: Mapping[str, bool] | None = None) -> Gate:
    """Read the calibrated gate of a file, or a `MixedGate` of several files.

    Args:
        file: files written by `AdaptiveGate.to_file`, or patterns such as ``runs/gates/*.json``.
        types: switches by type; a type that is not named is on.

    Raises:
        InputError: a file is missing or malformed, a pattern matches no file, or a switch names no type.
    """
    patterns = [file] if isinstance(file, str) else list(file)
    paths: list[Path] = []
    for pattern in patterns:
        matches = matching_paths(pattern)
        if not matches:
            raise InputError(pattern, "names no file of a gate", "calibrate gates first, or correct the pattern")
        paths += matches
    gates = tuple(AdaptiveGate.from_file(path, types) for path in paths)
    return gates[0] if len(gates) == 1 else MixedGate(gates)


def calibrate_on_splat(
    rendered: RenderedSet, generator: torch.Generator, *, types: Mapping[str, bool] | None = None, photos: int = 8
) -> AdaptiveGate:
    """Calibrate the gate of a fitted splat on its training views.

    Args:
        rendered: a fitted run's renders, including its training views.
        generator: source of randomness, on the CPU.
        types: switches by type; a type that is not named is on.
        photos: maximum number of training photos, evenly spaced, on which the types' responses are measured.

    Raises:
        InputError: no training view has both a render and a photo.
    """
    fingerprint = fingerprint_of_training_views(rendered)
    readers = [view.read_photo for view in rendered.references if view.read_photo is not None]
    return calibrate_gate(fingerprint, [read() for read in evenly_spaced(readers, photos)], generator, types=types)


def calibrate_gate(
    fingerprint: Fingerprint,
    photos: Sequence[Float[Tensor, "3 _ _"]],
    generator: torch.Generator,
    *,
    types: Mapping[str, bool] | None = None,
    held_out: Mapping[str, Growth] = HELD_OUT_GROWTH,
    draws: int = 2,
) -> AdaptiveGate:
    """Find the gate whose simulated error energies equal those that a fingerprint implies for held-out views.

    Let e be the target energies, and A_t the mean energies of type t at strengths uniform in (0, 1]. Non-negative least
    squares finds the weights w >= 0 that minimise the relative error |(sum_t w_t A_t - e) / e|; for energies below a
    tenth of the largest one, the error is relative to that tenth. Type t then gets the probability p = min(1, sqrt(w)),
    and the limit at which its mean response is w / p of A_t. As the limit changes not only the size of a response but
    also its distribution over energies, weights and limits are computed alternately. The final probabilities are solved
    for once more with the final limits.

    Args:
        fingerprint: fingerprint of the scene's training views.
        photos: photos of the scene, sRGB in [0, 1], of the size that the gate will be used on.
        generator: source of randomness, on the CPU.
        types: switches by type; a type that is not named is on.
        held_out: growth of each energy from training to held-out views; none for energies that are not named.
        draws: number of draws of each type on each photo.

    Raises:
        InputError: there are no photos, or a name is not a type or not an energy.
    """
    unknown = [name for name in held_out if name not in ENERGIES]
    if unknown:
        raise InputError(f"held_out.{unknown[0]}", "is no energy", f"choose among {', '.join(ENERGIES)}")
    enabled = enabled_types(types or {})
    factor, power = torch.tensor([held_out.get(name, Growth(1.0)) for name in ENERGIES], dtype=torch.float64).T
    responses = measure_responses(photos, enabled, generator, regional=REGIONAL, draws=draws)
    chances, limits = solve_gate(responses, factor * fingerprint.energies() ** power)
    return AdaptiveGate(
        dict(zip(enabled, chances.tolist(), strict=True)),
        dict(zip(enabled, limits.tolist(), strict=True)),
        types=types or {},
    )
