"""Makes the page on plans, which leave out parts of the input, as Markdown from records alone."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import pandas as pd

from ablations.study.aims import VERDICTS, improvement_sign, pairs_of, ranked_losses
from ablations.study.description import MethodDescription, SceneGroup, TableDescription
from ablations.study.gains import METRICS
from ablations.study.markdown import frame, markdown
from ablations.study.plots import bar_panels
from ablations.study.results import Results
from ablations.study.row_table import read_layout, row_table
from ablations.study.rows import frame_of
from ablations.study.sections import distinct_values, missing_section, relative_link
from gaussian_enhancer.metrics.records import MISSING, Record

KIND = "leaving_out"
"""Kind of the record of a plan on a whole scene."""
RATIOS = ("times_faster", "times_faster_low", "times_faster_high")
"""Metrics of that record: speed-up over the baseline, and the ends of its interval."""
DECIMALS = {"psnr": 3, "ssim": 4, "lpips_alex": 4}


@dataclass(frozen=True)
class PlanAims:
    """The aims of the shown plan.

    Args:
        baseline: the plan that leaves nothing out.
        shown: the plan that is judged.
        faster: required speed-up on scenes that are mostly background.
        slower: required speed-up on all other scenes.
        allowed: largest allowed loss of PSNR on a scene, dB.
    """

    baseline: str
    shown: str
    faster: float
    slower: float
    allowed: float


@dataclass(frozen=True)
class PlanCost:
    """Savings and losses of a plan on one scene.

    Args:
        scene: the scene's name.
        plan_record: the plan's record of the scene.
        baseline_record: the baseline's record of the scene.
        lost: mean loss over views by metric, positive if the plan is worse.
        worst: largest loss of a view in PSNR, dB.
    """

    scene: str
    plan_record: Record
    baseline_record: Record
    lost: dict[str, float]
    worst: float

    @property
    def ratio(self) -> float | None:
        """Speed-up over the baseline, measured in turn with it; None if it was not measured."""
        return self.plan_record.metrics.get(RATIOS[0])

    @property
    def ratio_interval(self) -> tuple[float, float]:
        """The interval of the speed-up; [0, infinity] if it was not measured."""
        low, high = (self.plan_record.metrics.get(name) for name in RATIOS[1:])
        return (0.0 if low is None else low), (math.inf if high is None else high)

    def verdicts(self, aims: PlanAims) -> tuple[bool | None, bool]:
        """Whether the aims of time and of error are met; None for time if the interval contains the required ratio."""
        required = aims.faster if self.plan_record.metrics.get("background") else aims.slower
        low, high = self.ratio_interval
        fast = True if low >= required else False if high < required else None
        return fast, self.lost["psnr"] <= aims.allowed


@dataclass(frozen=True)
class PlanScenes:
    """The records of one set of scenes.

    Args:
        title: its heading.
        name: the option of the group ``worlds`` that measures it.
        records: its records; empty if it was not measured.
        aims: of its shown plan.
    """

    title: str
    name: str
    records: Sequence[Record]
    aims: PlanAims

    @cached_property
    def scene_records(self) -> dict[tuple[str, str], Record]:
        """The records of whole scenes, by scene and plan."""
        return {(record.scene, record.variant): record for record in self.records if record.kind == KIND}

    @cached_property
    def results(self) -> Results:
        """The records of single views, with plans as methods."""
        views = [record for record in self.records if record.kind == "quality"]
        plans = {record.variant: MethodDescription(record.variant) for record in self.records}
        scenes = {"scenes": SceneGroup("", tuple(dict.fromkeys(record.scene for record in self.records)))}
        return Results(
            TableDescription("plan_study", "", "quality", "", plans, self.aims.baseline, METRICS, (), scenes, ()), views
        )

    def plans(self) -> tuple[str, ...]:
        """All plans except the baseline, in the order of the records."""
        return tuple(dict.fromkeys(plan for _, plan in self.scene_records if plan != self.aims.baseline))

    def costs(self, plan: str = "") -> tuple[PlanCost, ...]:
        """Savings and losses of a plan (by default the shown one) on every scene that it was measured on."""
        return tuple(self._costs(plan or self.aims.shown))

    def _costs(self, plan: str) -> Iterator[PlanCost]:
        for (scene, name), plan_record in self.scene_records.items():
            baseline_record = self.scene_records.get((scene, self.aims.baseline))
            if name != plan or baseline_record is None:
                continue
            pairs = pairs_of(self.results, scene)
            gains = {metric: self.results.sample(pairs, plan, metric, self.aims.baseline) for metric in METRICS}
            mean_losses = {
                metric: -improvement_sign(metric) * sample.mean() + 0.0
                for metric, sample in gains.items()
                if sample.values
            }
            losses = (frame.loss for frame in ranked_losses(self.results, plan, "psnr") if frame.pair in pairs)
            yield PlanCost(scene, plan_record, baseline_record, mean_losses, next(losses, math.nan) + 0.0)


def plan_study_page(
    title: str, about: str, sets: Sequence[PlanScenes], good: Sequence[Record], drawing: Path, page: Path
) -> str:
    """The page as Markdown.

    Args:
        title: its heading.
        about: what is left out and when, Markdown.
        sets: sets of scenes; first those by which nothing was chosen.
        good: records of the job already_good; empty if it was not run.
        drawing: file of the plot.
        page: file of the page, for relative links.
    """
    parts = [f"# {title}\n", f"{about.strip()}\n"]
    parts.append(f"![time and error with what is left out, against all of it]({relative_link(drawing, page)})\n")
    parts += [part for scenes in sets for part in _parts(scenes)]
    return "\n".join([*parts, "## Already good\n", _already_good(good)])


def plan_plot(scenes: PlanScenes) -> str:
    """Bars by scene as SVG: speed-up of the shown plan, and its loss of PSNR in dB."""
    costs, aims = scenes.costs(), scenes.aims
    ratios = {cost.scene: cost.ratio or 0.0 for cost in costs}
    psnr_losses = {cost.scene: cost.lost["psnr"] for cost in costs}
    panels = [
        (f"time of {aims.baseline} / time of {aims.shown}", ratios, (1.0, aims.faster), "%.2fx"),
        ("PSNR lost, dB", psnr_losses, (0.0, aims.allowed), "%+.3f"),
    ]
    return bar_panels(f"What the plan {aims.shown} saves and costs", panels)


def cost_table(costs: Sequence[PlanCost], aims: PlanAims) -> pd.DataFrame:
    """One line per scene: times, memory, errors, whether the aims are met.

    Args:
        costs: of a plan on every scene.
        aims: of the plan.
    """
    headings = ("scene", "size", "ms a view", "times faster", "peak MB", *(f"{name} lost" for name in DECIMALS))
    return frame((*headings, "worst view, dB", "time", "error"), [_cost_line(cost, aims) for cost in costs])


def _cost_line(cost: PlanCost, aims: PlanAims) -> tuple[str, ...]:
    time_aim_met, error_aim_met = cost.verdicts(aims)
    baseline_metrics, plan_metrics = cost.baseline_record.metrics, cost.plan_record.metrics
    return (
        cost.scene,
        f"{cost.plan_record.size[0]}x{cost.plan_record.size[1]}",
        f"{baseline_metrics['milliseconds']:.0f} → {plan_metrics['milliseconds']:.0f}",
        "" if cost.ratio is None else "{:.2f} ({:.2f} to {:.2f})".format(cost.ratio, *cost.ratio_interval),
        f"{baseline_metrics['peak_memory_mb']:.0f} → {plan_metrics['peak_memory_mb']:.0f}",
        *(f"{cost.lost[name]:+.{d}f}" if name in cost.lost else "" for name, d in DECIMALS.items()),
        f"{cost.worst:+.3f}",
        VERDICTS[time_aim_met],
        VERDICTS[error_aim_met],
    )


def _parts(scenes: PlanScenes) -> Iterator[str]:
    yield f"## {scenes.title}\n"
    command = "gaussian-enhancer plan_study" + ("" if scenes.name == "test" else f" worlds={scenes.name}")
    if not scenes.records:
        yield f"Not measured yet: `{command}`.\n"
        return
    commits = ", ".join(distinct_values(record.commit for record in scenes.records))
    yield f"Made by `{command}` with the weights of commit {commits}.\n"
    for plan in scenes.plans():
        costs = scenes.costs(plan)
        yield f"### `{plan}` against `{scenes.aims.baseline}`\n"
        yield 'Positive numbers under "lost" are worse; PSNR in dB.\n'
        yield markdown(cost_table(costs, scenes.aims))
        if plan == scenes.aims.shown:
            yield "What was left out:\n"
            yield "".join(map(_left_out, costs))
    missing = ((record.scene, record.reasons["row"]) for record in scenes.records if record.kind == MISSING)
    yield missing_section(missing, "Nothing is missing.\n")
    scene_records = list(scenes.scene_records.values())
    if scene_records:
        machines = "; ".join(distinct_values(record.machine for record in scene_records))
        protocols = "; ".join(distinct_values(record.protocol for record in scene_records))
        yield f"Machine: {machines}. Times: {protocols}. Commit: {commits}.\n"


def _left_out(cost: PlanCost) -> str:
    """The pixels, candidate references and parts that were left out of a scene, with reasons."""
    metrics = cost.plan_record.metrics
    taken_count, left_out_count, unseeing_count = (
        int(metrics.get(f"candidates_{name}") or 0) for name in ("taken", "left_out", "unseeing")
    )
    items = [f"{metrics.get('passed') or 0:.0%} of the pixels (background alone)"]
    if taken_count + left_out_count:
        explanation = f"{unseeing_count} see too little, the others less than those taken"
        items.append(f"{left_out_count} of {taken_count + left_out_count} candidates ({explanation})")
    for name, reason in cost.plan_record.reasons.items():
        if name.startswith("part ") and metrics.get(name) == 0:
            items.append(f"{name.removeprefix('part ')} ({reason})")
    return f"- {cost.scene}: {', '.join(items)}\n"


def _already_good(records: Sequence[Record]) -> str:
    """By scene: share of blocks that can be passed through unchanged for 0.02 dB, and the box around the others."""
    command = "`gaussian-enhancer already_good runs=[RUNS] records=docs/results/already_good.jsonl`"
    if not records:
        return f"Not measured yet: {command}.\n"
    table = row_table(frame_of(records), read_layout("already_good"))
    table["run"] = table["run"].str.rpartition("-")[0]
    table.columns = ["scene", "views", "passed, predicted", "box left", "passed, best order", "box left"]
    about = (
        f"{command}, training worlds. Share of the blocks that can be passed through for 0.02 dB, in the order of the "
        "errors that the references show of themselves, and in the best order, which nobody knows beforehand; and the "
        "share of the image that the rectangle around the others takes.\n"
    )
    return f"{about}\n{markdown(table)}"
