"""Inputs of enhancement: a fitted run, a splat with its capture, or a folder of renders."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import partial
from pathlib import Path

from omegaconf import DictConfig

from gaussian_enhancer.align.depth_search import DepthKind
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.runs.arguments import only_given, refuse_without_effect
from gaussian_enhancer.runs.earlier_step import splats_by_step
from gaussian_enhancer.runs.high_resolution import HighResolutionPhotos, high_resolution_config
from gaussian_enhancer.runs.instantiate import build
from gaussian_enhancer.runs.rendered_capture import render_capture
from gaussian_enhancer.scene.high_resolution import attach_fine_photos
from gaussian_enhancer.scene.posed import ReadPhoto
from gaussian_enhancer.scene.rendered import RenderedSet, RenderedView
from gaussian_enhancer.scene.renders import read_folder, read_run, run_steps
from gaussian_enhancer.scene.scene import Scene


@dataclass(frozen=True)
class Task:
    """An enhancement task: the views and where their geometry comes from.

    Args:
        rendered: targets and references.
        step: training step of the renders; 0 if it is not known.
        note: reason why requested photos at 4 times the renders' resolution are missing.
        depth: kind of the targets' depth.
        origins: for "cameras" and "depth" that were not given: how they were recovered, or why they could not be.
        earlier: the targets as an earlier step rendered them; empty if none is used.
    """

    rendered: RenderedSet
    step: int = 0
    note: str = ""
    depth: DepthKind = "surface"
    origins: Mapping[str, str] = field(default_factory=dict)
    earlier: tuple[RenderedView, ...] = ()

    @property
    def earlier_files(self) -> list[Callable[[], object]]:
        """The reads of the earlier step's renders that are files, which find damaged ones."""
        return [view.read for view in self.earlier if isinstance(view.read, ReadPhoto)]


_OF_FOLDERS = ("photos", "references", "cameras", "depth", "depth_scale")
_OF_SPLATS = ("invalid", "method", "views")
WITHOUT_EFFECT = {
    "run": (*_OF_SPLATS, *_OF_FOLDERS),
    "gaussians": ("step", *_OF_FOLDERS),
    "renders": ("step", *_OF_SPLATS),
}
"""Options that have no effect with each form of input."""


