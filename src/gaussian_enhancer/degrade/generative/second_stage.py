"""Stage 2 of the simulator: the networks that extract, sample and apply degradation factors.

Axes: b batch, h height, w width.
"""

import dataclasses
from collections.abc import Callable, Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn

from gaussian_enhancer.degrade.artefacts.rng import normal
from gaussian_enhancer.degrade.artefacts.view import View
from gaussian_enhancer.degrade.generative.combiner import FactorCombiner
from gaussian_enhancer.degrade.generative.diffusion import CosineSchedule, Denoiser, LinearSchedule, Sampler, Schedule
from gaussian_enhancer.degrade.generative.extractor import FactorExtractor
from gaussian_enhancer.degrade.generative.factors import Factors, grid_size, white_noise
from gaussian_enhancer.errors import InputError


@dataclasses.dataclass(frozen=True)
class FactorDesign:
    """Architecture of stage 2's networks, as plain values.

    Args:
        vector: entries of z's vector, 0 for none.
        grid: channels of z's grid, 0 for none.
        widths: channels of the combiner at 1/2, 1/4 and 1/8 of the resolution.
        blocks: modulated blocks of the combiner at each resolution.
        code_width: channels of extractor and denoiser.
        code_blocks: residual blocks of extractor and denoiser at each resolution.
        schedule: noise schedule of the diffusion: "cosine" or "linear" (DiffIR's).

    Raises:
        InputError: z has neither vector nor grid, or the schedule is unknown.
    """

    vector: int = 32
    grid: int = 8
    widths: Sequence[int] = (32, 48, 64)
    blocks: int = 1
    code_width: int = 64
    code_blocks: int = 2
    schedule: str = "cosine"

    def __post_init__(self) -> None:
        if self.vector < 0 or self.grid < 0 or self.vector + self.grid == 0:
            raise InputError("factors", f"have {self.vector} + {self.grid} entries", "give a vector, a grid or both")
        if self.schedule not in SCHEDULES:
            raise InputError("schedule", f"is {self.schedule!r}", f"choose {' or '.join(SCHEDULES)}")


SCHEDULES: dict[str, Schedule] = {"cosine": CosineSchedule(), "linear": LinearSchedule()}


class FactorModel(nn.Module):
    """Extractor, combiner and denoiser, and the scale that standardises codes for the denoiser.

    Args:
        design: architecture of the networks.
    """

    def __init__(self, design: FactorDesign) -> None:
        super().__init__()
        self.design = design
        code_options = design.vector, design.grid, design.code_width, design.code_blocks
        self.extractor = FactorExtractor(*code_options)
        self.combiner = FactorCombiner(design.vector, design.grid, design.widths, design.blocks)
        self.denoiser = Denoiser(*code_options)
        self.vector_scale: Tensor
        self.grid_scale: Tensor
        self.register_buffer("vector_scale", torch.ones(design.vector))
        self.register_buffer("grid_scale", torch.ones(design.grid, 1, 1))

    def standardise(self, factors: Factors) -> Factors:
        """Scale codes for the denoiser, to about unit size of each entry."""
        return Factors(factors.vector / self.vector_scale, factors.grid / self.grid_scale)

    def unstandardise(self, factors: Factors) -> Factors:
        """Scale codes of the denoiser back for the combiner."""
        return Factors(factors.vector * self.vector_scale, factors.grid * self.grid_scale)

    def sample(
        self, manual: Float[Tensor, "b 3 h w"], sampler: Sampler, generators: Sequence[torch.Generator]
    ) -> Factors:
        """Sample codes for views without a real render.

        Args:
            manual: stage 1's output M.
            sampler: sampler of the codes.
            generators: one for each sample.
        """
        features = self.denoiser.features(manual)
        shape = len(manual), *grid_size(*manual.shape[-2:])
        template = Factors(
            manual.new_zeros(shape[0], self.design.vector),
            manual.new_zeros(shape[0], self.design.grid, shape[1], shape[2]),
        )

        def predict(noisy: Factors, time: Tensor) -> Factors:
            return self.denoiser(noisy, time, features)

        start = white_noise(template, generators)
        return self.unstandardise(sampler(predict, start, SCHEDULES[self.design.schedule], generators))

    def combine(
        self, manual: Float[Tensor, "b 3 h w"], factors: Factors, generators: Sequence[torch.Generator]
    ) -> Float[Tensor, "b 3 h w"]:
        """Compute L = DC(M, z), with new random noise as input; not clamped."""
        noise = normal((1, *manual.shape[-2:]), generators, manual)
        return self.combiner(manual, factors, noise)


class PairedGenerator:
    """Stage 2 with z extracted from M and a real render R of the same view.

    Args:
        model: trained networks.
    """

    def __init__(self, model: FactorModel) -> None:
        self.model, self.precision = model.eval().requires_grad_(False), torch.float32

    def __call__(
        self, manual: View, generators: Sequence[torch.Generator], real: Float[Tensor, "b 3 h w"] | None = None
    ) -> View:
        """Bring manually degraded views closer to real renders; depth and opacity stay.

        Raises:
            InputError: there are no real renders.
        """
        if real is None:
            raise InputError("generator=paired", "got no real renders", "give a fitted run, or use generator=diffused")
        return _refine(self, manual, generators, lambda: self.model.extractor(manual.image, real))


class DiffusedGenerator:
    """Stage 2 with z sampled given M.

    Args:
        model: trained networks.
        sampler: sampler of z; None takes the default.
        precision: dtype of the networks under autocast.
    """

    def __init__(
        self, model: FactorModel, sampler: Sampler | None = None, precision: torch.dtype = torch.float32
    ) -> None:
        self.model, self.precision = model.eval().requires_grad_(False), precision
        self.sampler = Sampler() if sampler is None else sampler

    def __call__(
        self, manual: View, generators: Sequence[torch.Generator], real: Float[Tensor, "b 3 h w"] | None = None
    ) -> View:
        """Bring manually degraded views closer to real renders; depth and opacity stay."""
        return _refine(self, manual, generators, lambda: self.model.sample(manual.image, self.sampler, generators))


class PairedOrDiffusedGenerator(DiffusedGenerator):
    """Stage 2 as in the paper: z is extracted from M and a real render R if there is one, and sampled otherwise."""

    def __call__(
        self, manual: View, generators: Sequence[torch.Generator], real: Float[Tensor, "b 3 h w"] | None = None
    ) -> View:
        """Bring manually degraded views closer to real renders; depth and opacity stay."""
        if real is None:
            return super().__call__(manual, generators)
        return _refine(self, manual, generators, lambda: self.model.extractor(manual.image, real))


def _refine(
    second: PairedGenerator | DiffusedGenerator,
    manual: View,
    generators: Sequence[torch.Generator],
    factors: Callable[[], Factors],
) -> View:
    """Apply codes to manually degraded views, in the second stage's precision."""
    image = manual.image
    with torch.autocast(image.device.type, second.precision, enabled=second.precision != torch.float32):
        refined = second.model.combine(image, factors(), generators)
    return dataclasses.replace(manual, image=refined.to(image.dtype).clamp(0, 1))
