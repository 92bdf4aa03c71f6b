"""How much simulated renders look like real ones: real held-out renders of finished runs beside simulated ones.

Axes: h height, w width.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import UInt8
from torch import Tensor

from ablations.realism.anisotropy import anisotropy_distance
from ablations.realism.patches import RenderPair, eight_bit
from ablations.realism.spectrum import ROUNDING, spectrum_distance
from ablations.study.fits import refuse_without_views, scene_of
from gaussian_enhancer.degrade.artefacts.view import View
from gaussian_enhancer.degrade.simulator import Simulator
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.rendered import RenderedSet, RenderedView
from gaussian_enhancer.scene.renders import read_run, run_steps


@dataclass(frozen=True)
class RealRender:
    """A held-out view of a finished run.

    Args:
        scene: the scene's name.
        splat: the run's step and what it belongs to: all its renders, and its training views as references.
        target: the view, with its photo.
    """

    scene: str
    splat: RenderedSet
    target: RenderedView


Row = Callable[[RenderedSet], Simulator]
"""How a simulator is made for the renders of one splat: the adaptive gate looks at the splat's own training views."""


def real_renders(runs: Sequence[Path], count: int | None = None, seed: int = 0) -> list[RealRender]:
    """Held-out renders of runs, all snapshots.

    Args:
        runs: folders of finished runs.
        count: number of renders at most, as many of each run as of the others; all where None.
        seed: of the choice.

    Raises:
        InputError: a run holds no held-out views, or a view has no photo.
    """
    chosen = []
    for number, run in enumerate(runs):
        refuse_without_views(run)
        sets = [read_run(run, step) for step in run_steps(run)]
        run_renders = [RealRender(scene_of(run), splat, target) for splat in sets for target in splat.targets]
        for render in run_renders:
            if render.target.read_photo is None:
                raise InputError(run, f"has no photo of {render.target.name}", "render the run again with its photos")
        generator = torch.Generator().manual_seed(seed * 1_000_003 + number)
        order = torch.randperm(len(run_renders), generator=generator).tolist()
        share = len(run_renders) if count is None else max(1, count // len(runs))
        chosen += [run_renders[i] for i in sorted(order[:share])]
    return chosen


def photographed(real: RealRender) -> View:
    """The photo of a real render, with the depth and opacity that its splat gives."""
    target = real.target
    assert target.read_photo is not None
    depth = target.read_depth()[None] if target.read_depth is not None else None
    alpha = target.read_alpha()[None] if target.read_alpha is not None else None
    return View(target.read_photo()[None], depth, alpha)


def simulated_pairs(reals: Sequence[RealRender], row: Row, seed: int = 0) -> Iterator[RenderPair]:
    """Simulate each real render's view from its photo, once for every real render.

    Args:
        reals: real renders; those of one splat stand together.
        row: how simulators are made.
        seed: of the simulation.
    """
    splat: RenderedSet | None = None
    for number, real in enumerate(reals):
        if real.splat is not splat:
            splat, simulator = real.splat, row(real.splat)
        view = photographed(real)
        generator = torch.Generator().manual_seed(seed * 1_000_003 + number)
        with torch.no_grad():
            simulated = simulator(view, generator)
        assert real.target.read is not None
        images = eight_bit(view.image[0]), eight_bit(simulated.image[0]), eight_bit(real.target.read())
        yield RenderPair(real.scene, real.target.name, *images)


def distances(pairs: Sequence[RenderPair]) -> dict[str, float]:
    """Distances between simulated and real renders that need no classifier.

    Of the images and of what was done to the photo (the residuals, render less photo): spectra in dB, and
    distributions of gradients' coherence; and the PSNR in dB of each kind, whose equality says that the simulator is
    as strong as reality.

    Args:
        pairs: simulated and real renders.
    """
    photos, simulated, real = ([_scaled(getattr(p, name)) for p in pairs] for name in ("photo", "simulated", "real"))
    simulated_residuals = [image - photo for image, photo in zip(simulated, photos, strict=True)]
    real_residuals = [image - photo for image, photo in zip(real, photos, strict=True)]
    return {
        "spectrum_image_db": spectrum_distance(simulated, real),
        "spectrum_residual_db": spectrum_distance(simulated_residuals, real_residuals),
        "anisotropy_image": anisotropy_distance(simulated, real),
        "anisotropy_residual": anisotropy_distance(simulated_residuals, real_residuals),
        "psnr_simulated_db": _mean_psnr(simulated_residuals),
        "psnr_real_db": _mean_psnr(real_residuals),
    }


def _scaled(image: UInt8[Tensor, "3 h w"]) -> Tensor:
    return image.float() / 255


def _mean_psnr(residuals: Sequence[Tensor]) -> float:
    """Mean over images of -10 log10 of the mean squared residual; errors below the 8 bits' rounding count as it."""
    errors = torch.stack([residual.double().square().mean() for residual in residuals])
    return (-10 * torch.log10(errors.clamp_min(ROUNDING))).mean().item()
