"""The optimised parameters with their Adam moments, which stay aligned when Gaussians are added or removed.

Axes: n Gaussians, m Gaussians that remain or join, k spherical-harmonics coefficients.
"""

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.splat.fit.adam import Moments, adam_step
from gaussian_enhancer.typed import check_fields
from gaussian_enhancer.types import Gaussians

OPTIMISED_PARAMETERS = ("means", "log_scales", "quaternions", "opacity_logits", "sh")
MOMENTS = ("exp_avg", "exp_avg_sq")


@dataclass(frozen=True)
class LearningRates:
    """Adam's learning rates by parameter; the defaults are those of 3DGS, which are meant for 30,000 steps.

    Short fits use larger rates: all but the opacities' are multiplied by ``boost``. Measured on two sparse captures, a
    boost of 4 gains about 4 dB on held-out views after 300 steps; after 1000 steps 5.5 is worse than 4.

    Args:
        means: rate of the centres at the first step, in camera extents.
        means_final: rate of the centres at the last step, in camera extents; exponential decay in between.
        log_scales: rate of the logarithmic scales.
        quaternions: rate of the rotations.
        opacity_logits: rate of the opacities before the sigmoid.
        sh_base: rate of the constant colour.
        sh_rest: rate of the view-dependent colour.
        boost: factor for short fits; 0 chooses sqrt(16,000 / steps) within 1 and 4.
    """

    means: float = 1.6e-4
    means_final: float = 1.6e-6
    log_scales: float = 5e-3
    quaternions: float = 1e-3
    opacity_logits: float = 5e-2
    sh_base: float = 2.5e-3
    sh_rest: float = 1.25e-4
    boost: float = 0.0

    def __post_init__(self) -> None:
        check_fields(self, "rates.")
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if not (0 < value < 1e3 or (field.name == "boost" and value == 0)):
                raise InputError(f"rates.{field.name}", f"is {value}", "give a positive number")

    def without_boost(self, steps: int) -> "LearningRates":
        """The rates for a fit of ``steps`` steps with the boost multiplied in, so that their own boost is 1."""
        boost = self.boost or min(4.0, max(1.0, math.sqrt(16_000 / steps)))
        unscaled = {"opacity_logits": self.opacity_logits, "boost": 1.0}
        scaled = {f.name: boost * getattr(self, f.name) for f in dataclasses.fields(self) if f.name not in unscaled}
        return LearningRates(**scaled, **unscaled)


