"""Enhances the views of a fit together with renders of an earlier step of the same fit.

An earlier step errs differently where the photos leave a fit undetermined, and a long fit often errs more there, since
it has adapted to its own photos. Its enhanced view is used where both differ and the references decide between them.

Axes: b batch, h height, w width, i j blocks.
"""

import dataclasses
from collections.abc import Iterator, Sequence

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.align.alignment import LoadedView
from gaussian_enhancer.align.references import ReferencePool
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.enhancer import EnhancedView, SetEnhancer
from gaussian_enhancer.infer.plan import ViewPlan
from gaussian_enhancer.infer.planner import Planner
from gaussian_enhancer.infer.reference_cache import ReferenceFeatures
from gaussian_enhancer.network.network import Network
from gaussian_enhancer.scene.rendered import RenderedSet, RenderedView
from gaussian_enhancer.types import NetworkInput

DIFFERENCE = 0.02
"""Root mean squared difference of the enhanced views at which half of the earlier one's weight is used."""
BLOCK = 4
"""Side in pixels of the blocks for which shares are computed."""
DIFFERENCE_WINDOW = 3
"""Side in blocks of the windows over which that difference is averaged."""
ERROR_WINDOW = 11
"""Side in blocks of the windows over which the renders' errors, and their difference, are averaged."""
LEAST_ERROR = 1e-4
"""Added to mean squared errors, so that renders that enhancement hardly changes have equal weights."""
LEAST_DIFFERENCE = 1e-6
"""Added to mean squared differences, so that equal renders count as undecided."""
UNDECIDED, DECIDED = 0.75, 0.5
"""Shares of the renders' squared difference left after enhancement, at which none and all of the weight is used."""


class TwoStepEnhancer(SetEnhancer):
    """Enhances the views of a fit, and renders of an earlier step with the references that were aligned to the last.

    The earlier render is enhanced once, without the splat's renders of the references' views, at the render's own
    resolution. Weights that do not warp references ignore it.

    Args:
        enhancer: enhances the views; its network and options are used.
        earlier: the renders of the earlier step, with the names of the views.
    """

    def __init__(self, enhancer: SetEnhancer, earlier: Sequence[RenderedView]) -> None:
        vars(self).update(vars(enhancer))
        self._earlier = {view.name: view for view in earlier}
        self._renders: Iterator[Float[Tensor, "3 _ _"]] = iter(())

    def _enhance_each(
        self,
        rendered: RenderedSet,
        planner: Planner | None,
        pool: ReferencePool,
        features: ReferenceFeatures | None,
    ) -> Iterator[tuple[EnhancedView, LoadedView]]:
        """Enhance each target independently; yield it with the target's pixels.

        Raises:
            InputError: a view cannot be read, or the earlier step has no render of it.
        """
        for view in rendered.targets:
            earlier = self._earlier.get(view.name)
            if earlier is None or earlier.read is None:
                raise InputError(view.name, "has no render at the earlier step", "give a step with all views, or none")
            self._renders = iter([earlier.read()])
            yield from super()._enhance_each(dataclasses.replace(rendered, targets=(view,)), planner, pool, features)

    def _enhance_regions(
        self, view: RenderedView, target: LoadedView, planner: Planner, plan: ViewPlan, started: float
    ) -> EnhancedView:
        """Enhance the planned regions of a view, each as a separate image; other pixels are those of the render."""
        render, margin = next(self._renders), planner.rules.margin
        self._renders = iter([region.expand(margin, *plan.size).crop(render) for region in plan.regions or ()])
        return super()._enhance_regions(view, target, planner, plan, started)

    def enhance(
        self, views: NetworkInput, names: Sequence[str] = (), reference_features: ReferenceFeatures | None = None
    ) -> Float[Tensor, "b 3 H W"]:
        """Run the network; see `SetEnhancer.enhance`."""
        self._render = next(self._renders)
        return super().enhance(views, names, reference_features)

    def _run_limited(self, network: Network, views: NetworkInput) -> Float[Tensor, "b 3 h w"]:
        """Enhance at the render's resolution, limit the change, and combine the result with the earlier step's.

        Raises:
            InputError: the earlier step has a render of another size.
        """
        enhanced = super()._run_limited(network, views)
        render = self._render.to(views.render)[None]
        if render.shape != views.render.shape:
            raise InputError("earlier_step", "has renders of another size", "choose another step, or null")
        earlier_views = dataclasses.replace(views, render=render, reference_renders=None)
        earlier = self._limit_change(self._run(network, earlier_views), earlier_views)
        return combine_with_earlier(enhanced[0], earlier[0], views.render[0], render[0])[None]


