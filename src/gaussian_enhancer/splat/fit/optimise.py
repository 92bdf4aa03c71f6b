"""The parameters under optimisation with their Adam moments, which stay aligned when Gaussians come and go.

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
from gaussian_enhancer.typed import check_fields
from gaussian_enhancer.types import Gaussians

MOMENTS = ("exp_avg", "exp_avg_sq")


@dataclass(frozen=True)
class LearningRates:
    """Steps of Adam by parameter, at the values of 3DGS, which are meant for 30,000 steps.

    Short fits take larger ones: all but the opacities' are multiplied by ``boost``. Measured on two sparse captures, a
    boost of 4 gains about 4 dB on held-out views after 300 steps; after 1000 steps 5.5 is worse than 4.

    Args:
        means: of the centres at the first step, in camera extents.
        means_final: of the centres at the last step, in camera extents; exponential in between.
        log_scales: of the logarithmic scales.
        quaternions: of the rotations.
        opacity_logits: of the opacities before the sigmoid.
        sh_base: of the constant colour.
        sh_rest: of the view-dependent colour.
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

    def boosted(self, steps: int) -> "LearningRates":
        """The rates for a fit of so many steps, with boost 1."""
        boost = self.boost or min(4.0, max(1.0, math.sqrt(16_000 / steps)))
        kept = {"opacity_logits": self.opacity_logits, "boost": 1.0}
        scaled = {f.name: boost * getattr(self, f.name) for f in dataclasses.fields(self) if f.name not in kept}
        return LearningRates(**scaled, **kept)


class SplatOptimiser:
    """Gaussians as leaf tensors under fused Adam; rows can be dropped and appended.

    Source: Kerbl et al., 3D Gaussian Splatting, SIGGRAPH 2023, section 7.1 (rates, decay, epsilon).

    Args:
        gaussians: where to start from.
        rates: learning rates.
        extent: scene units of one camera extent.
        steps: length of the fit, over which the centres' rate decays.
    """

    def __init__(self, gaussians: Gaussians, rates: LearningRates, extent: float, steps: int) -> None:
        rates = rates.boosted(steps)
        self._rates, self._extent, self._steps = rates, extent, steps
        groups = []
        for name, value in _columns(gaussians).items():
            leaf = value.detach().clone().contiguous().requires_grad_()
            rate = rates.means * extent if name == "means" else getattr(rates, name)
            groups.append({"params": [leaf], "lr": rate, "name": name})
        self._adam = torch.optim.Adam(groups, eps=1e-15, fused=True)

    def __len__(self) -> int:
        return len(self._leaf("means"))

    def gaussians(self, sh_degree: int | None = None) -> Gaussians:
        """The present splat, differentiable in the leaves.

        Args:
            sh_degree: highest degree of colour to include; None includes all.
        """
        rest = self._leaf("sh_rest")
        if sh_degree is not None:
            rest = rest[:, : (sh_degree + 1) ** 2 - 1]
        return Gaussians(
            self._leaf("means"),
            self._leaf("log_scales"),
            self._leaf("quaternions"),
            self._leaf("opacity_logits"),
            torch.cat([self._leaf("sh_base"), rest], 1),
        )

    def step(self, number: int) -> None:
        """Apply the gradients and forget them.

        Args:
            number: the step's number, from 0; sets the centres' rate.
        """
        done = min(1.0, number / max(1, self._steps))
        rate = self._rates.means ** (1 - done) * self._rates.means_final**done
        self._group("means")["lr"] = rate * self._extent
        self._adam.step()
        self._adam.zero_grad(set_to_none=True)

    def keep(self, index: Tensor) -> None:
        """Drop all Gaussians but those that a mask or an index tensor selects, moments included."""
        self._rewrite(lambda name, value: value[index])

    def append(self, joining: Gaussians) -> None:
        """Add Gaussians at the end; their moments start at zero.

        Args:
            joining: as many colour coefficients as the others.
        """
        added = _columns(joining)

        def extended(name: str, value: Tensor) -> Tensor:
            field, _, moment = name.partition(".")
            more = added[field].detach()
            return torch.cat([value, torch.zeros_like(more) if moment else more])

        self._rewrite(extended)

    def replace(self, name: str, values: Tensor) -> None:
        """Set one parameter's values; moments stay.

        Args:
            name: of the parameter.
            values: of the same shape.
        """
        self._rewrite(lambda field, value: values.clone() if field == name else value)

    def cap_opacity(self, limit: float) -> None:
        """Bring every opacity down to a limit at most, and forget the opacities' moments (3DGS's reset).

        Args:
            limit: largest opacity left, in (0, 1).
        """
        ceiling = torch.logit(torch.tensor(limit)).item()

        def capped(name: str, value: Tensor) -> Tensor:
            if name == "opacity_logits":
                return value.clamp(max=ceiling)
            return torch.zeros_like(value) if name.startswith("opacity_logits.") else value

        self._rewrite(capped)

    def state(self) -> dict[str, Any]:
        """All that is needed to go on later, as plain tensors."""
        values: dict[str, Any] = {}
        for group in self._adam.param_groups:
            leaf = group["params"][0]
            values[group["name"]] = leaf.detach()
            for key, value in self._adam.state.get(leaf, {}).items():
                values[f"{group['name']}.{key}"] = value
        return values

    def restore(self, values: dict[str, Any]) -> None:
        """Go on from what `state` returned."""
        for group in self._adam.param_groups:
            name = group["name"]
            self._adam.state.pop(group["params"][0], None)
            leaf = values[name].clone().requires_grad_()
            group["params"][0] = leaf
            moments = {key: values[f"{name}.{key}"].clone() for key in ("step", *MOMENTS) if f"{name}.{key}" in values}
            if moments:
                self._adam.state[leaf] = moments

    def _rewrite(self, change: Callable[[str, Tensor], Tensor]) -> None:
        """Replace every leaf and moment by a function of its name ("means", "means.exp_avg") and value."""
        for group in self._adam.param_groups:
            old, name = group["params"][0], group["name"]
            leaf = change(name, old.detach()).contiguous().requires_grad_()
            state = self._adam.state.pop(old, None)
            if state is not None:
                for key in MOMENTS:
                    state[key] = change(f"{name}.{key}", state[key]).contiguous()
                self._adam.state[leaf] = state
            group["params"][0] = leaf

    def _group(self, name: str) -> dict[str, Any]:
        return next(group for group in self._adam.param_groups if group["name"] == name)

    def _leaf(self, name: str) -> Tensor:
        leaf: Tensor = self._group(name)["params"][0]
        return leaf


def _columns(gaussians: Gaussians) -> dict[str, Float[Tensor, "n ..."]]:
    """The optimised tensors by name; colour in two parts, since they learn at different rates."""
    return {
        "means": gaussians.means,
        "log_scales": gaussians.log_scales,
        "quaternions": gaussians.quaternions,
        "opacity_logits": gaussians.opacity_logits,
        "sh_base": gaussians.sh[:, :1],
        "sh_rest": gaussians.sh[:, 1:],
    }
