"""Calibration of the adaptive gate: responses of the error energies to each type, and the mixture that explains them.

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
"""Strengths at which responses are measured; between them, and to zero at strength 0, they are interpolated."""
ROUNDING = 1 / 255**2 / 12
"""Energy of rounding to 8 bits; smaller differences are ignored in the calibration."""
MIN_RELATIVE_ENERGY = 0.1
"""Errors of an energy are relative to it, or to at least this share of the largest energy."""
RIDGE_WEIGHT = 1e-2
"""Weight of the ridge on the contributions, which spreads an energy over types of similar response."""


@dataclass(frozen=True)
class Responses:
    """Mean error energies that each type causes, by strength.

    Args:
        types: names of the types.
        curves: energies of `gaussian_enhancer.degrade.gates.fingerprint.ENERGIES` at 0 and at each of `STRENGTHS`.
    """

    types: tuple[str, ...]
    curves: Float[Tensor, "t s e"]

    def mean_below(self, limits: Float[Tensor, " t"]) -> Float[Tensor, "t e"]:
        """Mean energies at strengths uniform in (0, limit]: the integral from 0 to the limit, divided by the limit.

        Args:
            limits: limit of each type, in (0, 1].
        """
        knots = torch.tensor((0.0, *STRENGTHS), dtype=torch.float64)
        ends = torch.minimum(knots, limits[:, None])
        widths = ends.diff(dim=1)
        fraction = widths / knots.diff()
        start = self.curves[:, :-1]
        end = start + fraction[..., None] * self.curves.diff(dim=1)
        return (widths[..., None] * (start + end) / 2).sum(1) / limits[:, None]


def measure_responses(
    photos: Sequence[Float[Tensor, "3 _ _"]],
    types: Sequence[str],
    generator: torch.Generator,
    *,
    regional: float,
    draws: int,
) -> Responses:
    """Measure the error energies that each type alone causes on photos of a scene.

    All strengths use the same random draws, so that a curve shows the effect of the strength only.

    Args:
        photos: sRGB in [0, 1].
        types: types to measure.
        generator: source of randomness, on the CPU.
        regional: share of draws that act only within a soft region.
        draws: number of draws of each type on each photo.

    Raises:
        InputError: there are no photos or no draws.
    """
    if not photos or draws < 1:
        raise InputError("calibration", f"got {len(photos)} photos and {draws} draws", "give at least one of each")
    total = len(photos) * draws
    curves = []
    common_seed = int(torch.randint(2**62, (), generator=generator))
    for name in types:
        type_generator = named_generator(name, common_seed)
        offset = torch.rand((), generator=type_generator).item()
        measured = []
        for index in range(total):
            is_regional = (index + offset) / total < regional
            seed = int(torch.randint(2**62, (), generator=type_generator))
            measured.append(_response(photos[index % len(photos)], name, is_regional, seed))
        mean = torch.stack(measured).mean(0)
        curves.append(torch.cat([torch.zeros_like(mean[:1]), mean]))
    return Responses(tuple(types), torch.stack(curves))


def _response(photo: Float[Tensor, "3 h w"], name: str, regional: bool, seed: int) -> Float[Tensor, "s e"]:
    """Energies at each strength for one draw; colours are rounded to 8 bits, as in the simulator."""
    count = len(STRENGTHS)
    steps = [(ArtefactStep(name, strength, regional),) for strength in STRENGTHS]
    generators = [spawn(1, torch.Generator().manual_seed(seed))[0] for _ in range(count)]
    degraded = degrade(View(photo.float().expand(count, *photo.shape)), steps, generators).image
    return torch.stack([error_energies(image, photo) for image in quantise_8_bit(degraded)])


def solve_gate(responses: Responses, target: Float[Tensor, " e"]) -> tuple[Float[Tensor, " t"], Float[Tensor, " t"]]:
    """Probabilities and limits of the types; see `gaussian_enhancer.degrade.gates.adaptive.calibrate_gate`.

    Args:
        responses: responses of the types.
        target: energies that the gate's samples have on average.
    """
    scale = target.clamp_min(max(ROUNDING, MIN_RELATIVE_ENERGY * float(target.max())))
    limits = torch.ones(len(responses.types), dtype=torch.float64)
    full_response = (responses.mean_below(limits) / scale).sum(1).clamp_min(1e-300)
    for _ in range(4):
        limited = responses.mean_below(limits) / scale
        weights = solve_weights(limited, target / scale)
        share = weights * limited.sum(1) / full_response
        chances = share.sqrt().clamp_max(1)
        limits = _strength_limits(responses, scale, share / chances.clamp_min(1e-12))
    return solve_weights(responses.mean_below(limits) / scale, target / scale).clamp_max(1), limits


def solve_weights(responses: Float[Tensor, "t e"], target: Float[Tensor, " e"]) -> Float[Tensor, " t"]:
    """Non-negative least squares for the weights of the responses, with a small ridge on each contribution.

    Args:
        responses: energies of each type.
        target: energies that their weighted sum approximates.
    """
    from scipy.optimize import nnls

    norms = responses.norm(dim=1)
    unit_responses = torch.where(norms[:, None] > 0, responses / norms.clamp_min(1e-300)[:, None], 0.0)
    ridge = torch.eye(len(norms), dtype=torch.float64) * RIDGE_WEIGHT**0.5
    matrix = torch.cat([unit_responses.T, ridge])
    right_side = torch.cat([target, torch.zeros_like(norms)])
    contributions = torch.from_numpy(nnls(matrix.numpy(), right_side.numpy())[0])
    return torch.where(norms > 0, contributions / norms.clamp_min(1e-300), 0.0)


def _strength_limits(
    responses: Responses, scale: Float[Tensor, " e"], share: Float[Tensor, " t"]
) -> Float[Tensor, " t"]:
    """Limits at which the mean response is a given share of that at limit 1, by bisection."""
    count = len(responses.types)
    low, high = torch.full((count,), 1e-3, dtype=torch.float64), torch.ones(count, dtype=torch.float64)
    target = share * (responses.mean_below(high) / scale).sum(1)
    for _ in range(30):
        middle = (low + high) / 2
        is_below = (responses.mean_below(middle) / scale).sum(1) < target
        low, high = torch.where(is_below, middle, low), torch.where(is_below, high, middle)
    return high
