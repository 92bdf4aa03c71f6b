"""What a study wants to show of its own methods, and whether its records show it."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from ablations.study.results import Results
from ablations.study.sample import SceneSplat, ScoreSample
from ablations.study.statistics import interval
from gaussian_enhancer.metrics.records import HIGHER_IS_BETTER

VERDICTS = {True: "met", False: "**missed**", None: "open"}
"""How pages word whether an aim is met."""


@dataclass(frozen=True)
class Aims:
    """The aims of a study.

    Args:
        gains: least mean improvement over the baseline, by scene and metric, in the metric's unit and its better
            direction; 0 asks for any improvement.
        ahead: metrics in which a method of ours is to be better than every other method on every scene.
        allowed: loss that a single frame may suffer, by metric.
    """

    gains: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    ahead: tuple[str, ...] = ()
    allowed: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Verdict:
    """Whether one aim is met; None where missing records leave it open."""

    method: str
    scene: str
    aim: str
    found: str
    met: bool | None


@dataclass(frozen=True)
class FrameLoss:
    """What one frame lost against the baseline.

    Args:
        pair: its scene and splat.
        view: its name.
        loss: positive where the frame became worse.
    """

    pair: SceneSplat
    view: str
    loss: float


def better(metric: str) -> int:
    """1 where a higher value is better, -1 where a lower one is."""
    return 1 if HIGHER_IS_BETTER[metric] else -1


def by_role(results: Results, role: str) -> tuple[str, ...]:
    """The methods of a role, "ours" or "other"."""
    return tuple(name for name, method in results.study.methods.items() if method.role == role)


def pairs_of(results: Results, scene: str) -> tuple[SceneSplat, ...]:
    """A scene's pairs."""
    return tuple(pair for pair in results.pairs if pair[0] == scene)


def losses(results: Results, method: str, metric: str) -> list[FrameLoss]:
    """What every frame lost, the greatest loss first."""
    gains = results.sample(results.pairs, method, metric, results.study.baseline)
    found = [
        FrameLoss(pair, view, -better(metric) * gain)
        for (pair, _), views in gains.values.items()
        for view, gain in views.items()
    ]
    return sorted(found, key=lambda one: -one.loss)


def told(gains: ScoreSample) -> str:
    """Mean gain, interval and what is missing, in words."""
    if not gains.values:
        return "missing"
    low, high = interval(gains)
    words = f"{gains.mean():+.4f}" + ("" if math.isnan(low) else f" [{low:+.4f}, {high:+.4f}]")
    lacking, unknown = gains.missing_pairs(), sum(map(len, gains.unknown.values()))
    words += f"; {lacking} of {len(gains.pairs)} scene-splat pairs missing" if lacking else ""
    return words + (f"; {unknown} frames without it" if unknown else "")


def verdicts(results: Results, method: str, aims: Aims) -> tuple[Verdict, ...]:
    """Every aim for a method of ours: gains by scene, being ahead by scene, no frame made worse."""
    scenes = tuple(dict.fromkeys(scene for scene, _ in results.pairs))
    found = [
        _gained(results, method, scene, metric, least)
        for scene in scenes
        for metric, least in aims.gains.get(scene, {}).items()
    ]
    if aims.ahead and by_role(results, "other"):
        found += [_ahead(results, method, scene, aims.ahead) for scene in scenes]
    return (*found, *(_harmless(results, method, metric, limit) for metric, limit in aims.allowed.items()))


def _gained(results: Results, method: str, scene: str, metric: str, least: float) -> Verdict:
    gains = results.sample(pairs_of(results, scene), method, metric, results.study.baseline)
    improvement = better(metric) * gains.mean()
    met = None if not gains.whole else improvement >= least if least > 0 else improvement > 0
    wanted = f"{metric} {better(metric) * least:+g} or better" if least > 0 else f"{metric} better"
    return Verdict(method, scene, wanted, told(gains), met)


def _ahead(results: Results, method: str, scene: str, metrics: Sequence[str]) -> Verdict:
    """Whether a method is better than each other one; one that is behind decides, whatever else is missing."""
    pairs, others = pairs_of(results, scene), by_role(results, "other")
    behind, open_ = [], []
    for other in others:
        for metric in metrics:
            gains = results.sample(pairs, method, metric, other)
            if gains.values and not better(metric) * gains.mean() > 0:
                behind.append(f"{other} ({metric} {gains.mean():+.3f})")
            elif not gains.whole:
                open_.append(other)
    met = False if behind else None if open_ else True
    words = [f"behind {', '.join(behind)}" if behind else ""]
    words += [f"not compared in full with {', '.join(dict.fromkeys(open_))}" if open_ else ""]
    found = "; ".join(filter(None, words)) or f"ahead of {', '.join(others)}"
    return Verdict(method, scene, f"ahead of every other method in {', '.join(metrics)}", found, met)


def _harmless(results: Results, method: str, metric: str, limit: float) -> Verdict:
    gains = results.sample(results.pairs, method, metric, results.study.baseline)
    count = sum(one.loss > limit for one in losses(results, method, metric))
    lacking, unknown = gains.missing_pairs(), sum(map(len, gains.unknown.values()))
    met = False if count else True if gains.whole else None
    found = f"{count} of {gains.frames + unknown} frames do"
    found += f"; {lacking} scene-splat pairs missing" if lacking else ""
    found += f"; {unknown} frames without it" if unknown else ""
    return Verdict(method, "all", f"no frame loses more than {limit:g} in {metric}", found, met)
