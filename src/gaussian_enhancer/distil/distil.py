"""Going on with a finished splat: steps on its training photos and on enhanced views at new cameras, in rounds.

All randomness is a function of seed and step, so that a resumed run draws what the uninterrupted one would have drawn.

Axes: h height, w width.
"""

import dataclasses
import time
from collections.abc import Iterator
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
from gaussian_enhancer.splat.fit.geometry import camera_extent
from gaussian_enhancer.splat.fit.optimise import SplatOptimiser
from gaussian_enhancer.splat.fit.progress import FitProgress
from gaussian_enhancer.splat.fit.similarity import photometric_loss, prepare
from gaussian_enhancer.splat.fit.targets import TrainingPhotos
from gaussian_enhancer.splat.methods import MipSplatting
from gaussian_enhancer.splat.render import render
from gaussian_enhancer.types import Camera, Gaussians

SMOOTHING_EVERY = 100
"""Steps between two looks at how finely the photos sample each Gaussian, as in a fit."""


def distil(
    capture: Scene,
    start: SplatRenderer,
    enhancer: SetEnhancer | None,
    folder: Path,
    settings: DistilSettings,
    *,
    checkpoint_seconds: float = 60.0,
    progress: bool = True,
    made_of: str = "",
    stop_after: int | None = None,
) -> Gaussians:
    """Distil enhanced views into a splat. A folder with a checkpoint of the same run is continued.

    The loss of a step on a photo is a fit's. On an enhanced view its gradient is scaled, pixel by pixel, by
    ``settings.weight`` and the view's confidence. No Gaussian joins.

    Args:
        capture: its training photos are fitted to, and are the enhancer's references. Held-out photos and their cameras
            are not looked at.
        start: the splat to begin with and how it is rendered.
        enhancer: makes the enhanced views; None where ``settings.share`` is 0.
        folder: of the run; ``rounds`` in it holds the enhanced views.
        settings: choices.
        checkpoint_seconds: time between checkpoints.
        progress: show a progress bar.
        made_of: tells this splat, these weights and their options from others, for folders that are not named by them:
            a checkpoint of others is refused.
        stop_after: end after this step with a checkpoint, as if killed; for tests.

    Raises:
        InputError: photos, checkpoint or disk do not allow it.
    """
    work = _Work(capture.with_split(capture.train, ()), start, enhancer, folder, settings, made_of)
    last = settings.steps if stop_after is None else min(stop_after, settings.steps)
    saved = time.monotonic()
    while work.step < last:
        number = settings.round_of(work.step)
        work.save()  # views that a killed run has left to make are made from the same splat
        with FitProgress(settings.views, f"enhance views, round {number + 1} of {settings.rounds}", progress) as bar:
            for index in work.begin_round():
                bar.swept(index + 1, settings.views)
        with FitProgress(settings.steps, f"distil {capture.name}", progress) as bar:
            while work.step < last and settings.round_of(work.step) == number:
                loss, difference = work.advance()
                bar.update(work.step, loss, difference, len(work.optimiser))
                if time.monotonic() - saved > checkpoint_seconds:
                    work.save()
                    saved = time.monotonic()
    work.save()
    return work.splat()


