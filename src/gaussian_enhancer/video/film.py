"""Rendering, enhancement and writing of a path's frames, each once, in stages that may run concurrently.

Axes: h height, w width, H, W the same times the network's scale.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.align.alignment import LoadedView
from gaussian_enhancer.align.references import ReferencePool, read_target
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.infer.path_references import PathReferences
from gaussian_enhancer.infer.planner import Planner
from gaussian_enhancer.infer.reference_cache import ReferenceFeatures
from gaussian_enhancer.infer.temporal_smoothing import PreviousChange, smooth_change
from gaussian_enhancer.network.network import CachesReferences
from gaussian_enhancer.network.pyramid import upsample_bicubic
from gaussian_enhancer.scene.in_memory import read_once
from gaussian_enhancer.scene.rendered import RenderedSet, RenderedView
from gaussian_enhancer.types import quantise_8_bit
from gaussian_enhancer.video.ahead import compute_ahead
from gaussian_enhancer.video.frames import FrameFolder


@dataclass(frozen=True)
class RenderedFrame:
    """One frame of a path before it is enhanced.

    Args:
        index: 0 for the first.
        view: the view, with its pixels in memory.
        target: pixels of the view; None where neither the frame nor the next one needs its render.
        stored_frame: the enhanced view in 8 bits and the names of the references considered for it, read from disk;
            None where they are not on disk.
    """

    index: int
    view: RenderedView
    target: LoadedView | None
    stored_frame: tuple[Float[Tensor, "3 H W"], tuple[str, ...]] | None


@dataclass(frozen=True)
class Frame:
    """One frame of a path.

    Args:
        index: 0 for the first.
        enhanced: the enhanced view in 8 bits, as stored on disk.
        render: the render; None where neither the frame nor the next one needs it.
        candidates: names of the references considered.
        stored: whether the enhanced view was on disk already.
    """

    index: int
    enhanced: Float[Tensor, "3 H W"]
    render: Float[Tensor, "3 h w"] | None
    candidates: tuple[str, ...]
    stored: bool


class Film:
    """The frames of a path. Frames on disk are not enhanced again.

    A frame on disk is rendered only where its render is shown, or where temporal smoothing of the next frame needs it.
    Temporal smoothing uses the previous frame as stored on disk, in 8 bits. So an interrupted film continues with the
    same frames as if it had not been interrupted.

    Args:
        enhancer: enhancer whose reference configuration is a `PathReferences`; its ``temporal_smoothing`` is applied
            along the path.
        rendered: the path's frames as targets, and the references.
        planner: decides which regions of a frame are enhanced, and with which references; None enhances every pixel.
        pool: pixels of the references.
        folder: folder of frames on disk; new frames are written to it.
        show_renders: render every frame, also those whose enhanced view is on disk.
        overlapped: run the stages concurrently, each in its own thread; None does so where the network runs on a GPU.
            On a CPU each stage uses all cores already (docs/video.md).
    """

    def __init__(
        self,
        enhancer: SetEnhancer,
        rendered: RenderedSet,
        planner: Planner | None,
        pool: ReferencePool,
        folder: FrameFolder,
        show_renders: bool = False,
        overlapped: bool | None = None,
    ) -> None:
        self.enhancer, self.rendered, self.planner = enhancer, rendered, planner
        self.pool = pool if planner is None else planner.pool
        self.folder, self.show_renders = folder, show_renders
        self.stored = tuple(folder.has(index) for index in range(len(rendered.targets)))
        self.overlapped = enhancer.device.type != "cpu" if overlapped is None else overlapped
        assert isinstance(enhancer.reference_config, PathReferences)
        self._config, network = enhancer.reference_config, enhancer.network
        self._features = ReferenceFeatures(network) if isinstance(network, CachesReferences) else None

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of the enhanced frames in pixels."""
        camera = self.rendered.targets[0].camera
        if camera is None:
            raise InputError(self.rendered.targets[0].name, "has no camera", "render the path from a splat")
        return camera.height * self.enhancer.network.scale, camera.width * self.enhancer.network.scale

    def shown_render(self, frame: Frame) -> Float[Tensor, "3 H W"] | None:
        """A frame's render at the enhanced view's size; enlarged bicubically where that is larger."""
        return None if frame.render is None else self.enlarge(frame.render)

    def enlarge(self, image: Float[Tensor, "3 h w"]) -> Float[Tensor, "3 H W"]:
        """Enlarge an image to the enhanced view's size."""
        return upsample_bicubic(image[None], self.enhancer.network.scale)[0].clamp(0, 1)

    def __iter__(self) -> Iterator[Frame]:
        """Yield the frames in order; each is on disk when it is yielded.

        Raises:
            InputError: a frame on disk is damaged, a reference cannot be read, or a frame cannot be written.
        """
        if not self.overlapped:
            return self.write_frames(self.enhance_frames(self.draw_frames()))
        return compute_ahead(self.write_frames(compute_ahead(self.enhance_frames(compute_ahead(self.draw_frames())))))

    def draw_frames(self) -> Iterator[RenderedFrame]:
        """First stage: render each frame, or read it from disk, and read the references for the second stage.

        Raises:
            InputError: a frame on disk is damaged, or a reference cannot be read.
        """
        config = replace(self._config, kept=list(self._config.kept))  # each stage remembers its own frame
        for index, view in enumerate(self.rendered.targets):
            view = read_once(view)
            target = read_target(view) if self._needs_render(index) else None
            if self.stored[index]:
                stored_frame = self.folder.read(index), self.folder.candidates(index)
                config.kept[:] = stored_frame[1]
                yield RenderedFrame(index, view, target, stored_frame)
                continue
            if target is not None:
                for candidate in config.nearest_candidates(target, view, self.pool):
                    self.pool.read(candidate, config.fine)
            yield RenderedFrame(index, view, target, None)

    def enhance_frames(self, rendered_frames: Iterable[RenderedFrame]) -> Iterator[Frame]:
        """Second stage: enhance and smooth the frames that were not on disk.

        Args:
            rendered_frames: output of the first stage.
        """
        previous: PreviousChange | None = None
        for frame in rendered_frames:
            if frame.stored_frame is not None:
                image, candidates = frame.stored_frame
                self._config.kept[:] = candidates
            else:
                image = self._enhance(frame.view, previous)
                candidates = tuple(self._config.kept)
            target, previous = frame.target, None
            if target is not None and self.enhancer.temporal_smoothing > 0:
                previous = PreviousChange(image - target.image, target)
            render = None if target is None else target.image
            yield Frame(frame.index, image, render, candidates, frame.stored_frame is not None)

    def write_frames(self, frames: Iterable[Frame]) -> Iterator[Frame]:
        """Third stage: write new frames to the folder.

        Args:
            frames: output of the second stage.

        Raises:
            InputError: the disk is full, or the folder cannot be written.
        """
        for frame in frames:
            if not frame.stored:
                self.folder.write(frame.index, frame.enhanced, frame.candidates)
            yield frame

    def _needs_render(self, index: int) -> bool:
        """Whether a frame is rendered: to be enhanced, to be shown, or for temporal smoothing of the next frame."""
        next_is_new = index + 1 < len(self.stored) and not self.stored[index + 1]
        return not self.stored[index] or self.show_renders or (self.enhancer.temporal_smoothing > 0 and next_is_new)

    def _enhance(self, view: RenderedView, previous: PreviousChange | None) -> Float[Tensor, "3 H W"]:
        single_view = replace(self.rendered, targets=(view,))
        (enhanced,) = self.enhancer(single_view, self.planner, self.pool, self._features)
        smoothing, image = self.enhancer.temporal_smoothing, enhanced.image
        if smoothing > 0:
            image, _ = smooth_change(image, read_target(view), previous, smoothing)
        return quantise_8_bit(image)
