"""What is enhanced: a fitted run, a splat with its capture, or a folder of renders."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from omegaconf import DictConfig

from gaussian_enhancer.align.depth_search import DepthKind
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.runs.high_resolution import HighResolutionPhotos, high_resolution_config
from gaussian_enhancer.runs.instantiate import build
from gaussian_enhancer.runs.rendered_capture import render_capture
from gaussian_enhancer.scene.high_resolution import attach_fine_photos
from gaussian_enhancer.scene.rendered import RenderedSet
from gaussian_enhancer.scene.renders import read_folder, read_run, run_steps
from gaussian_enhancer.scene.scene import Scene


@dataclass(frozen=True)
class Task:
    """What is enhanced.

    Args:
        rendered: targets and references.
        step: training step of the renders, 0 where there is none.
        note: why photos 4 times as fine as the renders were asked for and are not there.
        depth: what the targets' depth is.
        origins: where "cameras" and "depth" come from that were not given, or why they could not be recovered.
    """

    rendered: RenderedSet
    step: int = 0
    note: str = ""
    depth: DepthKind = "surface"
    origins: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class InputPaths:
    """One of three forms of input, by its paths.

    Args:
        run: folder of a fitted run, this project's or original 3DGS output.
        gaussians: file of a splat, which is rendered from the cameras of ``capture``.
        renders: folder of renders.
        step: of a run: the training step whose renders are enhanced; None takes the latest.
        every: of a run: every n-th of its held-out views is enhanced.
        invalid: of a splat: what to do with Gaussians that are not finite, "refuse" or "drop".
        method: of a splat: how it is rendered (`choose_method`).
        views: of a splat: which of the capture's cameras it is rendered from, "test", "train" or "all".
        photos: of a folder: folder of photos. Those with a render's name are its truth, the others references.
        references: of a folder: folder of reference photos, where ``photos`` holds truths alone.
        cameras: of a folder: ``cameras.json`` of renders and references.
        depth: of a folder: folder of z depth under the renders' names.
        depth_scale: of a folder: scene units of one stored unit of depth.
        capture: the photographed scene, whose training photos are references; a splat needs it.
        attach_fine: attaches photos 4 times as fine as the renders to the views of a run or a splat.
    """

    run: str | Path | None = None
    gaussians: str | Path | None = None
    renders: str | Path | None = None
    step: int | None = None
    every: int = 1
    invalid: str = "refuse"
    method: str = "auto"
    views: str = "test"
    photos: str | Path | None = None
    references: str | Path | None = None
    cameras: str | Path | None = None
    depth: str | Path | None = None
    depth_scale: int | float = 1.0
    capture: Scene | None = None
    attach_fine: Callable[[RenderedSet], RenderedSet] | None = None

    def read(self, device: str, fine: bool) -> Task:
        """Read the input.

        Args:
            device: "cpu" or "cuda", where a splat is rendered.
            fine: attach photos 4 times as fine as the renders where they are known.

        Raises:
            InputError: no form of input or several were given, or the input cannot be read.
        """
        given = [name for name in ("run", "gaussians", "renders") if getattr(self, name) is not None]
        if len(given) != 1:
            received = f"was given {' and '.join(given)}" if given else "was given nothing to enhance"
            remedy = "give one of run=FOLDER, gaussians=FILE with scene=..., renders=FOLDER"
            raise InputError("enhance", received, remedy)
        if self.run is not None:
            rendered = _every_nth(read_run(self.run, self.step, capture=self.capture), self.every)
            step = run_steps(Path(self.run))[-1] if self.step is None else self.step
            return self.with_fine_photos(Task(rendered, step), fine)
        if self.gaussians is not None:
            if self.capture is None:
                raise InputError("gaussians", "comes without its capture", "add scene=capture scene.path=FOLDER")
            rendered = render_capture(self.gaussians, self.capture, self.method, self.views, device, self.invalid)
            task = Task(rendered, depth="surface" if device == "cpu" else "expected")
            return self.with_fine_photos(task, fine)
        references = self.capture if self.capture is not None else self.references
        folders = self.photos, references, self.depth, self.cameras
        rendered = read_folder(self.renders or "", *folders, depth_scale=self.depth_scale, finer=fine)
        return Task(rendered, depth="expected")

    def with_fine_photos(self, task: Task, fine: bool) -> Task:
        """The task with photos 4 times as fine where they are wanted; a note says why they are missing.

        Args:
            task: of a run or a splat.
            fine: whether they are wanted.
        """
        if not fine or self.attach_fine is None:
            return task
        try:
            return replace(task, rendered=self.attach_fine(task.rendered))
        except InputError as missing:
            return replace(task, note=str(missing))


def read_task(cfg: DictConfig, device: str, fine: bool) -> Task:
    """Read the input that a configuration names.

    Args:
        cfg: configuration of the job ``enhance``.
        device: "cpu" or "cuda", where a splat is rendered.
        fine: attach photos 4 times as fine as the renders where they are known.

    Raises:
        InputError: no form of input or several were given, or the input cannot be read.
    """
    names = ("run", "gaussians", "renders", "step", "every", "invalid", "method", "views", "photos", "references")
    values = {name: cfg[name] for name in (*names, "cameras", "depth", "depth_scale")}
    capture: Scene | None = build(cfg.scene) if cfg.get("scene") else None
    return InputPaths(**values, capture=capture, attach_fine=partial(attach_fine, cfg)).read(device, fine)


def attach_fine(cfg: DictConfig, rendered: RenderedSet) -> RenderedSet:
    """The set with photos 4 times as fine: of the scene that was given, else of the one that the run names.

    Args:
        cfg: configuration of the job.
        rendered: the views.

    Raises:
        InputError: there are no such photos.
    """
    if cfg.get("scene"):
        return attach_fine_photos(rendered, build(high_resolution_config(cfg.scene)))
    return HighResolutionPhotos(Path(cfg.runs) / "photos")(Path(cfg.run), rendered)


def _every_nth(rendered: RenderedSet, every: int) -> RenderedSet:
    """The set with every n-th of its targets, the first included."""
    if every < 1:
        raise InputError("every", f"is {every}", "give 1 (all views) or more")
    return replace(rendered, targets=rendered.targets[::every])
