"""What the job enhance is given: a fitted run, a splat with its capture, or a folder of renders."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from jaxtyping import Float
from omegaconf import DictConfig
from torch import Tensor

from gaussian_enhancer.align.depth_search import DepthKind
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.runs.high_resolution import HighResolutionPhotos, high_resolution_config
from gaussian_enhancer.runs.instantiate import build
from gaussian_enhancer.scene.high_resolution import attach_fine_photos
from gaussian_enhancer.scene.rendered import RenderedSet, RenderedView
from gaussian_enhancer.scene.renders import read_folder, read_run, run_steps
from gaussian_enhancer.scene.scene import Photo, Scene
from gaussian_enhancer.types import Render


@dataclass(frozen=True)
class Task:
    """What is to be enhanced, and what it is called.

    Args:
        rendered: targets and references.
        step: training step of the renders, 0 where there is none.
        note: why photos 4 times as fine were asked for and are not there, in words.
        depth: what the targets' depth is.
    """

    rendered: RenderedSet
    step: int = 0
    note: str = ""
    depth: DepthKind = "surface"


def read_task(cfg: DictConfig, device: str, fine: bool) -> Task:
    """Read the one form of input that was given, with photos 4 times as fine where they are wanted and known."""
    given = [name for name in ("run", "gaussians", "renders") if cfg[name] is not None]
    if len(given) != 1:
        received = f"was given {' and '.join(given)}" if given else "was given nothing to enhance"
        raise InputError("enhance", received, "give one of run=FOLDER, gaussians=FILE with scene=..., renders=FOLDER")
    capture: Scene | None = build(cfg.scene) if cfg.get("scene") else None
    if given == ["run"]:
        rendered = _every(read_run(cfg.run, cfg.step, capture=capture), cfg.every)
        step = run_steps(Path(cfg.run))[-1] if cfg.step is None else cfg.step
        return _finely(Task(rendered, step), cfg) if fine else Task(rendered, step)
    if given == ["gaussians"]:
        if capture is None:
            raise InputError("gaussians", "comes without its capture", "add scene=capture scene.path=FOLDER")
        rendered = render_capture(cfg.gaussians, capture, cfg.method, cfg.views, device, cfg.invalid)
        task = Task(rendered, depth="surface" if device == "cpu" else "expected")
        return _finely(task, cfg) if fine else task
    references = capture if capture is not None else cfg.references
    folders = cfg.photos, references, cfg.depth, cfg.cameras
    return Task(read_folder(cfg.renders, *folders, depth_scale=cfg.depth_scale, finer=fine), depth="expected")


def _finely(task: Task, cfg: DictConfig) -> Task:
    """The task with photos 4 times as fine: of the scene that was given, else of the one that the run names."""
    try:
        if cfg.get("scene"):
            return replace(task, rendered=attach_fine_photos(task.rendered, build(high_resolution_config(cfg.scene))))
        return replace(task, rendered=HighResolutionPhotos(Path(cfg.runs) / "photos")(Path(cfg.run), task.rendered))
    except InputError as missing:
        return replace(task, note=str(missing))


def _every(rendered: RenderedSet, every: int) -> RenderedSet:
    """The set with every n-th of its targets, the first included."""
    if every < 1:
        raise InputError("every", f"is {every}", "give 1 (all views) or more")
    return replace(rendered, targets=rendered.targets[::every])


def render_capture(
    file: str, capture: Scene, method: str, views: str, device: str = "cpu", invalid: str = "refuse"
) -> RenderedSet:
    """Views of a capture rendered from a splat as they are asked for.

    Args:
        file: the splat.
        capture: cameras and reference photos.
        method: "3dgs", "2dgs", "mip_splatting", or "auto": what the splat's own values ask for.
        views: "test", "train" or "all".
        device: where to render.
        invalid: what to do with Gaussians that are not finite: "refuse" or "drop".

    Raises:
        InputError: the splat cannot be read, the method or the choice of views is unknown, or no view remains.
    """
    from gaussian_enhancer.splat.io.open import read_splat
    from gaussian_enhancer.splat.methods import MipSplatting, ThreeDGS, TwoDGS
    from gaussian_enhancer.splat.near import near_plane
    from gaussian_enhancer.splat.render import render

    gaussians = read_splat(file, invalid=invalid).to(device)
    own = (
        TwoDGS()
        if gaussians.log_scales.shape[1] == 2
        else ThreeDGS()
        if gaussians.smoothing is None
        else MipSplatting()
    )
    methods = {"auto": own, **{known.name: known for known in (ThreeDGS(), TwoDGS(), MipSplatting())}}
    if method not in methods:
        raise InputError("method", f"is {method!r}", f"choose {', '.join(methods)}")
    sides = {"test": capture.test_photos, "train": capture.train_photos, "all": capture.photos}
    if views not in sides:
        raise InputError("views", f"is {views!r}", f"choose {', '.join(sides)}")
    if not sides[views]:
        raise InputError(capture.name, f"has no {views} view", "change the split, or views=all")

    near = near_plane([photo.camera for photo in capture.train_photos if photo.camera is not None])

    def lossless(photo: Photo) -> str:
        """The photo's name as a render is stored; a target and the photo of the same view share it."""
        return str(Path(photo.name).with_suffix(".png"))

    def drawn(photo: Photo, parts: tuple[str, ...]) -> _Drawing:
        if photo.camera is None:
            raise InputError(photo.name, "has no camera to render from", "give a capture with cameras")
        camera = photo.camera.to(device)
        how = methods[method]
        return _Drawing(lambda: render(gaussians, camera, how, capture.background, near=near).to("cpu"), parts)

    def target(photo: Photo) -> RenderedView:
        draw = drawn(photo, ("colour", "surface", "alpha"))
        return RenderedView(lossless(photo), draw.colour, photo.camera, draw.depth, draw.alpha, photo.read)

    def reference(photo: Photo) -> RenderedView:
        draw = drawn(photo, ("colour", "surface"))
        return RenderedView(lossless(photo), draw.colour, photo.camera, draw.depth, None, photo.read)

    targets, references = map(target, sides[views]), map(reference, capture.train_photos)
    return RenderedSet(capture.name, tuple(targets), tuple(references), capture.background)


class _Drawing:
    """Parts of one rendering, which is made once for all of them; each is forgotten when it was read."""

    def __init__(self, draw: Callable[[], Render], wanted: tuple[str, ...]) -> None:
        self.draw, self.wanted = draw, wanted
        self.parts: dict[str, Tensor] = {}

    def colour(self) -> Float[Tensor, "3 h w"]:
        """The render as 8 bits keep it, as folders of renders have it."""
        return (self._part("colour").clamp(0, 1) * 255).round() / 255

    def depth(self) -> Float[Tensor, "1 h w"]:
        """Depth of the surface."""
        return self._part("surface")

    def alpha(self) -> Float[Tensor, "1 h w"]:
        """Opacity."""
        return self._part("alpha")

    def _part(self, name: str) -> Tensor:
        if name not in self.parts:
            with torch.no_grad():
                drawing = self.draw()
            self.parts = {part: getattr(drawing, part) for part in self.wanted}
        return self.parts.pop(name)
