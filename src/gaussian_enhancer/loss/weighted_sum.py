"""The named, weighted sum of loss terms that training minimises.

Axes: b batch, h height, w width.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.loss.terms import Term
from gaussian_enhancer.types import single_precision


@dataclass(frozen=True)
class Weighted:
    """A term and its weight in the sum, >= 0."""

    term: Term
    weight: float = 1.0


class WeightedLoss:
    """total = sum_k weight_k mean(term_k(enhanced, photo, render)).

    Args:
        terms: term and weight by name; the names appear in logs. None switches a term off.

    Raises:
        InputError: no term is left, or a weight is negative.
    """

    def __init__(self, terms: Mapping[str, Weighted | None]) -> None:
        self.terms = {name: entry for name, entry in terms.items() if entry is not None}
        if not self.terms:
            raise InputError("loss", "has no term", "give at least one term with a weight")
        for name, entry in self.terms.items():
            if entry.weight < 0:
                raise InputError(f"loss.{name}.weight", f"is {entry.weight}", "use a weight of 0 or more")

    def __call__(
        self,
        enhanced: Float[Tensor, "b 3 h w"],
        photo: Float[Tensor, "b 3 h w"],
        render: Float[Tensor, "b 3 h w"],
    ) -> tuple[Float[Tensor, ""], dict[str, Float[Tensor, ""]]]:
        """Return the total, and each term's unweighted mean, detached. Half-precision images are converted to single.

        Args:
            enhanced: the network's output.
            photo: the ground truth, [0, 1].
            render: the render that was enhanced, [0, 1].
        """
        enhanced, photo, render = single_precision(enhanced), single_precision(photo), single_precision(render)
        means = {name: entry.term(enhanced, photo, render).mean() for name, entry in self.terms.items()}
        total = torch.stack([self.terms[name].weight * mean for name, mean in means.items()]).sum()
        return total, {name: mean.detach() for name, mean in means.items()}
