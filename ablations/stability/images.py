"""Cases of extreme images for networks, loss and simulator: flat, black, saturated, 16-bit, checkerboard, one row.

Axes: b batch, r references, h height, w width.
"""

from collections.abc import Callable, Iterator
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


def cases() -> Iterator[Case]:
    """The cases of this family."""
    case = partial(Case, "images")
    for name, (about, _) in IMAGES.items():
        for weights in ("lr_tiny", "sr_tiny"):
            yield case(f"{name}_{weights}", f"{about}, enhanced", partial(network_problem, name, weights))
        yield case(f"{name}_objective", f"{about}, judged", partial(loss_problem, name), EXACT, OBJECTIVE_WHY)
        yield case(f"{name}_colours", f"{about}, colours matched", partial(colour_problem, name), EXACT)
    for name in ("constant", "black", "saturated", "checkerboard", "one_wide", "one_pixel"):
        about, build = f"{IMAGES[name][0]}, degraded in every way", partial(simulator_problem, name)
        yield case(f"{name}_simulated", about, build, SIMULATED, SIMULATED_WHY, ("forward",))
    about, why = "alone, the same as beside another", "the two are one computation"
    yield case("one_of_a_batch", about, batch_problem, EXACT, why, ("forward",))


OBJECTIVE_WHY = "the objective is computed in single precision"
SIMULATED_WHY = "renders are rounded to 8 bits, and a value in between may fall to either side"


def picture(name: str, batch: int = 1) -> Tensor:
    """An image of the catalogue, (b, 3, h, w), double precision."""
    return IMAGES[name][1]().expand(batch, -1, -1, -1).clone()


def network_inputs(name: str, scale: int) -> dict[str, Tensor]:
    """Network inputs with depth: the render is the picture, the two references are a noisy copy of it and noise.

    Args:
        name: of the picture.
        scale: resolution of the fine references over that of the render; they are left out for 1.
    """
    render = picture(name)
    height, width = render.shape[-2:]
    generator = torch.Generator().manual_seed(1)
    noisy_copy = (render + 0.05 * torch.randn(render.shape, generator=generator, dtype=torch.float64)).clamp(0, 1)
    noise = torch.rand(render.shape, generator=generator, dtype=torch.float64)
    inputs = {
        "render": render,
        "references": torch.stack([noisy_copy, noise], 1),
        "visibility": torch.rand(1, 2, 1, height, width, generator=generator, dtype=torch.float64),
        "depth": 1 + torch.rand(1, 1, height, width, generator=generator, dtype=torch.float64),
        "alpha": torch.rand(1, 1, height, width, generator=generator, dtype=torch.float64),
        "reference_renders": torch.stack([render, noise], 1),
    }
    if scale > 1:
        fine_references = inputs["references"].repeat_interleave(scale, -2).repeat_interleave(scale, -1)
        inputs["fine_references"] = fine_references
    return inputs


def network_problem(name: str, weights: str) -> Problem:
    """A picture enhanced with shipped weights."""
    network = shipped_network(weights)
    return Problem(run_network, network_inputs(name, network.scale), network)


@cache
def shipped_network(weights: str) -> Network:
    """A network with shipped weights in double precision; it is shared, so callers copy it."""
    return load_weights(weights).network.double()


def run_network(module: nn.Module | None, inputs: dict[str, Tensor]) -> Tensor:
    """Apply the network to its inputs."""
    result: Tensor = module(NetworkInput(**inputs))  # type: ignore[misc, arg-type]
    return result


def loss_problem(name: str) -> Problem:
    """All terms of the loss, for a batch of a picture equal to its photo and noise in place of it."""
    image = picture(name, 2)
    generator = torch.Generator().manual_seed(2)
    enhanced_images = image.clone()
    enhanced_images[1] = torch.rand(enhanced_images[1].shape, generator=generator, dtype=torch.float64)
    return Problem(_objective, {"enhanced": enhanced_images, "photo": image, "render": image.clone()}, unit=None)


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


def colour_problem(name: str) -> Problem:
    """Fitting the colours of a picture to those of noise, with every pixel visible and with none."""
    source = picture(name)[0]
    noise = torch.rand(source.shape, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    return Problem(_matched, {"source": source, "target": noise}, unit=None)


def _matched(module: nn.Module | None, inputs: dict[str, Tensor]) -> Tensor:
    all_visible = torch.ones_like(inputs["source"][:1])
    fits = [
        fit_colour(inputs["source"], inputs["target"], weight)
        for weight in (all_visible, torch.zeros_like(all_visible))
    ]
    return torch.stack(fits)


def simulator_problem(name: str) -> Problem:
    """A picture degraded by every artefact of the simulator."""
    return Problem(_simulated, {"image": picture(name)})


def _simulated(module: nn.Module | None, inputs: dict[str, Tensor]) -> Tensor:
    return Simulator(AllGate())(View(inputs["image"]), torch.Generator().manual_seed(4)).image


def batch_problem() -> Problem:
    """The difference of an image's result alone and in a batch of two."""
    views = {name: torch.cat([value, value.flip(-1)]) for name, value in network_inputs("noise", 1).items()}
    return Problem(_alone, views, shipped_network("lr_tiny"))


def _alone(module: nn.Module | None, inputs: dict[str, Tensor]) -> Tensor:
    batch_result = run_network(module, inputs)
    return batch_result[:1] - run_network(module, {name: value[:1] for name, value in inputs.items()})


def _flat(value: float) -> Callable[[], Tensor]:
    return partial(torch.full, (1, 3, HEIGHT, WIDTH), value, dtype=torch.float64)


def _noise(height: int = HEIGHT, width: int = WIDTH) -> Tensor:
    return torch.rand(1, 3, height, width, generator=torch.Generator().manual_seed(6), dtype=torch.float64)


def _deep() -> Tensor:
    """A ramp in steps of 1/65535, which 8 bits cannot resolve."""
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
"""Pictures by name: description, and function that makes them."""
