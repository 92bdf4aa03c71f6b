"""Fit a splat to a scene's training photos in resumable steps.

Axes: n Gaussians, h height, w width. Random numbers depend on seed and step only, so that a resumed fit draws the same
numbers as an uninterrupted one.
"""

import dataclasses
import time
from collections.abc import Callable
from enum import IntEnum
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.scene import Scene
from gaussian_enhancer.splat.filters import filter_size
from gaussian_enhancer.splat.fit.checkpoint import discard_checkpoint, load_checkpoint, save_checkpoint
from gaussian_enhancer.splat.fit.densify import Densification, ScreenGradientMean, densify
from gaussian_enhancer.splat.fit.export import export_splat, export_views
from gaussian_enhancer.splat.fit.geometry import camera_extent
from gaussian_enhancer.splat.fit.optimise import SplatOptimiser
from gaussian_enhancer.splat.fit.progress import FitProgress, waiting_bar
from gaussian_enhancer.splat.fit.relocation import Relocation, explore, relocate
from gaussian_enhancer.splat.fit.settings import FitSettings
from gaussian_enhancer.splat.fit.similarity import photometric_loss
from gaussian_enhancer.splat.fit.start import starting_gaussians
from gaussian_enhancer.splat.fit.stopwatch import Stopwatch
from gaussian_enhancer.splat.fit.targets import TrainingPhotos
from gaussian_enhancer.splat.methods import Method, MipSplatting
from gaussian_enhancer.splat.near import near_plane
from gaussian_enhancer.splat.render import render
from gaussian_enhancer.splat.screen import ScreenStatistics
from gaussian_enhancer.types import Gaussians


class _Purpose(IntEnum):
    """Uses of random numbers; each has its own generator at every step."""

    INITIALISATION = 0
    DENSIFICATION = 2
    PHOTO_ORDER = 3
    NOISE = 5


SMOOTHING_EVERY = 100
"""Steps between two updates of the 3D filter's size of each Gaussian (Mip-Splatting's interval)."""


def step_generator(seed: int, number: int, purpose: int) -> torch.Generator:
    """Generator of random numbers that depend on nothing else, so that resumed runs draw the same ones.

    Args:
        seed: seed of the run.
        number: number of a step, or of a pass through the photos.
        purpose: use of the numbers, 0 to 7.
    """
    return torch.Generator().manual_seed(((seed * 1_000_003 + number) * 8 + purpose) % 2**63)


def fit(
    scene: Scene,
    method: Method,
    folder: Path,
    settings: FitSettings | None = None,
    *,
    device: torch.device | str = "cpu",
    checkpoint_seconds: float = 20.0,
    progress: bool = True,
    stopwatch: Stopwatch | None = None,
    stop_after: int | None = None,
    **choices: Any,
) -> Gaussians:
    """Fit a splat and write the run's folder: ``splat.ply``, ``cameras.json``, renders of every snapshot.

    The loss is (1 - w) L1 + w (1 - SSIM) (Kerbl et al., SIGGRAPH 2023, equation 7) of one photo per step. Every photo
    is used once before any is used again. If the folder holds a checkpoint of the same fit, the fit continues from it.

    Args:
        scene: training photos to fit to and test photos to render.
        method: 3DGS, 2DGS or Mip-Splatting.
        folder: the run's folder, where results are written.
        settings: settings of the fit; None for the defaults.
        device: device to compute on.
        checkpoint_seconds: time between checkpoints.
        progress: show a progress bar.
        stopwatch: measures the run time by phase.
        stop_after: end after this step and keep the checkpoint, as if interrupted; for tests and for fits in parts.
        **choices: single settings by name, which override those in ``settings``.

    Raises:
        InputError: photos, settings or checkpoint are invalid, or a file cannot be written.
    """
    settings = dataclasses.replace(settings or FitSettings(), **choices)
    with waiting_bar(f"photos of {scene.name}", progress):
        state = _FitState(scene, method, folder, settings, torch.device(device), stopwatch or Stopwatch())
    with FitProgress(0, "plane sweep", progress) as bar:
        state.restore_or_initialise(bar.update_views)
    last_step = settings.steps if stop_after is None else min(stop_after, settings.steps)
    snapshots = settings.snapshot_steps()
    saved_at = time.monotonic()
    with (
        FitProgress(settings.steps, f"fit {scene.name} ({method.name})", progress) as bar,
        state.watch.time_render_parts(),
    ):
        while state.step < last_step:
            loss, difference = state.train_step()
            bar.update(state.step, loss, difference, len(state.optimiser))
            if state.step in snapshots:
                export_views(folder, scene, state.splat(), method, state.step)
            if state.step in snapshots or time.monotonic() - saved_at > checkpoint_seconds:
                state.save()
                saved_at = time.monotonic()
    state.save()
    gaussians = state.splat()
    if last_step == settings.steps:
        export_splat(folder, scene, gaussians)
        discard_checkpoint(folder)
    return gaussians


