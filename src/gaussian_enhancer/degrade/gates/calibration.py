"""Calibration of the adaptive gate: response of the fingerprint to each type, and the mixture that explains it.

Axes: t types, s strengths, e energies.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.degrade.artefacts.rng import named_generator, spawn
from gaussian_enhancer.degrade.artefacts.view import View
from gaussian_enhancer.degrade.gates.fingerprint import error_energies
from gaussian_enhancer.degrade.gates.gate import ArtefactStep
from gaussian_enhancer.degrade.manual import degrade
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.types import quantise_8_bit

STRENGTHS = (0.1, 0.25, 0.5, 0.75, 1.0)
"""Where responses are measured; between them, and down to none at 0, they are interpolated."""
ROUNDING = 1 / 255**2 / 12
"""Energy of rounding to 8 bits: differences below it do not matter to a calibration."""
MINOR = 0.1
"""Share of the largest energy below which another's errors count as if it were that large."""
SPREAD = 1e-2
"""Share of a ridge on the contributions: types that look alike share what they explain in place of one taking all."""


@dataclass(frozen=True)
class Responses:
    """Mean energies that types cause, by strength.

    Args:
        types: names of the types.
        curves: energies of `gaussian_enhancer.degrade.gates.fingerprint.ENERGIES` at 0 and at each of `STRENGTHS`.
    """

    types: tuple[str, ...]
    curves: Float[Tensor, "t s e"]

    def mean_below(self, limits: Float[Tensor, " t"]) -> Float[Tensor, "t e"]:
        """Mean energies at strengths uniform in (0, limit]: one over the limit, times the integral up to there.

        Args:
            limits: of each type, in (0, 1].
        """
        knots = torch.tensor((0.0, *STRENGTHS), dtype=torch.float64)
        ends = torch.minimum(knots, limits[:, None])
        steps = ends.diff(dim=1)
        share = steps / knots.diff()
        first = self.curves[:, :-1]
        last = first + share[..., None] * self.curves.diff(dim=1)
        return (steps[..., None] * (first + last) / 2).sum(1) / limits[:, None]


def responses(
    photos: Sequence[Float[Tensor, "3 _ _"]],
    types: Sequence[str],
    generator: torch.Generator,
    *,
    regional: float,
    draws: int,
) -> Responses:
    """Measure how each type, alone, changes photos of a scene.

    The same draw is measured at every strength, so that a curve shows the strength and not the draws.

    Args:
        photos: sRGB in [0, 1].
        types: which are measured.
        generator: source of randomness, on the CPU.
        regional: share of draws that act within a soft region alone.
        draws: of each type on each photo.

    Raises:
        InputError: there are no photos or no draws.
    """
    if not photos or draws < 1:
        raise InputError("calibration", f"got {len(photos)} photos and {draws} draws", "give at least one of each")
    total = len(photos) * draws
    curves = []
    common = int(torch.randint(2**62, (), generator=generator))
    for name in types:
        own = named_generator(name, common)
        offset = torch.rand((), generator=own).item()
        measured = []
        for index in range(total):
            within_region = (index + offset) / total < regional
            seed = int(torch.randint(2**62, (), generator=own))
            measured.append(_response(photos[index % len(photos)], name, within_region, seed))
        mean = torch.stack(measured).mean(0)
        curves.append(torch.cat([torch.zeros_like(mean[:1]), mean]))
    return Responses(tuple(types), torch.stack(curves))


def _response(photo: Float[Tensor, "3 h w"], name: str, regional: bool, seed: int) -> Float[Tensor, "s e"]:
    """Energies at each strength for one draw; colours are rounded to 8 bits as the simulator's are."""
    count = len(STRENGTHS)
    steps = [(ArtefactStep(name, strength, regional),) for strength in STRENGTHS]
    generators = [spawn(1, torch.Generator().manual_seed(seed))[0] for _ in range(count)]
    degraded = degrade(View(photo.float().expand(count, *photo.shape)), steps, generators).image
    return torch.stack([error_energies(one, photo) for one in quantise_8_bit(degraded)])


def solve_gate(measured: Responses, wanted: Float[Tensor, " e"]) -> tuple[Float[Tensor, " t"], Float[Tensor, " t"]]:
    """Chances and limits of each type; see `gaussian_enhancer.degrade.gates.adaptive.calibrate_gate`.

    Args:
        measured: responses of the types.
        wanted: energies to reach.
    """
    scale = wanted.clamp_min(max(ROUNDING, MINOR * float(wanted.max())))
    limits = torch.ones(len(measured.types), dtype=torch.float64)
    whole = (measured.mean_below(limits) / scale).sum(1).clamp_min(1e-300)
    for _ in range(4):
        here = measured.mean_below(limits)
        weights = solve_weights(here / scale, wanted / scale)
        share = weights * (here / scale).sum(1) / whole
        chances = share.sqrt().clamp_max(1)
        limits = _strength_limits(measured, scale, share / chances.clamp_min(1e-12))
    return solve_weights(measured.mean_below(limits) / scale, wanted / scale).clamp_max(1), limits


def solve_weights(responses: Float[Tensor, "t e"], wanted: Float[Tensor, " e"]) -> Float[Tensor, " t"]:
    """Non-negative weights under which responses add up to what is wanted, with a small ridge on each contribution.

    Args:
        responses: of each type.
        wanted: their weighted sum.
    """
    from scipy.optimize import nnls

    size = responses.norm(dim=1)
    columns = torch.where(size[:, None] > 0, responses / size.clamp_min(1e-300)[:, None], 0.0)
    ridge = torch.eye(len(size), dtype=torch.float64) * SPREAD**0.5
    matrix = torch.cat([columns.T, ridge])
    goal = torch.cat([wanted, torch.zeros_like(size)])
    contributions = torch.from_numpy(nnls(matrix.numpy(), goal.numpy())[0])
    return torch.where(size > 0, contributions / size.clamp_min(1e-300), 0.0)


def _strength_limits(
    measured: Responses, scale: Float[Tensor, " e"], share: Float[Tensor, " t"]
) -> Float[Tensor, " t"]:
    """Where the mean response below a limit is a given share of the whole one, by bisection."""
    count = len(measured.types)
    low, high = torch.full((count,), 1e-3, dtype=torch.float64), torch.ones(count, dtype=torch.float64)
    goal = share * (measured.mean_below(high) / scale).sum(1)
    for _ in range(30):
        middle = (low + high) / 2
        under = (measured.mean_below(middle) / scale).sum(1) < goal
        low, high = torch.where(under, middle, low), torch.where(under, high, middle)
    return high