@dataclass(frozen=True)
class InputPaths:
    """The paths and options of one of three forms of input: a run, a splat or a folder of renders.

    The fields are the options of the job ``enhance`` and the parameters of `enhance_folder`, which describe them. Only
    the following differ.

    Args:
        every: enhance every n-th view.
        invalid: for a splat: treatment of Gaussians that are not finite, "refuse" or "drop".
        capture: the photographed scene whose training photos are references; required for a splat.
        attach_fine: attaches photos at 4 times the renders' resolution to the views of a run or a splat.
        earlier_step: the earlier step whose renders are used as well (`choose_earlier_step`); None uses none.
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
    earlier_step: int | None = None

    def read(self, device: str, fine: bool) -> Task:
        """Read the input.

        Args:
            device: "cpu" or "cuda", for rendering a splat.
            fine: attach photos at 4 times the renders' resolution where they are available.

        Raises:
            InputError: no form of input or more than one was given, an option has no effect with it, or the input
                cannot be read.
        """
        inputs = {"run": self.run, "gaussians": self.gaussians, "renders": self.renders}
        remedy = "give one of run=FOLDER, gaussians=FILE with scene=..., renders=FOLDER"
        form = only_given(inputs, "enhance", "nothing to enhance", remedy)
        defaults = {field.name: field.default for field in fields(self)}
        refuse_without_effect((name for name in WITHOUT_EFFECT[form] if getattr(self, name) != defaults[name]), form)
        attach_fine = self.attach_fine if fine else None
        if self.run is not None:
            read = partial(read_run, self.run, capture=self.capture)
            rendered = _every_nth(read(self.step), self.every)
            step = run_steps(Path(self.run))[-1] if self.step is None else self.step
            task = Task(rendered, step, earlier=self._earlier_targets(rendered, read))
            return with_fine_photos(task, attach_fine)
        if self.gaussians is not None:
            if self.capture is None:
                raise InputError("gaussians", "comes without its capture", "add scene=capture scene.path=FOLDER")
            how = self.capture, self.method, self.views, device, self.invalid
            rendered = _every_nth(render_capture(self.gaussians, *how), self.every)
            splats = splats_by_step(self.gaussians)
            earlier = self._earlier_targets(rendered, lambda step: render_capture(splats[step], *how))
            task = Task(rendered, depth="surface" if device == "cpu" else "expected", earlier=earlier)
            return with_fine_photos(task, attach_fine)
        if self.capture is not None and self.references is not None:
            raise InputError(
                "references", "are given beside scene, whose photos are the references", "give one of them"
            )
        references = self.capture if self.capture is not None else self.references
        folders = self.photos, references, self.depth, self.cameras
        rendered = read_folder(self.renders or "", *folders, depth_scale=self.depth_scale, finer=fine)
        return Task(_every_nth(rendered, self.every), depth="surface" if rendered.own_depth else "expected")

    def _earlier_targets(self, rendered: RenderedSet, read: Callable[[int], RenderedSet]) -> tuple[RenderedView, ...]:
        """The targets as the earlier step rendered them; ``read`` returns the renders of a step.

        Raises:
            InputError: the step lacks one of them.
        """
        if self.earlier_step is None:
            return ()
        by_name = {view.name: view for view in read(self.earlier_step).targets}
        missing = next((view.name for view in rendered.targets if view.name not in by_name), None)
        if missing is not None:
            raise InputError("earlier_step", f"has no render of {missing}", "choose another step, or null")
        return tuple(by_name[view.name] for view in rendered.targets)


def with_fine_photos(task: Task, attach: Callable[[RenderedSet], RenderedSet] | None) -> Task:
    """Attach photos at 4 times the renders' resolution; if they are missing, a note states the reason.

    Args:
        task: task of a run or a splat.
        attach: attaches the photos; None if they are not requested.
    """
    try:
        return task if attach is None else replace(task, rendered=attach(task.rendered))
    except InputError as missing:
        return replace(task, note=str(missing))


def refuse_input_folder(output: Path, rendered: RenderedSet) -> None:
    """Refuse an output folder that holds files of the input, which could be replaced.

    Args:
        output: folder of the enhanced images.
        rendered: the views, whose files are looked up where they are read from files.

    Raises:
        InputError: the folder holds a render, a photo or a depth map of the input.
    """
    for view in (*rendered.targets, *rendered.references):
        for read in (view.read, view.read_photo, view.read_fine_photo, view.read_depth, view.read_alpha):
            path = getattr(read, "path", None)
            if path is not None and Path(path).resolve().parent == output.resolve():
                raise InputError(output, f"holds {Path(path).name} of the input", "name another folder")


def read_task(cfg: DictConfig, device: str, fine: bool) -> Task:
    """Read the input that a configuration names.

    Args:
        cfg: configuration of the job ``enhance``.
        device: "cpu" or "cuda", for rendering a splat.
        fine: attach photos at 4 times the renders' resolution where they are available.

    Raises:
        InputError: no form of input or more than one was given, or the input cannot be read.
    """
    values = {field.name: cfg[field.name] for field in fields(InputPaths) if field.name in cfg}
    capture: Scene | None = build(cfg.scene) if cfg.get("scene") else None
    return InputPaths(**values, capture=capture, attach_fine=partial(attach_fine, cfg)).read(device, fine)


def attach_fine(cfg: DictConfig, rendered: RenderedSet) -> RenderedSet:
    """Attach photos at 4 times the resolution, from the given scene or else from the scene that the run names.

    Args:
        cfg: configuration of the job.
        rendered: the views.

    Raises:
        InputError: there are no photos of that resolution.
    """
    if cfg.get("scene"):
        return attach_fine_photos(rendered, build(high_resolution_config(cfg.scene)))
    return HighResolutionPhotos(Path(cfg.runs) / "photos")(Path(cfg.run), rendered)


def _every_nth(rendered: RenderedSet, every: int) -> RenderedSet:
    """The set with every n-th target, starting with the first."""
    return replace(rendered, targets=rendered.targets[::every])
