"""Methods that studies apply to the held-out views of fits: the same for all fits, or one that depends on the fit.

Axes: b batch, r references, h height, w width.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from ablations.study.enhanced_views import ViewMethod
from ablations.study.fits import finished_fits, fits_by_scene, scene_of
from gaussian_enhancer.align.alignment import LoadedView
from gaussian_enhancer.align.references import ReferenceConfig, ReferencePool
from gaussian_enhancer.checkpoint import checkpoint_digest, find_checkpoint
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.earlier_step import TwoStepEnhancer
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.infer.options import EnhancementOptions
from gaussian_enhancer.infer.plan import AUTO
from gaussian_enhancer.infer.planner import Planner
from gaussian_enhancer.infer.weights import load_weights
from gaussian_enhancer.network.network import Network
from gaussian_enhancer.runs.earlier_step import choose_earlier_step
from gaussian_enhancer.scene.rendered import RenderedSet, RenderedView
from gaussian_enhancer.scene.renders import read_run, run_steps
from gaussian_enhancer.types import NetworkInput


def name_of(weights: str) -> str:
    """Name of weights in a study: the shipped name, or that of the training's folder without its digest.

    Every training writes a file of the same name. A file in no such folder is named by its own name without ending.

    Args:
        weights: shipped name or file.
    """
    path = Path(weights)
    return path.parent.name.rpartition("-")[0] or path.stem if path.suffix else weights


def load_enhancer(weights: str, options: EnhancementOptions, device: torch.device | None) -> tuple[str, SetEnhancer]:
    """The digest of weights, and their enhancer with options of the job enhance.

    Raises:
        InputError: the weights cannot be used.
    """
    pretrained = load_weights(weights)
    enhancer = options.enhancer(pretrained, pretrained.reference_config, device)
    return checkpoint_digest(find_checkpoint(weights)), enhancer


Applied = tuple[str, SetEnhancer | ViewMethod]
"""A method at a step of a fit: an identity (digest of weights, name of a second fit, or "none"), and the enhancer."""

Method = Callable[[Path, int], Applied]
"""A method of a study, as a function of a fit's folder and step."""


class Average(Network):
    """(render + sum_i visibility_i reference_i) / (1 + sum_i visibility_i): a control without parameters."""

    def __init__(self) -> None:
        super().__init__()
        self.describe({})

    def stages(self, views: NetworkInput) -> tuple[Float[Tensor, "b 3 h w"], ...]:
        """The average."""
        total = views.render + (views.visibility * views.references).sum(1)
        return (total / (1 + views.visibility.sum(1)),)


def average() -> Method:
    """The average of render and warped references, with references aligned as for the shipped weights."""
    config = ReferenceConfig()
    enhancer = SetEnhancer(Average(), config, precision="float32", colour_clamping=0, colour_completion=False)
    return lambda fit, step: ("none", enhancer)


@dataclass(frozen=True)
class FitAverage:
    """The average of two fits of a scene: of their renders of a view, or of their enhanced views.

    Args:
        first: the fit that is measured.
        second: the other fit.
        enhancer: enhances the views of both; None averages the renders.
    """

    first: RenderedSet
    second: RenderedSet
    enhancer: SetEnhancer | None = None

    def __call__(self, view: RenderedView, target: LoadedView, pool: ReferencePool) -> Float[Tensor, "3 h w"]:
        """The average.

        Args:
            view: the target.
            target: its pixels.
            pool: unused.

        Raises:
            InputError: the other fit lacks the view, or rendered it at another size.
        """
        first, second = (_image(rendered, view.name, self.enhancer) for rendered in (self.first, self.second))
        if first.shape != second.shape:
            sizes = [f"{image.shape[-1]}x{image.shape[-2]}" for image in (second, first)]
            raise InputError(view.name, f"is {sizes[0]} in the second fit, {sizes[1]} in the first", "fit both alike")
        return (first + second) / 2


def _image(rendered: RenderedSet, name: str, enhancer: SetEnhancer | None = None) -> Float[Tensor, "3 _ _"]:
    """The render of a view, or the enhanced view.

    Raises:
        InputError: the set lacks the view.
    """
    view = next((view for view in rendered.targets if view.name == name), None)
    if view is None or view.read is None:
        raise InputError(name, "was not held out by the second fit", "give a fit with the same split")
    if enhancer is None:
        return view.read()
    planner = Planner(AUTO, enhancer.reference_config, rendered)
    return next(enhancer(replace(rendered, targets=(view,)), planner)).image


def two_steps(weights: str, device: torch.device | None) -> Method:
    """A step of a fit enhanced with the earlier step that the job enhance chooses, or alone where it chooses none.

    Args:
        weights: shipped name or file.
        device: where the network runs; None is the processor.

    Raises:
        InputError: the weights cannot be used.
    """
    digest, enhancer = load_enhancer(weights, EnhancementOptions(), device)

    def method(fit: Path, step: int) -> Applied:
        earlier = choose_earlier_step("auto", fit, None, step, {})
        if earlier is None:
            return digest, enhancer
        last, both = read_run(fit, step), TwoStepEnhancer(enhancer, read_run(fit, earlier).targets)
        return digest, lambda view, target, pool: _image(last, view.name, both)

    return method


def two_fits(patterns: Sequence[str], enhancer: SetEnhancer | None = None) -> Method:
    """The average of the renders of two fits of a scene, or of their enhanced views, at the same step.

    The method refuses a step at which its scene has no second fit with the same held-out views.

    Args:
        patterns: folders of the second fits; may contain ``*``.
        enhancer: enhances the views of both fits; None averages the renders.

    Raises:
        InputError: there is none, or two are of one scene.
    """
    if not patterns:
        raise InputError("second", "names no fit", "give a second fit of each scene, or leave two_fits out")
    others = fits_by_scene(finished_fits(patterns))

    def method(fit: Path, step: int) -> Applied:
        scene = scene_of(fit)
        second_fit = others.get(scene)
        if second_fit is None or second_fit.resolve() == fit.resolve():
            raise InputError("second", f"names no other fit of {scene} than {fit}", "give one, or leave two_fits out")
        if step not in run_steps(second_fit):
            raise InputError(second_fit, f"has no renders of step {step}", "fit both with the same snapshots")
        first, second = read_run(fit, step), read_run(second_fit, step)
        missing_views = sorted({view.name for view in first.targets} - {view.name for view in second.targets})
        if missing_views:
            raise InputError(second_fit, f"did not hold out {missing_views[0]}", "give a fit with the same split")
        return second_fit.resolve().name, FitAverage(first, second, enhancer)

    return method
