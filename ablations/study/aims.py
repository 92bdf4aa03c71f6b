"""The aims that a study sets for its own methods, and whether its records meet them."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from ablations.study.results import Results
from ablations.study.sample import SceneSplat, ScoreSample
from ablations.study.statistics import interval
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.metrics.records import HIGHER_IS_BETTER

VERDICTS = {True: "met", False: "**missed**", None: "open"}
"""Text of a verdict on pages, by whether the aim is met; None where missing records leave it open."""


@dataclass(frozen=True)
class Aims:
    """The aims of a study.

    Args:
        gains: least mean improvement over the baseline, by scene and metric, in the metric's unit and its better
            direction; 0 asks for any improvement.
        ahead: metrics in which a method of ours shall be better than every other method on every scene.
        allowed: largest allowed loss of a single frame, by metric.
    """

    gains: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    ahead: tuple[str, ...] = ()
    allowed: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Verdict:
    """Whether one aim is met; ``met`` is None where missing records leave it open."""

    method: str
    scene: str
    aim: str
    finding: str
    met: bool | None


@dataclass(frozen=True)
class FrameLoss:
    """The loss of one frame against the baseline.

    Args:
        pair: its scene and splat.
        view: its name.
        loss: positive if the frame became worse.
    """

    pair: SceneSplat
    view: str
    loss: float


def improvement_sign(metric: str) -> int:
    """1 if higher values of a metric are better, -1 if lower ones are.

    Raises:
        InputError: neither is better.
    """
    higher = HIGHER_IS_BETTER[metric]
    if higher is None:
        raise InputError(metric, "has no better direction", "compare another metric")
    return 1 if higher else -1


def methods_of_role(results: Results, role: str) -> tuple[str, ...]:
    """The names of the methods of a role, "ours" or "other"."""
    return tuple(name for name, method in results.study.methods.items() if method.role == role)


def pairs_of(results: Results, scene: str) -> tuple[SceneSplat, ...]:
    """The scene-splat pairs of a scene."""
    return tuple(pair for pair in results.pairs if pair[0] == scene)


def ranked_losses(results: Results, method: str, metric: str) -> list[FrameLoss]:
    """The losses of all frames against the baseline, the largest first."""
    gains = results.sample(results.pairs, method, metric, results.study.baseline)
    frame_losses = [
        FrameLoss(pair, view, -improvement_sign(metric) * gain)
        for (pair, _), views in gains.values.items()
        for view, gain in views.items()
    ]
    return sorted(frame_losses, key=lambda frame_loss: -frame_loss.loss)


def format_gain_sample(gains: ScoreSample) -> str:
    """Format a mean gain, its interval, and what is missing."""
    if not gains.values:
        return "missing"
    low, high = interval(gains)
    text = f"{gains.mean():+.4f}" + ("" if math.isnan(low) else f" [{low:+.4f}, {high:+.4f}]")
    missing_pairs, unknown_frames = gains.missing_pairs(), sum(map(len, gains.unknown.values()))
    text += f"; {missing_pairs} of {len(gains.pairs)} scene-splat pairs missing" if missing_pairs else ""
    return text + (f"; {unknown_frames} frames without it" if unknown_frames else "")


def verdicts(results: Results, method: str, aims: Aims) -> tuple[Verdict, ...]:
    """Judge every aim for a method of ours: gains by scene, being ahead by scene, no frame made worse."""
    scenes = tuple(dict.fromkeys(scene for scene, _ in results.pairs))
    judged = [
        _gain_verdict(results, method, scene, metric, required)
        for scene in scenes
        for metric, required in aims.gains.get(scene, {}).items()
    ]
    if aims.ahead and methods_of_role(results, "other"):
        judged += [_ahead_verdict(results, method, scene, aims.ahead) for scene in scenes]
    return (*judged, *(_loss_verdict(results, method, metric, limit) for metric, limit in aims.allowed.items()))


def _gain_verdict(results: Results, method: str, scene: str, metric: str, required: float) -> Verdict:
    gains = results.sample(pairs_of(results, scene), method, metric, results.study.baseline)
    improvement = improvement_sign(metric) * gains.mean()
    met = None if not gains.complete else improvement >= required if required > 0 else improvement > 0
    aim = f"{metric} {improvement_sign(metric) * required:+g} or better" if required > 0 else f"{metric} better"
    return Verdict(method, scene, aim, format_gain_sample(gains), met)


def _ahead_verdict(results: Results, method: str, scene: str, metrics: Sequence[str]) -> Verdict:
    """Whether a method is better than each other one. Being behind one of them is a miss, whatever else is missing."""
    pairs, others = pairs_of(results, scene), methods_of_role(results, "other")
    behind, incomplete = [], []
    for other in others:
        for metric in metrics:
            gains = results.sample(pairs, method, metric, other)
            if gains.values and not improvement_sign(metric) * gains.mean() > 0:
                behind.append(f"{other} ({metric} {gains.mean():+.3f})")
            elif not gains.complete:
                incomplete.append(other)
    met = False if behind else None if incomplete else True
    remarks = [f"behind {', '.join(behind)}" if behind else ""]
    remarks += [f"not compared in full with {', '.join(dict.fromkeys(incomplete))}" if incomplete else ""]
    finding = "; ".join(filter(None, remarks)) or f"ahead of {', '.join(others)}"
    return Verdict(method, scene, f"ahead of every other method in {', '.join(metrics)}", finding, met)


def _loss_verdict(results: Results, method: str, metric: str, limit: float) -> Verdict:
    gains = results.sample(results.pairs, method, metric, results.study.baseline)
    count = sum(frame_loss.loss > limit for frame_loss in ranked_losses(results, method, metric))
    missing_pairs, unknown_frames = gains.missing_pairs(), sum(map(len, gains.unknown.values()))
    met = False if count else True if gains.complete else None
    finding = f"{count} of {gains.frames + unknown_frames} frames do"
    finding += f"; {missing_pairs} scene-splat pairs missing" if missing_pairs else ""
    finding += f"; {unknown_frames} frames without it" if unknown_frames else ""
    return Verdict(method, "all", f"no frame loses more than {limit:g} in {metric}", finding, met)
