"""Cases of extreme training steps: 100 times the learning rate, black batches, a sample that is not finite."""

import math
from collections.abc import Iterator
from functools import partial

import torch
from torch import Tensor, nn

from ablations.stability.case import PRECISIONS, Case, Problem, Tolerance, UnstableError
from ablations.stability.images import network_inputs, picture
from gaussian_enhancer.loss.terms import DSSIM, Charbonnier, Relative
from gaussian_enhancer.loss.weighted_sum import Weighted, WeightedLoss
from gaussian_enhancer.network.network import Network
from gaussian_enhancer.network.sif import SIF
from gaussian_enhancer.train.metrics import gains
from gaussian_enhancer.train.module import EnhancerModule
from gaussian_enhancer.types import Batch, NetworkInput

ANY: Tolerance = {precision.name: (math.inf, math.inf) for precision in PRECISIONS}


def cases() -> Iterator[Case]:
    """The cases of this family, in all precisions: float32 and autocast, as in training, and half precision."""
    diverges = "trainings part after the first rounding: what counts is that this one recovers"
    about = "a first step at 100 times the learning rate"
    yield Case("training", "first_step_100x", about, high_rate_problem, ANY, diverges, ("forward",))
    yield Case("training", "batch_black", "a batch of black images", partial(one_step, "black"))
    yield Case("training", "batch_constant", "a batch of one grey", partial(one_step, "constant"))
    yield Case("training", "batch_of_one", "a batch of one sample", partial(one_step, "noise", 1))
    yield Case("training", "nan_in_a_sample", "NaN in one sample of four", nan_problem)


def module_of(network: Network) -> EnhancerModule:
    """A training module of a network, as the job train sets it up.

    Args:
        network: to train.
    """
    loss = WeightedLoss({"photo": Weighted(Relative(Charbonnier(), 0.02)), "shape": Weighted(DSSIM(), 0.1)})
    optimizer = partial(torch.optim.AdamW, lr=8e-4, betas=(0.9, 0.99), weight_decay=1e-4)
    return EnhancerModule(network, loss, gains(), optimizer, bad_share=1.0)


def small_network() -> SIF:
    """A small network whose last layer is not initialised to zero, so that it changes its input."""
    torch.manual_seed(11)
    network = SIF((8, 12), (1, 1))
    nn.init.normal_(network.decode.head.weight, std=0.05)
    return network


def inputs_of(name: str, batch: int) -> dict[str, Tensor]:
    """Network inputs and photos of a batch."""
    views = {key: value.repeat_interleave(batch, 0) for key, value in network_inputs(name, 1).items()}
    return {**views, "photo": (picture("noise", batch) + views["render"]) / 2 if name == "noise" else views["render"]}


def one_step(name: str, batch: int = 4) -> Problem:
    """The loss of a batch, with gradients of the weights."""
    return Problem(_loss, inputs_of(name, batch), small_network().double(), tuple(inputs_of(name, 1)))


def nan_problem() -> Problem:
    """The loss of a batch with NaN in one sample."""
    inputs = inputs_of("noise", 4)
    inputs["photo"][2, 1, 3, 4] = math.nan
    return Problem(_loss, inputs, small_network().double(), tuple(inputs))


def _loss(module: nn.Module | None, inputs: dict[str, Tensor]) -> Tensor:
    return _training(module).batch_loss(_batch(inputs))[0]


def high_rate_problem() -> Problem:
    """31 training steps, the first at 100 times the learning rate."""
    return Problem(_train_at_high_rate, inputs_of("noise", 2), small_network().double())


def _train_at_high_rate(module: nn.Module | None, inputs: dict[str, Tensor]) -> Tensor:
    training_module = _training(module)
    optimiser = training_module.configure_optimizers()["optimizer"]
    learning_rates = [8e-4 * 100] + [8e-4] * 30
    losses = []
    with torch.enable_grad():
        for learning_rate in learning_rates:
            for group in optimiser.param_groups:
                group["lr"] = learning_rate
            optimiser.zero_grad()
            loss, _ = training_module.batch_loss(_batch(inputs))
            loss.backward()
            torch.nn.utils.clip_grad_norm_(training_module.network.parameters(), 1.0)
            optimiser.step()
            losses.append(float(loss.detach()))
    if not all(bool(torch.isfinite(value).all()) for value in training_module.network.parameters()):
        raise UnstableError("weights are not finite")
    if not losses[-1] < max(1.5 * losses[0], 0.3 * losses[1]):
        raise UnstableError(
            f"loss {losses[0]:.3g}, then {losses[1]:.3g}, still {losses[-1]:.3g} after {len(learning_rates)} steps"
        )
    return torch.tensor(losses[-1])


def _training(module: nn.Module | None) -> EnhancerModule:
    if not isinstance(module, Network):
        raise TypeError(f"{type(module).__name__} is no network")
    return module_of(module)


def _batch(inputs: dict[str, Tensor]) -> Batch:
    views = {name: value for name, value in inputs.items() if name != "photo"}
    names = tuple(f"sample {place}" for place in range(len(inputs["photo"])))
    return Batch(NetworkInput(**views), inputs["photo"], names)  # type: ignore[arg-type]
