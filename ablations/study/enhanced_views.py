"""Held-out views of a fit, enhanced by several methods and measured against their photos.

Axes: h height, w width.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.align.alignment import AlignedReferences, LoadedView, Unwarped
from gaussian_enhancer.align.references import ReferencePool, build_network_input, read_target
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.infer.plan import Rules
from gaussian_enhancer.infer.planner import Planner
from gaussian_enhancer.metrics.lpips import PerceptualDistance
from gaussian_enhancer.metrics.pair import ImageMetrics, measure_pair
from gaussian_enhancer.scene.rendered import RenderedSet, RenderedView

ViewMethod = Callable[[RenderedView, LoadedView, ReferencePool], Float[Tensor, "3 h w"]]
"""A method that selects its references itself, from a view, the view's pixels and the training views of its set."""


@dataclass(frozen=True)
class MethodResult:
    """The result of a method on a view.

    Args:
        image: the enhanced view, of the render's size.
        aligned: the aligned references that the method received; none for a `ViewMethod`.
        measured: the metrics of the image against the photo.
    """

    image: Float[Tensor, "3 h w"]
    aligned: AlignedReferences
    measured: ImageMetrics


@dataclass(frozen=True)
class MeasuredView:
    """A held-out view with the results of several methods.

    Args:
        view: the view of the run.
        render: the raw render.
        photo: the ground truth.
        raw: the metrics of the render against the photo.
        results: by method.
    """

    view: RenderedView
    render: Float[Tensor, "3 h w"]
    photo: Float[Tensor, "3 h w"]
    raw: ImageMetrics
    results: Mapping[str, MethodResult]

    def gains(self, method: str) -> dict[str, float]:
        """The difference of each known metric to the raw render's."""
        enhanced_metrics = self.results[method].measured.metrics
        metric_pairs = {name: (before, enhanced_metrics.get(name)) for name, before in self.raw.metrics.items()}
        return {name: b - a for name, (a, b) in metric_pairs.items() if a is not None and b is not None}


def enhanced_views(
    rendered: RenderedSet,
    enhancers: Mapping[str, SetEnhancer | ViewMethod],
    distances: Sequence[PerceptualDistance] = (),
    every: int = 1,
    rules: Rules = Rules(),  # noqa: B008  (frozen values)
) -> Iterator[MeasuredView]:
    """Enhance and measure the targets of a set. Methods with equal reference configurations share aligned references.

    Args:
        rendered: held-out renders and training views.
        enhancers: by method, at the render's own resolution.
        distances: LPIPS distances that are measured as well.
        every: take every n-th target.
        rules: what a `SetEnhancer` may leave out of each view; by default nothing, which compares networks. `AUTO` of
            `gaussian_enhancer.infer.plan` leaves out references and background as ``enhance`` does by default; depth is
            not checked.

    Raises:
        InputError: a target has no photo.
    """
    pool, planners = ReferencePool(rendered.references), dict[str, Planner]()
    for name, enhancer in enhancers.items():
        if isinstance(enhancer, SetEnhancer):
            config = enhancer.reference_config
            equal = next((planner for planner in planners.values() if planner.reference_config == config), None)
            planners[name] = equal or Planner(rules, config, rendered, pool=pool)
    for view in rendered.targets[::every]:
        if view.read_photo is None:
            raise InputError(view.name, "has no photo to compare with", "give runs with held-out photos")
        target, photo = read_target(view), view.read_photo()
        aligned = {planner: _align(view, target, planner) for planner in dict.fromkeys(planners.values())}
        results: dict[str, MethodResult] = {}
        for name, enhancer in enhancers.items():
            references = aligned[planners[name]] if name in planners else Unwarped()(target, [], 0)
            if not isinstance(enhancer, SetEnhancer):
                image = enhancer(view, target, pool)
            elif planners[name](view, target).regions is None:
                image = enhancer.enhance(build_network_input(target, references))[0]
            else:
                image = next(iter(enhancer(replace(rendered, targets=(view,)), planners[name]))).image
            results[name] = MethodResult(image, references, measure_pair(image, photo, distances))
        yield MeasuredView(view, target.image, photo, measure_pair(target.image, photo, distances), results)


def _align(view: RenderedView, target: LoadedView, planner: Planner) -> AlignedReferences:
    """The aligned references of a view, of those that its plan keeps."""
    chosen = None if planner.rules.full else planner.reference_indices(planner(view, target))
    return planner.reference_config.align(target, view, planner.pool, chosen)
