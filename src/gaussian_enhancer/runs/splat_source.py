"""A splat with the capture that it was fitted to, read from a run's folder or from a splat file and its scene."""

import dataclasses
from dataclasses import dataclass
from pathlib import Path

from omegaconf import DictConfig

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.runs.arguments import only_given
from gaussian_enhancer.runs.instantiate import build
from gaussian_enhancer.runs.rendered_capture import SplatRenderer, open_renderer, refuse_unseen
from gaussian_enhancer.scene.rendered import RenderedSet, RenderedView
from gaussian_enhancer.scene.renders import read_run
from gaussian_enhancer.scene.scene import Photo, Scene
from gaussian_enhancer.splat.io.result_folders import find_splat, latest_iteration
from gaussian_enhancer.types import Camera


@dataclass(frozen=True)
class SplatWithCapture:
    """A splat's file with the cameras and photos of its capture.

    Args:
        splat: file of the splat.
        cameras: cameras of all photos, in the capture's order.
        rendered: the training photos as references of a set. Those of a run come with renders, and the targets are
            those of the run.
    """

    splat: Path
    cameras: tuple[Camera, ...]
    rendered: RenderedSet

    def renderer(self, cfg: DictConfig, device: str, splat: str | Path | None = None) -> SplatRenderer:
        """Create the renderer of the splat.

        Args:
            cfg: configuration with ``method`` and ``invalid``.
            device: "cpu" or "cuda".
            splat: another splat of the same capture; None uses the capture's own.

        Raises:
            InputError: the splat cannot be read or lies outside the capture's views, or the method is unknown.
        """
        training = tuple(view.camera for view in self.rendered.references if view.camera is not None)
        file = self.splat if splat is None else splat
        renderer = open_renderer(file, training, self.rendered.background, cfg.method, device, cfg.invalid)
        refuse_unseen(renderer, self.cameras, file, self.rendered.name)
        return renderer

    def references_rendered_by(self, renderer: SplatRenderer, again: bool = False) -> RenderedSet:
        """The set, whose references without a render are rendered from the splat.

        Args:
            renderer: renderer of the splat.
            again: render all of them, since the splat is another one than that of the capture's renders.
        """
        references = tuple(
            renderer.reference(Photo(view.name, view.camera, view.read_photo))
            if view.read_photo is not None and (again or view.read is None)
            else view
            for view in self.rendered.references
        )
        return dataclasses.replace(self.rendered, references=references)


def open_splat_with_capture(cfg: DictConfig, job: str) -> SplatWithCapture:
    """Read the capture of a configuration that has one of ``run`` and ``gaussians``. The splat itself is not read.

    Args:
        cfg: configuration of the job.
        job: name of the job, for messages.

    Raises:
        InputError: no splat or several were given, or the capture cannot be read or has photos without a camera.
    """
    inputs = {name: cfg[name] for name in ("run", "gaussians")}
    form = only_given(inputs, job, "nothing to render", "give one of run=FOLDER, gaussians=FILE with scene=...")
    return _read_run(cfg) if form == "run" else _read_splat_and_scene(cfg)


def splat_file(run: str | Path) -> Path:
    """The splat file of a run's folder: this project's file, or original 3DGS output at its latest iteration.

    Args:
        run: folder of the run.

    Raises:
        InputError: the folder holds no splat.
    """
    project_file = Path(run) / "splat.ply"
    if project_file.is_file():
        return project_file
    latest = latest_iteration(Path(run))
    if latest is None:
        received = "holds neither splat.ply nor point_cloud/iteration_*/point_cloud.ply"
        raise InputError(run, received, "name a run's folder, or give gaussians=FILE with scene=...")
    return latest


def _read_run(cfg: DictConfig) -> SplatWithCapture:
    rendered = read_run(cfg.run, capture=build(cfg.scene) if cfg.get("scene") else None)
    views = sorted((*rendered.targets, *rendered.references), key=lambda view: view.name)
    cameras = tuple(view.camera for view in views if view.camera is not None)
    if len(cameras) < len(views):
        raise InputError(cfg.run, "has views without a camera", "give gaussians=FILE with scene=... instead")
    return SplatWithCapture(splat_file(cfg.run), cameras, rendered)


def _read_splat_and_scene(cfg: DictConfig) -> SplatWithCapture:
    if not cfg.get("scene"):
        raise InputError("gaussians", "comes without its capture", "add scene=capture scene.path=FOLDER")
    scene: Scene = build(cfg.scene)
    cameras = tuple(photo.camera for photo in scene.photos if photo.camera is not None)
    if len(cameras) < len(scene.photos):
        raise InputError(scene.name, "has photos without a camera", "give a capture with cameras")
    photos = (RenderedView(photo.name, None, photo.camera, read_photo=photo.read) for photo in scene.train_photos)
    rendered = RenderedSet(scene.name, (), tuple(photos), scene.background, own_depth=True)
    return SplatWithCapture(find_splat(cfg.gaussians), cameras, rendered)