def combine_with_earlier(
    enhanced: Float[Tensor, "3 h w"],
    earlier: Float[Tensor, "3 h w"],
    render: Float[Tensor, "3 h w"],
    earlier_render: Float[Tensor, "3 h w"],
) -> Float[Tensor, "3 h w"]:
    """The enhanced view, moved towards that of an earlier step by shares of blocks, interpolated between their centres.

    A share is the product of three factors:

    - The weight of the earlier step, (e1 E1)^2 / ((e1 E1)^2 + (e2 E2)^2). Enhancement changes a render where photos
      contradict it, so e, the estimated squared error of a render around a block, is its mean squared difference from
      the mean of both enhanced views. E is that of the whole view.
    - d^2 / (d^2 + `DIFFERENCE`^2), where d^2 is the mean squared difference of the enhanced views around a block.
      Averaging blurs detail, which is worth it only where they differ clearly.
    - Evidence: 1 where enhancement removes at least half of the renders' squared difference, and 0 where it removes at
      most a quarter, since no photo decides there.

    Args:
        enhanced: enhanced view of the last step.
        earlier: enhanced view of the earlier step.
        render: render of the last step.
        earlier_render: render of the earlier step.
    """
    middle = (enhanced + earlier) / 2
    first, second = (_weighted_error(image, middle) for image in (render, earlier_render))
    difference = _squared_difference(enhanced, earlier)
    before, after = (
        _window_mean(squared, ERROR_WINDOW) + LEAST_DIFFERENCE
        for squared in (_squared_difference(render, earlier_render), difference)
    )
    evidence = ((UNDECIDED - after / before) / (UNDECIDED - DECIDED)).clamp(0, 1)
    nearby = _window_mean(difference, DIFFERENCE_WINDOW)
    shares = first / (first + second) * nearby / (nearby + DIFFERENCE**2) * evidence
    fine = F.interpolate(shares[None], scale_factor=BLOCK, mode="bilinear", align_corners=False)[0]
    height, width = enhanced.shape[-2:]
    return torch.lerp(enhanced, earlier, fine[:, :height, :width].expand_as(enhanced))


def _weighted_error(render: Float[Tensor, "3 h w"], truth: Float[Tensor, "3 h w"]) -> Float[Tensor, "1 i j"]:
    """The square of a render's estimated squared error around each block times that of the view."""
    error = _squared_difference(render, truth)
    return ((_window_mean(error, ERROR_WINDOW) + LEAST_ERROR) * (error.mean() + LEAST_ERROR)).square()


def _squared_difference(image: Float[Tensor, "3 h w"], other: Float[Tensor, "3 h w"]) -> Float[Tensor, "1 i j"]:
    """Squared difference, averaged over the colour channels and over blocks."""
    return F.avg_pool2d((image - other).square().mean(0, keepdim=True), BLOCK, ceil_mode=True)


def _window_mean(blocks: Float[Tensor, "1 i j"], side: int) -> Float[Tensor, "1 i j"]:
    """Mean over a square window around each block, inside the image."""
    return F.avg_pool2d(blocks, side, 1, side // 2, count_include_pad=False)
