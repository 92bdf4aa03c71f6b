"""Images that strain networks, objective and simulator: flat, black, saturated, 16-bit, checkerboards, single rows.

Axes: b batch, r references, h height, w width.
"""

from collections.abc import Callable
from functools import cache, partial

import torch
from torch import Tensor, nn

from ablations.stability.case import EXACT, PRECISIONS, Case, Problem, Tolerance
from gaussian_enhancer.align.exposure import fit_colour
from gaussian_enhancer.degrade.artefacts.view import View
from gaussian_enhancer.degrade.gates.gate import AllGate
from gaussian_enhancer.degrade.simulator import Simulator
from gaussian_enhancer.infer.weights import load_weights
from gaussian_enhancer.loss.terms import (
    DSSIM,
    Charbonnier,
    FrequencyDifference,
    GradientDifference,
    Harm,
    Relative,
    SquaredError,
    Term,
)
from gaussian_enhancer.loss.weighted_sum import Weighted, WeightedLoss
from gaussian_enhancer.network.network import Network
from gaussian_enhancer.types import NetworkInput

HEIGHT, WIDTH = 24, 40
SIMULATED: Tolerance = {precision.name: (1.5 / 255, 1.0) for precision in PRECISIONS}


def cases() -> list[Case]:
    """The family."""
    found = []
    for name, (about, _) in IMAGES.items():
        for weights in ("lr_tiny", "sr_tiny"):
            found.append(Case("images", f"{name}_{weights}", f"{about}, enhanced", partial(enhanced, name, weights)))
        found.append(
            Case("images", f"{name}_objective", f"{about}, judged", partial(judged, name), EXACT, OBJECTIVE_WHY)
        )
        found.append(Case("images", f"{name}_colours", f"{about}, colours matched", partial(matched, name), EXACT))
    for name in ("constant", "black", "saturated", "checkerboard", "one_wide", "one_pixel"):
        about, forward = f"{IMAGES[name][0]}, degraded in every way", ("forward",)
        found.append(
            Case("images", f"{name}_simulated", about, partial(simulated, name), SIMULATED, SIMULATED_WHY, forward)
        )
    about = "alone, the same as beside another"
    found.append(Case("images", "one_of_a_batch", about, alone, EXACT, "the two are one computation", ("forward",)))
    return found


OBJECTIVE_WHY = "the objective is computed in single precision"
SIMULATED_WHY = "renders are rounded to 8 bits, and a value in between may fall to either side"


def picture(name: str, batch: int = 1) -> Tensor:
    """An image of the catalogue, (b, 3, h, w), double precision."""
    return IMAGES[name][1]().expand(batch, -1, -1, -1).clone()


def views_of(name: str, scale: int) -> dict[str, Tensor]:
    """A render with two references and depth: the picture, something near it, and something else."""
    render = picture(name)
    height, width = render.shape[-2:]
    draw = torch.Generator().manual_seed(1)
    near = (render + 0.05 * torch.randn(render.shape, generator=draw, dtype=torch.float64)).clamp(0, 1)
    other = torch.rand(render.shape, generator=draw, dtype=torch.float64)
    inputs = {
        "render": render,
        "references": torch.stack([near, other], 1),
        "visibility": torch.rand(1, 2, 1, height, width, generator=draw, dtype=torch.float64),
        "depth": 1 + torch.rand(1, 1, height, width, generator=draw, dtype=torch.float64),
        "alpha": torch.rand(1, 1, height, width, generator=draw, dtype=torch.float64),
        "reference_renders": torch.stack([render, other], 1),
    }
    if scale > 1:
        fine = inputs["references"].repeat_interleave(scale, -2).repeat_interleave(scale, -1)
        inputs["fine_references"] = fine
    return inputs


def enhanced(name: str, weights: str) -> Problem:
    """A picture through shipped weights."""
    network = shipped(weights)
    return Problem(run_network, views_of(name, network.scale), network)


@cache
def shipped(weights: str) -> Network:
    """Weights of the package in double precision; shared, callers copy them."""
    return load_weights(weights).network.double()


