"""The enhance job: a fitted run, a splat with its capture, or a folder of renders, to enhanced images."""

import shutil
import statistics
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from jaxtyping import Float
from omegaconf import DictConfig
from rich.console import Console
from rich.progress import track
from torch import Tensor

from gaussian_enhancer.apps.build import build
from gaussian_enhancer.apps.finer import FinePhotos, finer_config
from gaussian_enhancer.apps.run import open_run
from gaussian_enhancer.apps.runtime import start
from gaussian_enhancer.enhance.alignment import Reprojected
from gaussian_enhancer.enhance.depth import SEARCHES, DepthKind
from gaussian_enhancer.enhance.enhancer import Enhanced, Enhancer
from gaussian_enhancer.enhance.images import write_image
from gaussian_enhancer.enhance.prepare import Preparation
from gaussian_enhancer.enhance.pyramid import enlarged
from gaussian_enhancer.enhance.tiles import check_tiles
from gaussian_enhancer.enhance.weights import Pretrained, load_weights
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import whole_file
from gaussian_enhancer.measure.records import Record, write_records
from gaussian_enhancer.scene.depth_files import ReadDepth
from gaussian_enhancer.scene.finer import attach_fine_photos
from gaussian_enhancer.scene.photos import read_header
from gaussian_enhancer.scene.posed import ReadCoverage, ReadPhoto
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


def run(cfg: DictConfig) -> float | None:
    """Enhance and write images of the same names.

    With ``output`` the images alone are written there. Otherwise a run's folder is made in the layout that ``measure
    run=`` reads: renders, enhanced images and photos side by side, and the cost in records.

    Returns:
        Median milliseconds an image took in the network.
    """
    device = start(cfg.runtime)
    console = Console(stderr=True)
    pretrained = load_weights(cfg.weights)
    task = _task(cfg, device.type, pretrained.preparation.fine)
    preparation, note = _fitting(_asked(pretrained, cfg, task.depth), task.rendered)
    enhancer = Enhancer(
        pretrained.network, preparation, device, cfg.precision, cfg.tile, strength=_strength(pretrained, cfg)
    )
    check_tiles(enhancer.tile, enhancer.halo)
    hidden = not (cfg.runtime.progress and console.is_terminal)
    for read in track(_files(task.rendered, preparation, not cfg.output), "reading", console=console, disable=hidden):
        read()
    for line in filter(None, (task.note, note)):
        console.print(line, highlight=False, soft_wrap=True)
    views = enhancer(task.rendered)
    shown = track(views, "enhancing", total=len(task.rendered.targets), console=console, disable=hidden)
    if cfg.output:
        return _tell(_write(shown, Path(cfg.output)), Path(cfg.output), console)
    job = open_run(cfg, "enhance", task.rendered.name)
    side = job.folder / "test" / f"ours_{task.step}"
    written = _write(shown, side / "enhanced")
    if pretrained.network.scale == 1:
        _keep_sources(task.rendered, side)
    else:
        _keep_fine_sources(task.rendered, side, pretrained.network.scale)
    write_records(job.folder / "records.jsonl", [_cost(one, job.folder.name, task) for one in written])
    job.finish()
    return _tell(written, job.folder, console)


def _task(cfg: DictConfig, device: str, fine: bool) -> Task:
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
            return replace(task, rendered=attach_fine_photos(task.rendered, build(finer_config(cfg.scene))))
        return replace(task, rendered=FinePhotos(Path(cfg.runs) / "photos")(Path(cfg.run), task.rendered))
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

    def lossless(photo: Photo) -> str:
        """The photo's name as a render is stored; a target and the photo of the same view share it."""
        return str(Path(photo.name).with_suffix(".png"))

    def drawn(photo: Photo, parts: tuple[str, ...]) -> _Drawing:
        if photo.camera is None:
            raise InputError(photo.name, "has no camera to render from", "give a capture with cameras")
        camera = photo.camera.to(device)
        return _Drawing(lambda: render(gaussians, camera, methods[method], capture.background).to("cpu"), parts)

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


def _asked(pretrained: Pretrained, cfg: DictConfig, depth: DepthKind) -> Preparation:
    """The preparation that the network was trained with, for the depth and the number of references that there are.

    Args:
        pretrained: the weights.
        cfg: the job's configuration.
        depth: what the input's depth is where the user does not tell.

    Raises:
        InputError: the user names no kind of depth.
    """
    kind = depth if cfg.depth_kind == "auto" else cfg.depth_kind
    if kind not in SEARCHES:
        raise InputError("depth_kind", f"is {kind!r}", f"choose auto, {', '.join(SEARCHES)}")
    preparation = pretrained.preparation
    if isinstance(preparation.warp, Reprojected):
        preparation = replace(preparation, warp=replace(preparation.warp, depth=kind))
    if cfg.max_references is None:
        return preparation
    count = cfg.max_references
    return replace(preparation, references=count, candidates=max(count, preparation.candidates))