class _FitState:
    """The state of one fit."""

    def __init__(
        self,
        scene: Scene,
        method: Method,
        folder: Path,
        settings: FitSettings,
        device: torch.device,
        watch: Stopwatch,
    ) -> None:
        self.scene, self.method, self.folder, self.settings, self.watch = scene, method, folder, settings, watch
        self.device = device
        self.photos = TrainingPhotos(scene, device)
        self.extent, self.near = camera_extent(self.photos.cameras), near_plane(self.photos.cameras)
        self.step = 0
        self.smoothing: Tensor | None = None
        self.optimiser: SplatOptimiser
        self.screen_gradients: ScreenGradientMean

    def restore_or_initialise(self, progress: Callable[[int, int], None]) -> None:
        """Start from the folder's checkpoint, or from initial Gaussians if there is none."""
        checkpoint = load_checkpoint(self.folder, self._checkpoint_identity())
        if checkpoint is not None:
            self._adopt_gaussians(checkpoint["splat"])
            self.optimiser.restore({name: value.to(self.device) for name, value in checkpoint["optimiser"].items()})
            self.screen_gradients.restore({name: value.to(self.device) for name, value in checkpoint["pull"].items()})
            self.smoothing = None if checkpoint["smoothing"] is None else checkpoint["smoothing"].to(self.device)
            self.step = checkpoint["step"]
            return
        initial = starting_gaussians(
            self.scene,
            self.photos,
            self.method,
            self.settings.init,
            count=min(self.settings.start_gaussians, self.settings.max_gaussians),
            sh_degree=self.settings.sh_degree,
            generator=self._generator(_Purpose.INITIALISATION),
            sweep=self.settings.sweep,
            progress=progress,
        )
        self._adopt_gaussians(initial.tensors())
        self._smooth()

    def train_step(self) -> tuple[Tensor, Tensor]:
        """Perform one step; return the loss and the difference of render and photo."""
        settings, watch = self.settings, self.watch
        photo_number = self._photo_number()
        camera = self.photos.cameras[photo_number]
        target = self.photos.target(photo_number)
        screen = ScreenStatistics()
        with watch.phase("render"):
            rendered = render(
                self._rendered_gaussians(), camera, self.method, self.scene.background, near=self.near, screen=screen
            )
            colour = rendered.colour
        with watch.phase("loss"):
            loss = photometric_loss(colour, target, settings.ssim_weight)
            total = loss + self._penalty()
        with watch.phase("backward"):
            total.backward()
        with watch.phase("densify"):
            if isinstance(settings.densification, Densification):
                self.screen_gradients.add(screen, max(camera.height, camera.width))
        with watch.phase("optimiser"):
            self.optimiser.step(self.step)
        self.step += 1
        watch.steps += 1
        with watch.phase("densify"):
            self._densify_or_relocate()
        return loss.detach(), colour.detach() - target.photo

    def splat(self) -> Gaussians:
        """The current Gaussians, detached, with all colour coefficients and the 3D filter."""
        return self.optimiser.detached_gaussians(self.smoothing)

    def save(self) -> None:
        """Replace the checkpoint."""
        save_checkpoint(
            self.folder,
            {
                "identity": self._checkpoint_identity(),
                "step": self.step,
                "splat": self.splat().tensors(),
                "optimiser": self.optimiser.state(),
                "pull": self.screen_gradients.state(),
                "smoothing": self.smoothing,
            },
        )

    def _adopt_gaussians(self, values: dict[str, Tensor | None]) -> None:
        gaussians = Gaussians(**values).to(self.device)  # type: ignore[arg-type]
        self.optimiser = SplatOptimiser(gaussians, self.settings.rates, self.extent, self.settings.steps)
        self.screen_gradients = ScreenGradientMean(len(gaussians), self.device)

    def _rendered_gaussians(self) -> Gaussians:
        degree = min(self.settings.sh_degree, 3 * self.step * (self.settings.sh_degree + 1) // self.settings.steps)
        return dataclasses.replace(self.optimiser.gaussians(degree), smoothing=self.smoothing)

    def _penalty(self) -> Float[Tensor, ""]:
        weight = self.settings.regularisation.opacity
        if weight <= 0:
            return torch.zeros((), device=self.device)
        return weight * self.optimiser.gaussians(0).opacity_logits.sigmoid().mean()

    def _densify_or_relocate(self) -> None:
        settings, steps = self.settings.densification, self.settings.steps
        if settings.is_due(self.step, steps):
            limit = self.settings.max_gaussians
            if isinstance(settings, Relocation):
                relocate(self.optimiser, settings, limit, self._generator(_Purpose.DENSIFICATION))
            else:
                densify(
                    self.optimiser,
                    self.screen_gradients,
                    settings,
                    self.extent,
                    limit,
                    self._generator(_Purpose.DENSIFICATION),
                )
            self.screen_gradients = ScreenGradientMean(len(self.optimiser), self.device)
            self._smooth()
            if len(self.optimiser) == 0:
                raise InputError(f"fit of scene {self.scene.name}", "lost all Gaussians", "lower densification.opacity")
        if isinstance(settings, Relocation) and settings.noise > 0:
            explore(self.optimiser, settings, self.extent, self.step - 1, self._generator(_Purpose.NOISE))
        if self.step % SMOOTHING_EVERY == 0 or self.step == steps:
            self._smooth()

    def _smooth(self) -> None:
        if isinstance(self.method, MipSplatting):
            means = self.optimiser.gaussians(0).means.detach()
            self.smoothing = filter_size(means, self.photos.cameras, near=self.near)

    def _photo_number(self) -> int:
        """Index of this step's photo: every photo once per round, in an order that seed and round determine."""
        count = len(self.photos)
        generator = step_generator(self.settings.seed, self.step // count, _Purpose.PHOTO_ORDER)
        return int(torch.randperm(count, generator=generator)[self.step % count])

    def _generator(self, purpose: _Purpose) -> torch.Generator:
        return step_generator(self.settings.seed, self.step, purpose)

    def _checkpoint_identity(self) -> str:
        """Description of the fit; only a checkpoint with an equal description is continued."""
        return f"{self.scene.name}, {len(self.photos)} photos, {self.method}, {self.settings}"