class SplatOptimiser:
    """Gaussians as leaf tensors under Adam; rows can be dropped and appended.

    Source: Kerbl et al., 3D Gaussian Splatting, SIGGRAPH 2023, section 7.1 (rates, decay, epsilon).

    Args:
        gaussians: the initial Gaussians.
        rates: learning rates.
        extent: camera extent in scene units.
        steps: number of steps of the fit, over which the centres' rate decays.
        fade: factor that the other rates reach at the last step by exponential decay.
    """

    def __init__(
        self, gaussians: Gaussians, rates: LearningRates, extent: float, steps: int, fade: float = 1.0
    ) -> None:
        self._rates, self._extent, self._steps, self._fade = rates.without_boost(steps), extent, steps, fade
        self._leaves: dict[str, Tensor] = {}
        self._moments: dict[str, Moments] = {}
        self._step_count = 0
        for name, value in _columns(gaussians).items():
            leaf = value.detach().clone().contiguous()
            self._set(name, leaf, Moments(torch.zeros_like(leaf), torch.zeros_like(leaf)))

    def __len__(self) -> int:
        return len(self._leaves["means"])

    def gaussians(self, sh_degree: int | None = None) -> Gaussians:
        """The current splat, differentiable in the parameters.

        Args:
            sh_degree: highest degree of colour to include; None includes all.
        """
        leaves = dict(self._leaves)
        if sh_degree is not None:
            leaves["sh"] = leaves["sh"][:, : (sh_degree + 1) ** 2]
        return Gaussians(**leaves)

    def detached_gaussians(self, smoothing: Tensor | None = None) -> Gaussians:
        """The current splat with all coefficients, without gradients.

        Args:
            smoothing: standard deviation of the 3D filter of each Gaussian, which is not optimised; None for no filter.
        """
        return Gaussians(**{name: leaf.detach() for name, leaf in self._leaves.items()}, smoothing=smoothing)

    def step(self, number: int) -> None:
        """Apply the gradients and clear them.

        Args:
            number: the step's number, from 0; sets the centres' rate.
        """
        self._step_count += 1
        for name, leaf in self._leaves.items():
            if leaf.grad is not None:
                rate, first_rate = self._rate(name, number)
                adam_step(leaf.detach(), leaf.grad, self._moments[name], self._step_count, rate, first_rate)
                leaf.grad = None

    def keep(self, index: Tensor) -> None:
        """Drop all Gaussians but those that a mask or an index tensor selects, moments included."""
        self._rewrite(lambda name, value: value[index])

    def append(self, others: Gaussians) -> None:
        """Add Gaussians at the end; their moments start at zero.

        Args:
            others: the Gaussians to add, with as many colour coefficients as the present ones.
        """
        added = _columns(others)

        def extend(name: str, value: Tensor) -> Tensor:
            field, _, moment = name.partition(".")
            new_values = added[field].detach()
            return torch.cat([value, torch.zeros_like(new_values) if moment else new_values])

        self._rewrite(extend)

    def replace(self, name: str, values: Tensor) -> None:
        """Set one parameter's values; its moments are kept.

        Args:
            name: name of the parameter.
            values: the new values, of the same shape.
        """
        self._rewrite(lambda field, value: values.clone() if field == name else value)

    def overwrite(self, index: Tensor, others: Gaussians) -> None:
        """Replace Gaussians by others and reset their moments to zero.

        Args:
            index: indices of the Gaussians to replace, without repetition.
            others: the new Gaussians, one per index, with as many colour coefficients.
        """
        columns = _columns(others)

        def substitute(name: str, value: Tensor) -> Tensor:
            field, _, moment = name.partition(".")
            new_values = torch.zeros_like(columns[field]) if moment else columns[field].detach()
            return value.index_copy(0, index, new_values)

        self._rewrite(substitute)

    def shift(self, index: Tensor, offsets: Float[Tensor, "m 3"]) -> None:
        """Move some centres; their moments are kept.

        Args:
            index: indices of the Gaussians, without repetition.
            offsets: displacements in scene units.
        """
        self._leaves["means"].detach().index_add_(0, index, offsets)

    def means_rate(self, number: int) -> float:
        """The centres' learning rate at a step (counted from 0), in scene units."""
        return self._rate("means", number)[0]

    def state(self) -> dict[str, Any]:
        """State for a checkpoint as plain tensors; the colour is stored in two parts."""
        values: dict[str, Any] = {}
        for name, leaf in self._leaves.items():
            moments = self._moments[name]
            tensors = {"": leaf.detach(), ".exp_avg": moments.exp_avg, ".exp_avg_sq": moments.exp_avg_sq}
            for suffix, tensor in tensors.items():
                values |= {part + suffix: value for part, value in _parts(name, tensor).items()}
            values |= {f"{part}.step": torch.tensor(float(self._step_count)) for part in _parts(name, leaf)}
        return values

    def restore(self, values: dict[str, Any]) -> None:
        """Restore a state that `state` returned."""
        for name in self._leaves:
            leaf = _join_parts(values, name, "")
            has_moments = "means.exp_avg" in values
            moments = [
                _join_parts(values, name, f".{key}") if has_moments else torch.zeros_like(leaf) for key in MOMENTS
            ]
            self._set(name, leaf, Moments(*moments))
        self._step_count = int(values.get("means.step", 0))

    def _rewrite(self, change: Callable[[str, Tensor], Tensor]) -> None:
        """Replace every leaf and moment by a function of its name ("means", "means.exp_avg") and value."""
        for name, leaf in list(self._leaves.items()):
            old_moments = self._moments[name]
            moments = (change(f"{name}.{key}", getattr(old_moments, key)).contiguous() for key in MOMENTS)
            self._set(name, change(name, leaf.detach()).contiguous(), Moments(*moments))

    def _set(self, name: str, values: Tensor, moments: Moments) -> None:
        self._leaves[name], self._moments[name] = values.requires_grad_(), moments

    def _rate(self, name: str, number: int) -> tuple[float, float | None]:
        """A parameter's learning rate at a step, and the rate of the constant colour (None for other parameters)."""
        progress = min(1.0, number / max(1, self._steps))
        if name == "means":
            return self._extent * self._rates.means ** (1 - progress) * self._rates.means_final**progress, None
        decay = self._fade**progress
        if name == "sh":
            return decay * self._rates.sh_rest, decay * self._rates.sh_base
        return decay * float(getattr(self._rates, name)), None


def _columns(gaussians: Gaussians) -> dict[str, Float[Tensor, "n ..."]]:
    """The optimised tensors by name."""
    return {name: getattr(gaussians, name) for name in OPTIMISED_PARAMETERS}


def _parts(name: str, tensor: Tensor) -> dict[str, Tensor]:
    """A parameter's tensor under the names of checkpoints: colour in two parts, its constant and the rest."""
    if name != "sh":
        return {name: tensor}
    return {"sh_base": tensor[:, :1].detach().clone(), "sh_rest": tensor[:, 1:].detach().clone()}


def _join_parts(values: dict[str, Any], name: str, suffix: str) -> Tensor:
    """The inverse of `_parts`, as a new tensor."""
    if name != "sh":
        return values[name + suffix].clone()  # type: ignore[no-any-return]
    return torch.cat([values["sh_base" + suffix], values["sh_rest" + suffix]], 1)
