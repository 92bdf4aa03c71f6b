"""Further optimisation of a fitted splat on its training photos and on enhanced views at new cameras, in rounds.

Random numbers depend only on seed and step, so a resumed run draws the same ones as an uninterrupted run.

Axes: h height, w width.
"""

import dataclasses
import shutil
import time
from collections.abc import Iterator
from enum import IntEnum
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.distil.enhanced_views import EnhancedViews
from gaussian_enhancer.distil.new_cameras import new_cameras
from gaussian_enhancer.distil.settings import DistilSettings
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.runs.rendered_capture import SplatRenderer
from gaussian_enhancer.scene.scene import Scene
from gaussian_enhancer.splat.filters import filter_size
from gaussian_enhancer.splat.fit.checkpoint import load_checkpoint, save_checkpoint
from gaussian_enhancer.splat.fit.fit import SMOOTHING_EVERY, step_generator
from gaussian_enhancer.splat.fit.geometry import camera_extent
from gaussian_enhancer.splat.fit.optimise import SplatOptimiser
from gaussian_enhancer.splat.fit.progress import FitProgress
from gaussian_enhancer.splat.fit.similarity import photometric_loss, prepare
from gaussian_enhancer.splat.fit.targets import TrainingPhotos
from gaussian_enhancer.splat.methods import MipSplatting
from gaussian_enhancer.splat.render import render
from gaussian_enhancer.types import Camera, Gaussians


class _Purpose(IntEnum):
    """Uses of random numbers; each has its own generator at every step."""

    IMAGE_CHOICE = 1
    PHOTO_ORDER = 2
    VIEW_CHOICE = 3


def distil(
    capture: Scene,
    start: SplatRenderer,
    enhancer: SetEnhancer | None,
    folder: Path,
    settings: DistilSettings,
    *,
    checkpoint_seconds: float = 60.0,
    progress: bool = True,
    input_identity: str = "",
    stop_after: int | None = None,
) -> Gaussians:
    """Distil enhanced views into a splat. Where the folder has a checkpoint of the same run, the run is resumed.

    Each step uses one image. The loss is the photometric loss of a fit. On an enhanced view, its gradient is multiplied
    at each pixel by ``settings.weight`` and the view's confidence. No Gaussians are added.

    Args:
        capture: capture whose training photos are fitted, and are the enhancer's references. Held-out photos and their
            cameras are not used.
        start: initial splat with its renderer.
        enhancer: enhances views; None where ``settings.share`` is 0.
        folder: folder of the run; its subfolder ``rounds`` holds the enhanced views.
        settings: settings of the run.
        checkpoint_seconds: seconds between checkpoints.
        progress: whether to show progress bars.
        input_identity: identifies the splat, the weights and their options, for folders whose names do not identify
            them: a checkpoint with another identity is refused.
        stop_after: stop after this step with a checkpoint, as if the process were killed; for tests.

    Raises:
        InputError: a photo cannot be read, the checkpoint is of another run, or the disk cannot be written.
    """
    run = _DistilState(capture.with_split(capture.train, ()), start, enhancer, folder, settings, input_identity)
    last_step = settings.steps if stop_after is None else min(stop_after, settings.steps)
    last_saved = time.monotonic()
    while run.step < last_step:
        round_index = settings.round_of(run.step)
        run.save()  # so that a resumed run makes the missing views from the same splat
        with FitProgress(
            settings.views, f"enhance views, round {round_index + 1} of {settings.rounds}", progress
        ) as bar:
            for index in run.begin_round():
                bar.update_views(index + 1, settings.views)
        with FitProgress(settings.steps, f"distil {capture.name}", progress) as bar:
            while run.step < last_step and settings.round_of(run.step) == round_index:
                loss, difference = run.train_step()
                bar.update(run.step, loss, difference, len(run.optimiser))
                if time.monotonic() - last_saved > checkpoint_seconds:
                    run.save()
                    last_saved = time.monotonic()
    run.save()
    return run.splat()