class _Work:
    """The state of one run."""

    def __init__(
        self,
        capture: Scene,
        start: SplatRenderer,
        enhancer: SetEnhancer | None,
        folder: Path,
        settings: DistilSettings,
        made_of: str,
    ) -> None:
        self.capture, self.enhancer, self.folder, self.settings = capture, enhancer, folder, settings
        self.made_of = made_of
        self.first = start
        self.photos = TrainingPhotos(capture, self.first.gaussians.means.device)
        self.views: EnhancedViews | None = None
        self.smoothing = self.first.gaussians.smoothing
        self.step = 0
        checkpoint = load_checkpoint(folder, self._identity())
        self.optimiser = self._optimiser(
            self.first.gaussians if checkpoint is None else Gaussians(**checkpoint["splat"])
        )
        if checkpoint is not None:
            device, smoothing = self.first.gaussians.means.device, checkpoint["splat"]["smoothing"]
            self.optimiser.restore({name: value.to(device) for name, value in checkpoint["optimiser"].items()})
            self.smoothing = None if smoothing is None else smoothing.to(device)
            self.step = checkpoint["step"]

    def begin_round(self) -> Iterator[int]:
        """Make the enhanced views of the present round that are not on disk yet; yields the number of each."""
        settings, number = self.settings, self.settings.round_of(self.step)
        if settings.share == 0:
            return
        if self.enhancer is None:
            raise ValueError("enhanced views need an enhancer")
        which = {"number": number, "rounds": settings.rounds, "seed": settings.seed}
        cameras = new_cameras(self.photos.cameras, settings.views, settings.around, **which)
        self.views = EnhancedViews(self.folder / "rounds" / str(number + 1), cameras)
        renderer = dataclasses.replace(self.first, gaussians=self.splat())
        yield from self.views.make(renderer, self.capture.train_photos, self.enhancer)

    def advance(self) -> tuple[Tensor, Tensor]:
        """One step; returns the loss and the difference of render and image."""
        chance = torch.rand((), generator=self._generator(self.step, 1)).item()
        on_view = self.views is not None and chance < self.settings.share
        loss, difference = self._view_loss() if on_view else self._photo_loss()
        loss.backward()
        self.optimiser.step(self.step)
        self.step += 1
        if self.step % SMOOTHING_EVERY == 0 or self.step == self.settings.steps:
            self._smooth()
        return loss.detach(), difference

    def splat(self) -> Gaussians:
        """The present Gaussians, detached, the 3D filter included."""
        return self.optimiser.detached_gaussians(self.smoothing)

    def save(self) -> None:
        """Replace the checkpoint."""
        splat = self.splat()
        values = {f.name: getattr(splat, f.name) for f in dataclasses.fields(splat)}
        state = {"identity": self._identity(), "step": self.step, "splat": values, "optimiser": self.optimiser.state()}
        save_checkpoint(self.folder, state)

    def _photo_loss(self) -> tuple[Tensor, Tensor]:
        """Every photo once before any comes again, in an order that seed and turn determine."""
        count = len(self.photos)
        turn, position = divmod(self.step, count)
        number = int(torch.randperm(count, generator=self._generator(turn, 2))[position])
        colour, target = self._colour(self.photos.cameras[number]), self.photos.target(number)
        loss = photometric_loss(colour, target, self.settings.ssim_weight)
        return loss, colour.detach() - target.photo

    def _view_loss(self) -> tuple[Tensor, Tensor]:
        if self.views is None:
            raise ValueError("a round begins before its first step")
        number = int(torch.randint(len(self.views), (), generator=self._generator(self.step, 3)))
        image, confidence = (one.to(self.first.gaussians.means) for one in self.views.read(number))
        colour = self._colour(self.views.cameras[number])
        pulled = self.settings.weight * confidence
        # The value of the loss stays; its gradient is scaled pixel by pixel.
        weighted = pulled * colour + (1 - pulled) * colour.detach()
        loss = photometric_loss(weighted, prepare(image), self.settings.ssim_weight)
        return loss, colour.detach() - image

    def _colour(self, camera: Camera) -> Float[Tensor, "3 h w"]:
        gaussians = dataclasses.replace(self.optimiser.gaussians(), smoothing=self.smoothing)
        render_options = self.first.method, self.first.background
        return render(gaussians, camera, *render_options, near=self.first.near).colour

    def _optimiser(self, gaussians: Gaussians) -> SplatOptimiser:
        on_device = gaussians.to(self.first.gaussians.means.device)
        extent = camera_extent(self.photos.cameras)
        return SplatOptimiser(on_device, self.settings.rates, extent, self.settings.steps, float(self.settings.fade))

    def _smooth(self) -> None:
        if isinstance(self.first.method, MipSplatting):
            means = self.optimiser.gaussians(0).means.detach()
            self.smoothing = filter_size(means, self.photos.cameras, near=self.first.near)

    def _generator(self, number: int, purpose: int) -> torch.Generator:
        return torch.Generator().manual_seed(((self.settings.seed * 1_000_003 + number) * 8 + purpose) % 2**63)

    def _identity(self) -> str:
        """What a checkpoint must agree on to be continued."""
        description = f"{self.capture.name}, {len(self.photos)} photos, {self.first.method}, {self.settings}"
        return f"{description}, {self.made_of}" if self.made_of else description
