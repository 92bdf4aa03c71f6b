"""The job ``video``: render a splat along a camera path, enhance every frame, and encode them."""

from collections.abc import Iterator
from pathlib import Path

from jaxtyping import Float
from omegaconf import DictConfig
from rich.console import Console
from rich.progress import MofNCompleteColumn, TimeElapsedColumn, TimeRemainingColumn
from torch import Tensor

from gaussian_enhancer.console import hides_progress, print_line, progress_bar
from gaussian_enhancer.errors import INTERRUPTED
from gaussian_enhancer.runs.enhancement import mismatch_warnings
from gaussian_enhancer.runs.instantiate import build
from gaussian_enhancer.runs.run import open_run
from gaussian_enhancer.runs.runtime import start
from gaussian_enhancer.runs.time_budget import apply_budget
from gaussian_enhancer.runs.video import (
    CameraPath,
    VideoOutput,
    load_video,
    naming_configuration,
    prepare_video,
    read_output,
)
from gaussian_enhancer.scene.image_files import write_image
from gaussian_enhancer.video.encode import VideoWriter
from gaussian_enhancer.video.film import Film, Frame
from gaussian_enhancer.video.frames import FrameFolder, frame_name
from gaussian_enhancer.video.layout import Layout


def run(cfg: DictConfig) -> None:
    """Write a video or a folder of frames. Enhanced frames are kept in the run's folder and reused.

    Args:
        cfg: see ``conf/video.yaml``.

    Raises:
        InputError: the input cannot be used, an option is out of range, or a file cannot be written.
        SystemExit: the user pressed Ctrl-C.
    """
    console = Console(stderr=True)
    read_output(cfg)
    device = start(cfg.runtime)
    cfg = apply_budget(cfg, load_video, device, console)
    video = prepare_video(cfg, device)
    output = read_output(cfg, video.path)
    notes = video.task.note, *video.validated.missing_references, *mismatch_warnings(video.validated), video.path.note
    for line in filter(None, notes):
        print_line(console, line)
    rendered = video.task.rendered
    job = open_run(naming_configuration(video), "video", f"{rendered.name}-{video.path.name}")
    planner = video.validated.planner(build(cfg.plan))
    folder = FrameFolder(job.folder / "frames")
    film = Film(video.enhancer, rendered, planner, video.validated.pool, folder, output.layout.needs_render)
    try:
        destination = _write(film, video.path, output, job.folder, console, hides_progress(cfg, console))
    except KeyboardInterrupt:
        frame_count = sum(folder.has(index) for index in range(len(rendered.targets)))
        message = f"stopped with {frame_count} of {len(rendered.targets)} frames made; the same command resumes"
        print_line(console, f"{job.folder}: {message}")
        raise SystemExit(INTERRUPTED) from None
    job.finish()
    height, width = output.layout.size(*film.size)
    message = f"{video.path.count} frames of {width}x{height}"
    if output.encoding is not None:
        message += f", {video.path.count / output.encoding.fps:.1f} s at {output.encoding.fps:g} a second"
    new_count = film.stored.count(False)
    note = "" if new_count == len(rendered.targets) else f"; {new_count} were made now, the others before"
    print_line(console, f"{destination}: {message}{note}")


def _write(film: Film, path: CameraPath, output: VideoOutput, folder: Path, console: Console, hidden: bool) -> Path:
    """Write each frame as soon as it is computed, and return the path of the video or of the folder of images."""
    layout = output.layout
    images = _video_images(film, path, layout, console, hidden)
    if output.encoding is None:
        destination = output.destination or (folder / layout.kind if layout.needs_render else film.folder.folder)
        for index, image in enumerate(images):
            if destination != film.folder.folder or index >= len(film.stored):
                write_image(destination / frame_name(index), image)
        surplus = sum(file.name > frame_name(path.count - 1) for file in destination.glob("frame_*.png"))
        if surplus:
            print_line(console, f"WARNING: {destination} also holds {surplus} frames of an earlier, longer video")
        return destination
    container = output.encoding.container
    with VideoWriter(folder / f"{layout.kind}.part.{container}", output.encoding, *layout.size(*film.size)) as writer:
        for image in images:
            writer.write(image)
    destination = output.destination or folder / f"{layout.kind}.{container}"
    writer.finish(destination, output.sound)
    return destination


def _video_images(
    film: Film, path: CameraPath, layout: Layout, console: Console, hidden: bool
) -> Iterator[Float[Tensor, "3 h w"]]:
    """Images of the video: each frame of the path, then the clip's frames without a camera, which are not enhanced."""
    for frame in _enhanced_frames(film, console, hidden):
        yield layout(film.shown_render(frame), frame.enhanced, frame.index / path.count)
    if path.clip is not None:
        for index in range(len(path.cameras), path.count):
            image = film.enlarge(path.clip.frame(index))
            yield layout(image, image, index / path.count)


def _enhanced_frames(film: Film, console: Console, hidden: bool) -> Iterator[Frame]:
    """Yield the frames with a progress bar. Later frames are computed while earlier ones are encoded."""
    columns = MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn()
    new_count = film.stored.count(False)
    with progress_bar(*columns, hidden=hidden, console=console) as progress:
        task = progress.add_task("enhancing" if new_count else "encoding", total=new_count or len(film.stored))
        for frame in film:
            yield frame
            if not (new_count and frame.stored):  # so that the remaining time refers to frames not yet computed
                progress.advance(task)