class _DistilState:
    """State of one run."""

    def __init__(
        self,
        capture: Scene,
        start: SplatRenderer,
        enhancer: SetEnhancer | None,
        folder: Path,
        settings: DistilSettings,
        input_identity: str,
    ) -> None:
        self.capture, self.enhancer, self.folder, self.settings = capture, enhancer, folder, settings
        self.input_identity = input_identity
        self.initial_renderer, self.device = start, start.gaussians.means.device
        self.photos = TrainingPhotos(capture, self.device)
        self.views: EnhancedViews | None = None
        self.smoothing = start.gaussians.smoothing
        self.step = 0
        checkpoint = load_checkpoint(folder, self._identity())
        self.optimiser = self._optimiser(start.gaussians if checkpoint is None else Gaussians(**checkpoint["splat"]))
        if checkpoint is None:
            shutil.rmtree(folder / "rounds", ignore_errors=True)  # of an earlier run whose checkpoint was deleted
        else:
            saved_smoothing = checkpoint["splat"]["smoothing"]
            self.optimiser.restore({name: value.to(self.device) for name, value in checkpoint["optimiser"].items()})
            self.smoothing = None if saved_smoothing is None else saved_smoothing.to(self.device)
            self.step = checkpoint["step"]

    def begin_round(self) -> Iterator[int]:
        """Make the enhanced views of the current round that are not on disk yet; yield the index of each."""
        settings, round_index = self.settings, self.settings.round_of(self.step)
        if settings.share == 0:
            return
        if self.enhancer is None:
            raise ValueError("enhanced views need an enhancer")
        cameras = new_cameras(
            self.photos.cameras,
            settings.views,
            settings.around,
            round_index=round_index,
            rounds=settings.rounds,
            seed=settings.seed,
        )
        self.views = EnhancedViews(self.folder / "rounds" / str(round_index + 1), cameras)
        renderer = dataclasses.replace(self.initial_renderer, gaussians=self.splat())
        yield from self.views.make(renderer, self.capture.train_photos, self.enhancer)

    def train_step(self) -> tuple[Tensor, Tensor]:
        """Make one step; return the loss and the difference of render and image."""
        random_number = torch.rand((), generator=self._generator(self.step, _Purpose.IMAGE_CHOICE)).item()
        uses_view = self.views is not None and random_number < self.settings.share
        loss, difference = self._view_loss() if uses_view else self._photo_loss()
        loss.backward()
        self.optimiser.step(self.step)
        self.step += 1
        if self.step % SMOOTHING_EVERY == 0 or self.step == self.settings.steps:
            self._smooth()
        return loss.detach(), difference

    def splat(self) -> Gaussians:
        """Return the current Gaussians, detached, with the sizes of their 3D filter."""
        return self.optimiser.detached_gaussians(self.smoothing)

    def save(self) -> None:
        """Write the checkpoint, which replaces the previous one."""
        save_checkpoint(
            self.folder,
            {
                "identity": self._identity(),
                "step": self.step,
                "splat": self.splat().tensors(),
                "optimiser": self.optimiser.state(),
            },
        )

    def _photo_loss(self) -> tuple[Tensor, Tensor]:
        """Loss on a training photo. In each pass of ``len(self.photos)`` steps, a photo is used at most once.

        The order of the photos is random; seed and number of the pass determine it.
        """
        count = len(self.photos)
        epoch, position = divmod(self.step, count)
        photo_index = int(torch.randperm(count, generator=self._generator(epoch, _Purpose.PHOTO_ORDER))[position])
        colour, target = self._colour(self.photos.cameras[photo_index]), self.photos.target(photo_index)
        loss = photometric_loss(colour, target, self.settings.ssim_weight)
        return loss, colour.detach() - target.photo

    def _view_loss(self) -> tuple[Tensor, Tensor]:
        """Loss on a random enhanced view, with the gradient scaled by weight and confidence."""
        if self.views is None:
            raise ValueError("a round begins before its first step")
        view_index = int(torch.randint(len(self.views), (), generator=self._generator(self.step, _Purpose.VIEW_CHOICE)))
        image, confidence = (tensor.to(self.initial_renderer.gaussians.means) for tensor in self.views.read(view_index))
        colour = self._colour(self.views.cameras[view_index])
        gradient_scale = self.settings.weight * confidence
        # The value of the loss is unchanged; its gradient is scaled at each pixel.
        scaled_colour = gradient_scale * colour + (1 - gradient_scale) * colour.detach()
        loss = photometric_loss(scaled_colour, prepare(image), self.settings.ssim_weight)
        return loss, colour.detach() - image

    def _colour(self, camera: Camera) -> Float[Tensor, "3 h w"]:
        renderer = self.initial_renderer
        gaussians = dataclasses.replace(self.optimiser.gaussians(), smoothing=self.smoothing)
        return render(gaussians, camera, renderer.method, renderer.background, near=renderer.near).colour

    def _optimiser(self, gaussians: Gaussians) -> SplatOptimiser:
        settings, extent = self.settings, camera_extent(self.photos.cameras)
        return SplatOptimiser(gaussians.to(self.device), settings.rates, extent, settings.steps, float(settings.fade))

    def _smooth(self) -> None:
        """Update the size of the 3D filter."""
        if isinstance(self.initial_renderer.method, MipSplatting):
            means = self.optimiser.gaussians(0).means.detach()
            self.smoothing = filter_size(means, self.photos.cameras, near=self.initial_renderer.near)

    def _generator(self, number: int, purpose: _Purpose) -> torch.Generator:
        return step_generator(self.settings.seed, number, purpose)

    def _identity(self) -> str:
        """Description of the run, which must equal that in a checkpoint to be resumed."""
        description = f"{self.capture.name}, {len(self.photos)} photos, {self.initial_renderer.method}, {self.settings}"
        return f"{description}, {self.input_identity}" if self.input_identity else description
