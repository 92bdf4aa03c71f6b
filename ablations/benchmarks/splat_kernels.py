"""``gaussian-enhancer splat_kernels``: time of one iteration of a splat's fit on the CPU, part by part.

All cells (image size, number of Gaussians, method) run in turn, round after round, so that other load on the machine
affects all of them alike. The job prints for each part the median and the least wall time; the least estimates an idle
machine. "processor" is the time on all cores together, which is affected less when others use the machine.
"""

import os
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numba
import torch
from omegaconf import DictConfig

from ablations.study.engine import Study, job
from ablations.study.processor import refuse_gpu
from gaussian_enhancer.splat.fit.optimise import LearningRates, SplatOptimiser
from gaussian_enhancer.splat.fit.similarity import PreparedPhoto, photometric_loss, prepare
from gaussian_enhancer.splat.methods import METHODS, Method, TwoDGS
from gaussian_enhancer.splat.render import render
from gaussian_enhancer.types import Gaussians, identity_camera

PARTS = ("forward", "loss", "backward", "optimizer", "iteration")


def cloud(count: int, axes: int) -> Gaussians:
    """Gaussians like those of a fit: anisotropic, of mixed opacity, smaller where there are more, SH degree 1."""
    draw = torch.Generator().manual_seed(0)
    means = torch.randn(count, 3, generator=draw) * torch.tensor([0.8, 0.8, 1.0]) + torch.tensor([0.0, 0.0, 3.0])
    scale = torch.tensor(0.03 * (10_000 / count) ** 0.5)
    return Gaussians(
        means,
        torch.randn(count, axes, generator=draw) * 0.7 + scale.log(),
        torch.randn(count, 4, generator=draw),
        torch.randn(count, generator=draw) * 2,
        torch.randn(count, 4, 3, generator=draw) * 0.3,
    )


@dataclass
class TimedFit:
    """One size, count and method, with the state of its small fit and the times measured so far, in ms."""

    height: int
    width: int
    count: int
    method: Method
    optimiser: SplatOptimiser = field(init=False)
    photo: PreparedPhoto = field(init=False)
    wall: dict[str, list[float]] = field(default_factory=lambda: {part: [] for part in PARTS})
    processor: dict[str, list[float]] = field(default_factory=lambda: {part: [] for part in PARTS})

    def __post_init__(self) -> None:
        axes = 2 if isinstance(self.method, TwoDGS) else 3
        # Learning rates near 0, since the scene must not change while it is measured.
        rates = LearningRates(*[1e-12] * 7)
        self.optimiser = SplatOptimiser(cloud(self.count, axes), rates, extent=1.0, steps=1)
        photo = torch.rand(3, self.height, self.width, generator=torch.Generator().manual_seed(1))
        self.photo = prepare(photo)

    def iterate(self) -> None:
        """One iteration, each part timed."""
        camera = identity_camera(self.height, self.width, float(self.width))
        begin = time.perf_counter(), time.process_time()
        image = self._timed("forward", lambda: render(self.optimiser.gaussians(), camera, self.method))
        # The loss computes its gradient in its forward pass, so "backward" times the renderer alone.
        loss = self._timed("loss", lambda: photometric_loss(image.colour, self.photo))
        self._timed("backward", loss.backward)
        self._timed("optimizer", lambda: self.optimiser.step(0))
        self._note("iteration", begin)

    def _timed(self, part: str, action: Callable[[], Any]) -> Any:
        begin = time.perf_counter(), time.process_time()
        result = action()
        self._note(part, begin)
        return result

    def _note(self, part: str, begin: tuple[float, float]) -> None:
        self.wall[part].append(1e3 * (time.perf_counter() - begin[0]))
        self.processor[part].append(1e3 * (time.process_time() - begin[1]))

    def summary(self) -> dict[str, Any]:
        """Medians and minima in ms, without the first iteration, which compiles."""
        columns: dict[str, Any] = {
            "method": self.method.name, "image": f"{self.height}x{self.width}", "gaussians": self.count,
        }  # fmt: skip
        for part in PARTS:
            wall, processor = self.wall[part][1:], self.processor[part][1:]
            columns[part] = {
                "median_ms": statistics.median(wall), "min_ms": min(wall),
                "processor_ms": statistics.median(processor), "n": len(wall),
            }  # fmt: skip
        return columns


def measured(cfg: DictConfig) -> list[dict[str, Any]]:
    """One row per size, count and method.

    Args:
        cfg: conf/splat_kernels.yaml, composed.
    """
    about = {
        "threads": numba.get_num_threads(), "omp_wait_policy": os.environ.get("OMP_WAIT_POLICY"),
        "torch_threads": torch.get_num_threads(), "numba": numba.__version__, "load": os.getloadavg()[0],
    }  # fmt: skip
    sizes = [tuple(map(int, size.split("x"))) for size in cfg.sizes]
    cells = [
        TimedFit(height, width, count, METHODS[method])
        for height, width in sizes
        for count in cfg.counts
        for method in cfg.methods
    ]
    for _ in range(cfg.rounds + 1):
        for cell in cells:
            cell.iterate()
    return [{**cell.summary(), **about} for cell in cells]


def study(cfg: DictConfig, device: torch.device) -> Study[DictConfig]:
    """All sizes, counts and methods in turn."""
    refuse_gpu(device)
    return Study([cfg], measured, ("method", "image", "gaussians"), option="methods")


run = job(study)