def run_network(module: nn.Module | None, inputs: dict[str, Tensor]) -> Tensor:
    """The network on views."""
    result: Tensor = module(NetworkInput(**inputs))  # type: ignore[misc, arg-type]
    return result


def judged(name: str) -> Problem:
    """A picture that is its own photo under every term of the objective, and one that is not."""
    image = picture(name, 2)
    draw = torch.Generator().manual_seed(2)
    result = image.clone()
    result[1] = torch.rand(result[1].shape, generator=draw, dtype=torch.float64)
    return Problem(_objective, {"enhanced": result, "photo": image, "render": image.clone()}, unit=None)


def _objective(module: nn.Module | None, inputs: dict[str, Tensor]) -> Tensor:
    relative = Relative(Charbonnier(), 1e-3)
    terms: tuple[Term, ...] = (
        Charbonnier(),
        SquaredError(),
        DSSIM(),
        GradientDifference(),
        FrequencyDifference(),
        Harm(),
        relative,
    )
    loss = WeightedLoss({str(place): Weighted(term) for place, term in enumerate(terms)})
    return loss(inputs["enhanced"], inputs["photo"], inputs["render"])[0]


def matched(name: str) -> Problem:
    """The colours of a picture brought to those of noise, seen everywhere and nowhere."""
    source = picture(name)[0]
    other = torch.rand(source.shape, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    return Problem(_matched, {"source": source, "target": other}, unit=None)


def _matched(module: nn.Module | None, inputs: dict[str, Tensor]) -> Tensor:
    seen = torch.ones_like(inputs["source"][:1])
    fits = [fit_colour(inputs["source"], inputs["target"], weight) for weight in (seen, torch.zeros_like(seen))]
    return torch.stack(fits)


def simulated(name: str) -> Problem:
    """A picture under every artefact of the simulator."""
    return Problem(_simulated, {"image": picture(name)})


def _simulated(module: nn.Module | None, inputs: dict[str, Tensor]) -> Tensor:
    return Simulator(AllGate())(View(inputs["image"]), torch.Generator().manual_seed(4)).image


def alone() -> Problem:
    """An image by itself less the same image in a batch of two."""
    views = {name: torch.cat([value, value.flip(-1)]) for name, value in views_of("noise", 1).items()}
    return Problem(_alone, views, shipped("lr_tiny"))


def _alone(module: nn.Module | None, inputs: dict[str, Tensor]) -> Tensor:
    both = run_network(module, inputs)
    return both[:1] - run_network(module, {name: value[:1] for name, value in inputs.items()})


def _flat(value: float) -> Callable[[], Tensor]:
    return partial(torch.full, (1, 3, HEIGHT, WIDTH), value, dtype=torch.float64)


def _noise(height: int = HEIGHT, width: int = WIDTH) -> Tensor:
    return torch.rand(1, 3, height, width, generator=torch.Generator().manual_seed(6), dtype=torch.float64)


def _deep() -> Tensor:
    """A ramp by steps of 1/65535, which 8 bits do not tell apart."""
    return (torch.arange(3 * HEIGHT * WIDTH, dtype=torch.float64) / 65535 + 0.3).view(1, 3, HEIGHT, WIDTH)


def _checkerboard() -> Tensor:
    y, x = torch.meshgrid(torch.arange(HEIGHT), torch.arange(WIDTH), indexing="ij")
    return ((x + y) % 2).double().expand(1, 3, -1, -1)


IMAGES: dict[str, tuple[str, Callable[[], Tensor]]] = {
    "noise": ("noise, for comparison", _noise),
    "constant": ("one grey", _flat(0.5)),
    "black": ("black", _flat(0.0)),
    "saturated": ("white", _flat(1.0)),
    "deep": ("16-bit steps", _deep),
    "checkerboard": ("a checkerboard of single pixels", _checkerboard),
    "one_wide": ("one pixel wide", partial(_noise, HEIGHT, 1)),
    "one_high": ("one pixel high", partial(_noise, 1, WIDTH)),
    "one_pixel": ("a single pixel", partial(_noise, 1, 1)),
}
"""Pictures by name: what they are, and how they are made."""
