"""Views of one splat, rendered and enhanced by one network.

Axes: h height, w width, H, W the same times the network's scale.
"""

import itertools
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.align.references import ReferencePool, read_target
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.infer.planner import Planner
from gaussian_enhancer.infer.reference_cache import ReferenceFeatures
from gaussian_enhancer.network.network import CachesReferences
from gaussian_enhancer.scene.in_memory import read_once
from gaussian_enhancer.scene.neighbours import choose_references
from gaussian_enhancer.scene.rendered import RenderedSet, RenderedView
from gaussian_enhancer.types import Camera, usable_depth


@dataclass(frozen=True)
class Times:
    """Run times of a view in milliseconds.

    Args:
        rendering: rendering of the splat.
        preparing: choosing, reading and warping references.
        enhancing: inference of the network.
    """

    rendering: float
    preparing: float = 0.0
    enhancing: float = 0.0

    @property
    def total(self) -> float:
        """Sum of the run times."""
        return self.rendering + self.preparing + self.enhancing


@dataclass(frozen=True)
class StageView:
    """The view of a camera, rendered and enhanced.

    Args:
        render: the splat's colours, [0, 1].
        depth: rendered z, 0 where nothing was hit.
        alpha: rendered opacity.
        enhanced: the enhanced render; None without enhancement.
        coverage: share of the requested references that show each pixel, in [0, 1]; None without enhancement.
        references: names of the photos that were used, best first.
        times: run times.
    """

    render: Float[Tensor, "3 h w"]
    depth: Float[Tensor, "1 h w"]
    alpha: Float[Tensor, "1 h w"]
    enhanced: Float[Tensor, "3 H W"] | None
    coverage: Float[Tensor, "1 h w"] | None
    references: tuple[str, ...]
    times: Times

    @property
    def blank(self) -> bool:
        """Whether the view shows nothing of the splat: the camera looks past it, or is inside it."""
        return not bool(usable_depth(self.depth).any()) or float(self.alpha.mean()) < 1e-3


class Stage:
    """Draws the views of a splat and enhances them.

    Args:
        make_target: returns the view for a name and a camera; its pixels are rendered when they are read.
        enhancer: enhancer whose reference configuration is a `PathReferences`, so that references change rarely.
        rendered: set with the references.
        planner: decides which regions of a view are enhanced, and with which references; None enhances every pixel.
        pool: pixels of the references.
        uses_depth: whether views are enhanced with their depth.
    """

    def __init__(
        self,
        make_target: Callable[[str, Camera], RenderedView],
        enhancer: SetEnhancer,
        rendered: RenderedSet,
        planner: Planner | None,
        pool: ReferencePool,
        uses_depth: bool = True,
    ) -> None:
        self.make_target, self.enhancer, self.rendered = make_target, enhancer, rendered
        self.planner, self.pool, self.uses_depth = planner, pool, uses_depth
        enhancer.keeps_coverage, self.default_strength = True, enhancer.strength
        network = enhancer.network
        self._features = ReferenceFeatures(network) if isinstance(network, CachesReferences) else None
        self._names = map("view {}.png".format, itertools.count())

    def draw(
        self, camera: Camera, enhance: bool = True, superseded: Callable[[], bool] | None = None
    ) -> StageView | None:
        """Draw the view of a camera; None where it was superseded before it was enhanced.

        Args:
            camera: camera of the picture; the render is smaller by the network's scale.
            enhance: whether to enhance the render.
            superseded: called between rendering and enhancement; returns whether a newer view was requested.
                None if that cannot happen.

        Raises:
            InputError: a reference cannot be read.
        """
        started = time.perf_counter()
        scale = self.enhancer.network.scale
        camera = camera.resized(max(1, camera.height // scale), max(1, camera.width // scale))
        view = read_once(self.make_target(next(self._names), camera))
        pixels = read_target(view)
        if pixels.depth is None or pixels.alpha is None:
            raise ValueError("a splat's view has depth and opacity")
        rendering = 1e3 * (time.perf_counter() - started)
        fields = pixels.image, pixels.depth, pixels.alpha
        if not enhance:
            return StageView(*fields, None, None, (), Times(rendering))
        if superseded is not None and superseded():
            return None
        target = view if self.uses_depth else replace(view, read_depth=None)
        single_view = replace(self.rendered, targets=(target,))
        (enhanced,) = self.enhancer(single_view, self.planner, self.pool, self._features)
        if self.planner is not None:
            self.planner.plans.clear()  # no view is drawn twice, so its plan is not needed again
        reference_count = max(1, self.enhancer.reference_config.references)
        coverage = None if enhanced.coverage is None else (enhanced.coverage / reference_count).clamp(0, 1)
        times = Times(rendering, enhanced.preparing, enhanced.enhancing)
        return StageView(*fields, enhanced.image, coverage, enhanced.references, times)

    def nearest_photo(self, camera: Camera) -> RenderedView | None:
        """The photo nearest to a camera by position and viewing direction; None without photos.

        Args:
            camera: camera of the page.
        """
        if not self.pool.views:
            return None
        (index,) = choose_references(RenderedView("", None, camera), self.pool.views, 1)
        return self.pool.views[index]
