"""The page of what plans leave out, as Markdown from its records alone."""

import math
import os
import statistics
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import pandas as pd

from ablations.study.aims import VERDICTS, better, losses
from ablations.study.description import Method, SceneGroup, TableDescription
from ablations.study.markdown import frame, markdown
from ablations.study.plots import bar_panels
from ablations.study.results import Results
from gaussian_enhancer.metrics.records import MISSING, Record

KIND = "leaving_out"
"""Kind of the record that a plan leaves of a scene as a whole."""
RATIOS = ("times_faster", "times_faster_low", "times_faster_high")
"""Metrics of that record: how many times faster than the baseline, and the ends of the ratio's interval."""
METRICS = ("psnr", "psnr_aligned", "ssim", "lpips_alex")
DECIMALS = {"psnr": 3, "ssim": 4, "lpips_alex": 4}


@dataclass(frozen=True)
class PlanAims:
    """What the shown plan is held to.

    Args:
        baseline: the plan that leaves nothing out.
        shown: the plan that is judged.
        faster: least ratio of times on scenes that are mostly background.
        slower: least ratio of times on all others.
        allowed: dB of PSNR that a scene may lose.
    """

    baseline: str
    shown: str
    faster: float
    slower: float
    allowed: float


@dataclass(frozen=True)
class PlanCost:
    """What a plan saves and costs on one scene.

    Args:
        scene: the scene's name.
        own: the plan's record of the scene.
        base: the baseline's.
        lost: mean loss over views by metric, positive where the plan is worse.
        worst: largest loss of a view in PSNR, dB.
    """

    scene: str
    own: Record
    base: Record
    lost: dict[str, float]
    worst: float

    @property
    def ratio(self) -> float | None:
        """How many times faster than the baseline, as it was measured in turn with it; None where it was not."""
        return self.own.metrics.get(RATIOS[0])

    @property
    def between(self) -> tuple[float, float]:
        """The interval of that ratio; anything where it was not measured."""
        low, high = (self.own.metrics.get(name) for name in RATIOS[1:])
        return (0.0 if low is None else low), (math.inf if high is None else high)

    def verdicts(self, aims: PlanAims) -> tuple[bool | None, bool]:
        """Whether the aims of time and of error are met; None where the machine's noise leaves it open."""
        least, (low, high) = aims.faster if self.own.metrics.get("background") else aims.slower, self.between
        fast = True if low >= least else False if high < least else None
        return fast, self.lost["psnr"] <= aims.allowed


@dataclass(frozen=True)
class PlanScenes:
    """The records of one set of scenes.

    Args:
        title: its heading.
        name: the option of the group ``worlds`` that measures it.
        records: its records; none where it was not measured.
        aims: what its shown plan is held to.
    """

    title: str
    name: str
    records: Sequence[Record]
    aims: PlanAims

    @cached_property
    def whole(self) -> dict[tuple[str, str], Record]:
        """The record of a scene as a whole, by scene and plan."""
        return {(record.scene, record.variant): record for record in self.records if record.kind == KIND}

    @cached_property
    def results(self) -> Results:
        """The errors of views: plans are the methods."""
        views = [record for record in self.records if record.kind == "quality"]
        plans = {record.variant: Method(record.variant) for record in self.records}
        scenes = {"scenes": SceneGroup("", tuple(dict.fromkeys(record.scene for record in self.records)))}
        return Results(
            TableDescription("plan_study", "", "quality", "", plans, self.aims.baseline, METRICS, (), scenes, ()), views
        )

    def plans(self) -> tuple[str, ...]:
        """All plans but the baseline, in their order."""
        return tuple(dict.fromkeys(plan for _, plan in self.whole if plan != self.aims.baseline))

    def costs(self, plan: str = "") -> tuple[PlanCost, ...]:
        """What a plan, by default the shown one, saves and costs on every scene that it was measured on."""
        return tuple(self._costs(plan or self.aims.shown))

    def _costs(self, plan: str) -> Iterator[PlanCost]:
        for (scene, name), own in self.whole.items():
            base = self.whole.get((scene, self.aims.baseline))
            if name != plan or base is None:
                continue
            pairs = tuple(pair for pair in self.results.pairs if pair[0] == scene)
            gains = {metric: self.results.sample(pairs, plan, metric, self.aims.baseline) for metric in METRICS}
            lost = {metric: -better(metric) * sample.mean() + 0.0 for metric, sample in gains.items() if sample.values}
            worst = next((one.loss for one in losses(self.results, plan, "psnr") if one.pair in pairs), math.nan) + 0.0
            yield PlanCost(scene, own, base, lost, worst)


def plan_study_page(
    title: str, about: str, sets: Sequence[PlanScenes], good: Sequence[Record], drawing: Path, page: Path
) -> str:
    """The whole page.

    Args:
        title: its heading.
        about: what is left out and when, Markdown.
        sets: the scenes that nothing was chosen by first.
        good: what the job already_good found; none where it was not run.
        drawing: file of the plot.
        page: file of the page, from which links are made.
    """
    link = Path(os.path.relpath(drawing, page.parent)).as_posix()
    parts = [f"# {title}\n", f"{about.strip()}\n"]
    parts.append(f"![time and error with what is left out, against all of it]({link})\n")
    parts += [part for scenes in sets for part in _parts(scenes)]
    return "\n".join([*parts, "## Already good\n", _already_good(good)])