def _strength(pretrained: Pretrained, cfg: DictConfig) -> float:
    """The share that the user asks for, or the one that the weights' card found best on its validation runs."""
    if cfg.strength is not None:
        return float(cfg.strength)
    value = pretrained.card.get("strength", 1.0)
    if not isinstance(value, int | float):
        raise InputError(f"weights {cfg.weights}", f"state strength {value!r}", "give strength= as a number")
    return float(value)


def _fitting(preparation: Preparation, rendered: RenderedSet) -> tuple[Preparation, str]:
    """The preparation as far as the input allows, and what it leaves out in words.

    Raises:
        InputError: there is no photo to refer to where references are asked for.
    """
    if preparation.references and not rendered.references:
        remedy = "add scene=capture scene.path=FOLDER, or max_references=0 to enhance from the renders alone"
        raise InputError(rendered.name, "has no photo to refer to", remedy)
    note = ""
    if preparation.fine and any(view.read_fine_photo is None for view in rendered.references):
        preparation = replace(preparation, fine=False)
        note = "photos 4 times as fine as the renders are not known: enlarging without their detail"
    if not isinstance(preparation.warp, Reprojected) or preparation.references == 0:
        return preparation, note
    bare = [v.name for v in rendered.targets if v.camera is None or v.read_depth is None]
    bare += [view.name for view in rendered.references if view.camera is None]
    if not bare:
        return preparation, note
    lack = f"{bare[0]} has no camera or no depth, so that photos cannot be reprojected"
    return replace(preparation, references=0), f"{lack}: enhancing from the renders alone"


def _files(rendered: RenderedSet, preparation: Preparation, keep_photos: bool) -> list[Callable[[], Tensor]]:
    """All that will be read from files: read once before the first image is written, so that a damaged one is found.

    Args:
        rendered: targets and references.
        preparation: whether references are looked at.
        keep_photos: whether the targets' own photos are looked at.
    """
    reads: list[Callable[[], Tensor] | None] = []
    for view in rendered.targets:
        reads += [view.read, view.read_depth, view.read_alpha, view.read_photo if keep_photos else None]
        reads.append(view.read_fine_photo if keep_photos else None)
    for view in rendered.references if preparation.references else ():
        reads += [view.read_photo, view.read_depth, view.read, view.read_fine_photo]
    return [read for read in reads if isinstance(read, ReadPhoto | ReadDepth | ReadCoverage)]


def _write(views: Iterable[Enhanced], folder: Path) -> list[Enhanced]:
    """Write each image as it comes; what was written is returned without its pixels."""
    written = []
    for one in views:
        write_image(folder / one.name, one.image)
        written.append(replace(one, image=one.image[:, :0, :0]))
    return written


def _keep_sources(rendered: RenderedSet, side: Path) -> None:
    """Put renders and photos beside the enhanced images: copies of their files where they have one."""
    for view in rendered.targets:
        for part, read in (("renders", view.read), ("gt", view.read_photo)):
            if read is None:
                continue
            path = side / part / view.name
            if isinstance(read, ReadPhoto) and _as_stored(read) and read.path.suffix == path.suffix:
                with whole_file(path) as temporary:
                    shutil.copyfile(read.path, temporary)
            else:
                write_image(path, read())


def _keep_fine_sources(rendered: RenderedSet, side: Path, scale: int) -> None:
    """Put renders, enlarged bicubically, and photos that are as fine beside images that are finer than the renders."""
    for view in rendered.targets:
        if view.read is not None:
            write_image(side / "renders" / view.name, enlarged(view.read()[None], scale)[0])
        if view.read_fine_photo is not None:
            write_image(side / "gt" / view.name, view.read_fine_photo())


def _as_stored(read: ReadPhoto) -> bool:
    """Whether what is read is what the file holds."""
    header = read_header(read.path)
    return read.lens is None and not header.has_alpha and (header.height, header.width) == (read.height, read.width)


def _cost(one: Enhanced, run_name: str, task: Task) -> Record:
    values: dict[str, float | None] = {"milliseconds": one.enhancing}
    splat = f"ours_{task.step}"
    return Record("cost", run_name, task.rendered.name, splat, one.name, "enhanced", values)


def _tell(written: list[Enhanced], folder: Path, console: Console) -> float:
    network = statistics.median(one.enhancing for one in written)
    preparing = statistics.median(one.preparing for one in written)
    console.print(
        f"{folder}: {len(written)} images, {network:.0f} ms each (median) and {preparing:.0f} ms for its references",
        highlight=False,
        soft_wrap=True,
    )
    return network
