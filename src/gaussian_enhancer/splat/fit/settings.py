"""Settings of a fit, as plain values."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated

from pydantic import Field

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.splat.fit.densify import Densification
from gaussian_enhancer.splat.fit.optimise import LearningRates
from gaussian_enhancer.splat.fit.plane_sweep import SweepSettings
from gaussian_enhancer.splat.fit.relocation import Relocation
from gaussian_enhancer.splat.fit.start import STARTS
from gaussian_enhancer.typed import check_fields


@dataclass(frozen=True)
class Regularisation:
    """Penalties on a splat, which matter where few photos constrain it.

    Args:
        opacity: weight of the mean opacity (Kheradmand et al., 3DGS as MCMC, NeurIPS 2024, equation 11; their penalty
            on scales is not implemented).
    """

    opacity: Annotated[float, Field(ge=0)] = 0.01

    def __post_init__(self) -> None:
        check_fields(self, "regularisation.")


@dataclass(frozen=True)
class FitSettings:
    """Settings of a fit.

    Args:
        steps: number of steps, one photo each.
        init: source of the initial Gaussians: "auto" (the scene's points and a plane sweep), "plane_sweep", "points" or
            "random".
        start_gaussians: largest number of initial Gaussians; never more than ``max_gaussians``.
        max_gaussians: largest number of Gaussians at any time.
        sh_degree: degree of the colour's spherical harmonics, 0 to 3; raised to it from 0 in equal parts of the
            first third of the fit.
        snapshots: shares of the fit after which views are rendered and kept.
        seed: seed of all random numbers.
        ssim_weight: share of 1 - SSIM in the loss; L1 has the rest.
        rates: learning rates.
        densification: how Gaussians are added and removed: by gradients, or by relocation (3DGS-MCMC).
        regularisation: penalties on the splat.
        sweep: settings of the plane sweep.
    """

    steps: int = 3000
    init: str = "auto"
    start_gaussians: int = 10_000
    max_gaussians: int = 20_000
    sh_degree: int = 1
    snapshots: Sequence[float] = (0.25, 0.5)
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    ssim_weight: Annotated[float, Field(ge=0, le=1)] = 0.2
    rates: LearningRates = field(default_factory=LearningRates)
    densification: Densification | Relocation = field(default_factory=Densification)
    regularisation: Regularisation = field(default_factory=Regularisation)
    sweep: SweepSettings = field(default_factory=SweepSettings)

    def __post_init__(self) -> None:
        check_fields(self, "")
        if self.steps < 1:
            raise InputError("steps", f"is {self.steps}", "give at least 1")
        if self.init not in STARTS:
            raise InputError("init", f"is {self.init!r}", f"choose {', '.join(STARTS)}")
        if not 0 <= self.sh_degree <= 3:
            raise InputError("sh_degree", f"is {self.sh_degree}", "give 0, 1, 2 or 3")
        for name in ("start_gaussians", "max_gaussians"):
            if getattr(self, name) < 1:
                raise InputError(name, f"is {getattr(self, name)}", "give at least 1")
        if not all(0 < share < 1 for share in self.snapshots):
            raise InputError("snapshots", f"are {self.snapshots}", "give shares between 0 and 1")

    def snapshot_steps(self) -> tuple[int, ...]:
        """Steps after which views are rendered, the last included."""
        return tuple(sorted({max(1, round(share * self.steps)) for share in (*self.snapshots, 1.0)}))
