"""Trained residual networks of IBGS as a method of studies.

Axes: h height, w width.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from ablations.ibgs.network import ResidualInput
from ablations.ibgs.training import TrainedResidual, applied_exposure, corrected
from ablations.study.fits import finished_runs
from ablations.study.methods import Applied
from gaussian_enhancer.align.alignment import LoadedView
from gaussian_enhancer.align.references import ReferencePool
from gaussian_enhancer.checkpoint import WEIGHTS, checkpoint_digest
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.rendered import RenderedView


@dataclass(frozen=True)
class ResidualEnhancer:
    """Enhances views of the fit that a residual network was trained on.

    Args:
        trained: the network.
        exposure: bring colours to the exposure of the nearest photo.
    """

    trained: TrainedResidual
    exposure: bool = True

    @torch.inference_mode()
    def __call__(self, view: RenderedView, target: LoadedView, pool: ReferencePool) -> Float[Tensor, "3 h w"]:
        """Render and residual.

        Args:
            view: the target.
            target: its pixels.
            pool: the fit's training views.

        Raises:
            InputError: a view has no camera or depth.
        """
        sources = self.trained.choice.sources(view, target, pool)
        exposure = applied_exposure(target.image, sources, self.exposure)
        inputs = ResidualInput.of(target.image, sources, self.trained.choice.visible)
        return corrected(self.trained.network, inputs, exposure[None])[0].clamp(0, 1)


@dataclass(frozen=True)
class IBGS:
    """The networks that were trained on fits, one for each fit and step.

    Args:
        trainings: weights files by the fit's folder name and step.
        exposure: whether colours are brought to the exposure of the nearest photo.
    """

    trainings: Mapping[tuple[str, int], Path]
    exposure: bool = True

    @classmethod
    def from_patterns(cls, patterns: Sequence[str], exposure: bool = True) -> "IBGS":
        """Collect the networks of finished runs of the job ``ibgs``.

        Args:
            patterns: folders of runs; may contain ``*``.
            exposure: whether colours are brought to the exposure of the nearest photo.

        Raises:
            InputError: a pattern names no finished run, a file cannot be read, or two are of the same fit and step.
        """
        if not patterns:
            raise InputError("ibgs", "names no training", "give folders of finished runs of the job ibgs, or patterns")
        trainings: dict[tuple[str, int], Path] = {}
        for folder in finished_runs(patterns)[0]:
            path = folder / WEIGHTS
            trained = TrainedResidual.load(path)
            key = trained.fit, trained.step
            if key in trainings:
                raise InputError(path, f"is of the same fit and step as {trainings[key]}", "name one training of each")
            trainings[key] = path
        return cls(trainings, exposure)

    def __call__(self, fit: Path, step: int) -> Applied:
        """The method at a step of a fit.

        Raises:
            InputError: no network was trained there.
        """
        path = self.trainings.get((fit.resolve().name, step))
        if path is None:
            raise InputError(
                "ibgs",
                f"has no training on {fit} at step {step}",
                f"run gaussian-enhancer ibgs fit={fit} step={step}, and name its folder",
            )
        return checkpoint_digest(path), ResidualEnhancer(TrainedResidual.load(path), self.exposure)
