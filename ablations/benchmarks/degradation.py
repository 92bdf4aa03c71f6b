"""``gaussian-enhancer degradation``: megapixels a second that the simulator degrades on one core.

It is compared with Real-ESRGAN's second-order degradation. All rows (method and input) run in turn, round after round,
with the round's seed, so that other load on the machine affects all of them alike. Inputs are batches of the trainer's
format, with depth and opacity for methods that use them. The job prints the median over the rounds by the wall clock,
the total over all rounds by the processor's clock (draws differ in cost, and the machine may be shared), and the median
ratio to the rival in the same round. The row of both stages needs the networks of stage 2. If they are missing, a note
says that the row is left out; if the row was requested, it is an error.
"""

import statistics
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numba
import torch
import torch.nn.functional as F
from hydra import compose
from hydra.errors import HydraException
from omegaconf import DictConfig

from ablations.benchmarks.real_esrgan import SecondOrder
from ablations.study.engine import Study, job
from ablations.study.processor import refuse_gpu
from gaussian_enhancer.degrade.artefacts.view import View
from gaussian_enhancer.errors import InputError, refuse_unknown
from gaussian_enhancer.runs.instantiate import build

Degradation = Callable[[View, torch.Generator], object]
SIMULATORS = {
    "stage 1, gate random": ("gate=random", "generator=none"),
    "stage 1, gate all": ("gate=all", "generator=none"),
    "stages 1 + 2, diffused": ("gate=random", "generator=diffused"),
}
RIVAL = "Real-ESRGAN"
METHODS = (*SIMULATORS, RIVAL)
INPUTS = {"4 crops of 128x128": (4, 128, 128), "1 image of 300x400": (1, 300, 400)}


def degradation(method: str, overrides: Sequence[str]) -> Degradation:
    """Build the degradation that a row measures.

    Args:
        method: one of `METHODS`.
        overrides: further choices of the simulator's configuration.

    Raises:
        InputError: a part of the simulator is not there.
    """
    if method == RIVAL:
        rival = SecondOrder()
        return lambda view, generator: rival(view.image, generator)
    try:
        choices = ["data.train=[]", "data.validation=[]", *SIMULATORS[method]]
        simulator: Degradation = build(compose("train", [*choices, *overrides]).data.simulation.simulator)
    except HydraException as error:
        cause = str(error).splitlines()[0]
        raise InputError(method, f"cannot be built ({cause})", "leave it out, or supply what is missing") from error
    except InputError as error:
        raise InputError(method, f"cannot be built ({error})", "leave it out, or supply what is missing") from error
    return simulator


def scene(count: int, height: int, width: int) -> View:
    """Photos with structure at all scales, with depth and with full opacity."""
    draw = torch.Generator().manual_seed(0)
    layers = [torch.rand(count, 4, max(2, height // n), max(2, width // n), generator=draw) for n in (1, 4, 16, 64)]
    planes = [F.interpolate(layer, size=(height, width), mode="bilinear", align_corners=False) for layer in layers]
    image = torch.stack(planes).mean(0)
    return View(image[:, :3], 0.5 + image[:, 3:], torch.ones(count, 1, height, width))


@dataclass
class MethodTiming:
    """A method on an input, and its seconds in each round by the wall clock and by the processor's clock."""

    method: str
    input: str
    call: Degradation
    view: View
    wall: list[float] = field(default_factory=list)
    processor: list[float] = field(default_factory=list)

    def run(self, seed: int) -> None:
        """One call, timed."""
        generator = torch.Generator().manual_seed(seed)
        wall, processor = time.perf_counter(), time.process_time()
        self.call(self.view, generator)
        self.wall.append(time.perf_counter() - wall)
        self.processor.append(time.process_time() - processor)

    def summary(self, rival: "MethodTiming | None") -> dict[str, Any]:
        """Megapixels a second, and their ratio to the rival's."""
        count, height, width = INPUTS[self.input]
        pixels = count * height * width / 1e6
        low, middle, high = statistics.quantiles([pixels / seconds for seconds in self.wall], n=4)
        ratios = [b / a for a, b in zip(self.wall, rival.wall, strict=True)] if rival is not None else []
        return {
            "method": self.method, "input": self.input, "n": len(self.wall),
            "median": middle, "lower_quartile": low, "upper_quartile": high,
            "processor": pixels * len(self.processor) / sum(self.processor),
            "over_rival": statistics.median(ratios) if ratios else None, "threads": torch.get_num_threads(),
        }  # fmt: skip


def rows_of(methods: Sequence[str] | None, overrides: Sequence[str]) -> tuple[list[MethodTiming], dict[str, str]]:
    """The rows to measure, and why others are left out.

    Raises:
        InputError: a method that was asked for is unknown or cannot be built.
    """
    refuse_unknown("methods", methods, METHODS)
    rows, left_out = [], {}
    for method in METHODS if methods is None else methods:
        try:
            call = degradation(method, overrides)
        except InputError as error:
            if methods is not None:
                raise
            left_out[method] = str(error)
            continue
        rows += [MethodTiming(method, name, call, scene(*size)) for name, size in INPUTS.items()]
    return rows, left_out


def study(cfg: DictConfig, device: torch.device) -> Study[str]:
    """All rows in turn; prints which methods are left out.

    Raises:
        InputError: a method that was asked for is unknown or cannot be built.
    """
    refuse_gpu(device)
    rows, left_out = rows_of(cfg.methods, cfg.overrides)
    for method, reason in left_out.items():
        print(f"left out: {method}: {reason}", file=sys.stderr)

    def measure(_: str) -> list[dict[str, Any]]:
        numba.set_num_threads(1)
        with torch.no_grad():
            for seed in range(-2, cfg.rounds):
                for row in rows:
                    row.run(seed + 2)
        for row in rows:
            del row.wall[:2], row.processor[:2]
        rivals = {row.input: row for row in rows if row.method == RIVAL}
        return [row.summary(rivals.get(row.input)) for row in rows]

    return Study(["all in turn"], measure, ("method", "input"), option="methods")


run = job(study)