def plan_plot(scenes: PlanScenes) -> str:
    """Bars by scene, as SVG: how many times faster the shown plan is, and what it costs in dB."""
    costs, aims = scenes.costs(), scenes.aims
    ratios = {cost.scene: cost.ratio or 0.0 for cost in costs}
    lost = {cost.scene: cost.lost["psnr"] for cost in costs}
    panels = [
        (f"time of {aims.baseline} / time of {aims.shown}", ratios, (1.0, aims.faster), "%.2fx"),
        ("PSNR lost, dB", lost, (0.0, aims.allowed), "%+.3f"),
    ]
    return bar_panels(f"What the plan {aims.shown} saves and costs", panels)


def cost_table(costs: Sequence[PlanCost], aims: PlanAims) -> pd.DataFrame:
    """One line a scene: times, memory, errors, whether the aims are met.

    Args:
        costs: of a plan on every scene.
        aims: what it is held to.
    """
    heads = ("scene", "size", "ms a view", "times faster", "peak MB", *(f"{name} lost" for name in DECIMALS))
    return frame((*heads, "worst view, dB", "time", "error"), [_cost_line(cost, aims) for cost in costs])


def _cost_line(cost: PlanCost, aims: PlanAims) -> tuple[str, ...]:
    fast, good = cost.verdicts(aims)
    base, own = cost.base.metrics, cost.own.metrics
    return (
        cost.scene,
        f"{cost.own.size[0]}x{cost.own.size[1]}",
        f"{base['milliseconds']:.0f} → {own['milliseconds']:.0f}",
        "" if cost.ratio is None else f"{cost.ratio:.2f} ({cost.between[0]:.2f} to {cost.between[1]:.2f})",
        f"{base['peak_memory_mb']:.0f} → {own['peak_memory_mb']:.0f}",
        *(f"{cost.lost[name]:+.{d}f}" if name in cost.lost else "" for name, d in DECIMALS.items()),
        f"{cost.worst:+.3f}",
        VERDICTS[fast],
        VERDICTS[good],
    )


def _parts(scenes: PlanScenes) -> Iterator[str]:
    yield f"## {scenes.title}\n"
    command = "gaussian-enhancer plan_study" + ("" if scenes.name == "test" else f" worlds={scenes.name}")
    if not scenes.records:
        yield f"Not measured yet: `{command}`.\n"
        return
    commits = ", ".join(sorted({record.commit for record in scenes.records}))
    yield f"Made by `{command}` with the weights of commit {commits}.\n"
    for plan in scenes.plans():
        costs = scenes.costs(plan)
        yield f"### `{plan}` against `{scenes.aims.baseline}`\n"
        yield 'Positive numbers under "lost" are worse; PSNR in dB.\n'
        yield markdown(cost_table(costs, scenes.aims))
        if plan == scenes.aims.shown:
            yield "What was left out:\n"
            yield "".join(map(_left_out, costs))
    missing = [f"- {record.scene}: {record.reasons['row']}\n" for record in scenes.records if record.kind == MISSING]
    yield "Missing:\n\n" + "".join(missing) if missing else "Nothing is missing.\n"
    found = list(scenes.whole.values())
    if found:
        machines = "; ".join(sorted({record.machine for record in found}))
        how = "; ".join(sorted({record.protocol for record in found}))
        yield f"Machine: {machines}. Times: {how}. Commit: {commits}.\n"


def _left_out(cost: PlanCost) -> str:
    """Pixels, candidates and parts that were left out of a scene, each with its reason."""
    found = cost.own.metrics
    taken, left, unseeing = (int(found.get(f"candidates_{name}") or 0) for name in ("taken", "left_out", "unseeing"))
    words = [f"{found.get('passed') or 0:.0%} of the pixels (background alone)"]
    if taken + left:
        few = f"{unseeing} see too little, the others less than those taken"
        words.append(f"{left} of {taken + left} candidates ({few})")
    for name, why in cost.own.reasons.items():
        if name.startswith("part ") and found.get(name) == 0:
            words.append(f"{name.removeprefix('part ')} ({why})")
    return f"- {cost.scene}: {', '.join(words)}\n"


def _already_good(records: Sequence[Record]) -> str:
    """By scene: what share of its blocks a predictor passes through for what is allowed, and the box that is left."""
    command = "`gaussian-enhancer already_good runs=[RUNS] records=docs/results/already_good.jsonl`"
    if not records:
        return f"Not measured yet: {command}.\n"
    names = ("passed by predicted", "box by predicted", "passed by bound", "box by bound")
    lines = []
    for run in dict.fromkeys(record.run for record in records):
        own = [record.metrics for record in records if record.run == run]
        means = (statistics.fmean(metrics[name] or 0.0 for metrics in own) for name in names)
        lines.append((run.rsplit("-", 1)[0], str(len(own)), *(f"{mean:.0%}" for mean in means)))
    heads = ("scene", "views", "passed, predicted", "box left", "passed, best order", "box left")
    about = (
        f"{command}, training worlds. Share of the blocks that can be passed through for 0.02 dB, in the order of the "
        "errors that the references show of themselves, and in the best order, which nobody knows beforehand; and the "
        "share of the image that the rectangle around the others takes.\n"
    )
    return f"{about}\n{markdown(frame(heads, lines))}"
