"""The page of what plans leave out, as Markdown from its records alone."""

import math
import os
import statistics
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from ablations.records.gains import VERDICTS
from gaussian_enhancer.metrics.comparison import Table
from gaussian_enhancer.metrics.records import MISSING, Record

KIND = "leaving_out"
"""Kind of the record that a plan leaves of a scene as a whole."""
RATIOS = ("times_faster", "times_faster_low", "times_faster_high")
"""Metrics of that record: how many times faster than the baseline, and between what that surely lies."""


@dataclass(frozen=True)
class Aims:
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
class Cell:
    """A plan on a scene, beside the baseline.

    Args:
        scene: the scene's name.
        plan: the plan's name.
        own: its record of the scene.
        base: the baseline's.
        costs: mean loss over views by metric, baseline minus plan; for LPIPS plan minus baseline.
        worst: largest loss of a view in PSNR, dB.
    """

    scene: str
    plan: str
    own: Record
    base: Record
    costs: dict[str, float]
    worst: float

    @property
    def ratio(self) -> float | None:
        """How many times faster than the baseline, as it was measured in turn with it; None where it was not."""
        return self.own.metrics.get(RATIOS[0])

    @property
    def between(self) -> tuple[float, float]:
        """What that ratio surely lies between; anything where it was not measured."""
        low, high = (self.own.metrics.get(name) for name in RATIOS[1:])
        return (0.0 if low is None else low), (math.inf if high is None else high)

    @property
    def background(self) -> bool:
        """Whether the scene is mostly background."""
        return bool(self.own.metrics.get("background"))

    def verdicts(self, aims: Aims) -> tuple[bool | None, bool]:
        """Whether the aims of time and of error are met; None where the machine's noise leaves it open."""
        least, (low, high) = aims.faster if self.background else aims.slower, self.between
        fast = True if low >= least else False if high < least else None
        return fast, self.costs["psnr"] <= aims.allowed


@dataclass(frozen=True)
class Section:
    """One set of scenes.

    Args:
        title: its heading.
        name: the option of the group ``worlds`` that measures it.
        records: its records; none where it was not measured.
        aims: what its shown plan is held to.
    """

    title: str
    name: str
    records: Sequence[Record]
    aims: Aims

    def cells(self, plan: str | None = None) -> tuple[Cell, ...]:
        """A plan on every scene that it was measured on; None takes the shown one."""
        return tuple(self._cells(self.aims.shown if plan is None else plan))

    def plans(self) -> tuple[str, ...]:
        """All plans but the baseline, in their order."""
        found = dict.fromkeys(record.variant for record in self.records if record.kind == KIND)
        return tuple(name for name in found if name != self.aims.baseline)

    def _cells(self, plan: str) -> Iterator[Cell]:
        scenes = {(r.scene, r.variant): r for r in self.records if r.kind == KIND}
        views = {(r.scene, r.variant, r.view): r for r in self.records if r.kind == "quality"}
        for (scene, variant), own in scenes.items():
            base = scenes.get((scene, self.aims.baseline))
            if variant != plan or base is None:
                continue
            pairs = [
                (views[scene, self.aims.baseline, v], one)
                for (s, p, v), one in views.items()
                if (s, p) == (scene, plan)
            ]
            losses = {name: _losses(pairs, name) for name in ("psnr", "psnr_aligned", "ssim", "lpips_alex")}
            costs = {name: statistics.fmean(values) for name, values in losses.items() if values}
            yield Cell(scene, plan, own, base, costs, max(losses["psnr"], default=math.nan))


def plan_study_page(
    title: str, about: str, sections: Sequence[Section], good: Sequence[Record], drawing: Path, page: Path
) -> str:
    """The whole page.

    Args:
        title: its heading.
        about: what is left out and when, Markdown.
        sections: the scenes that nothing was chosen by first.
        good: what ablations/already_good.py found; none where it was not run.
        drawing: file of the diagram.
        page: file of the page, from which links are made.
    """
    parts = [f"# {title}\n", f"{about.strip()}\n"]
    link = Path(os.path.relpath(drawing, page.parent)).as_posix()
    parts.append(f"![time and error with what is left out, against all of it]({link})\n")
    for section in sections:
        parts += _section(section)
    parts += ["## Already good\n", _already_good(good)]
    return "\n".join(parts)


def _already_good(records: Sequence[Record]) -> str:
    """By scene: what share of its blocks a predictor passes through for what is allowed, and the box that is left."""
    command = "`python -m ablations.scripts.already_good RUNS --json docs/results/already_good.jsonl`"
    if not records:
        return f"Not measured yet: {command}.\n"
    names = ("passed by predicted", "box by predicted", "passed by bound", "box by bound")
    rows = []
    for run in dict.fromkeys(record.run for record in records):
        own = [record.metrics for record in records if record.run == run]
        means = (statistics.fmean(metrics[name] or 0.0 for metrics in own) for name in names)
        rows.append((run.rsplit("-", 1)[0], str(len(own)), *(f"{mean:.0%}" for mean in means)))
    heads = ("scene", "views", "passed, predicted", "box left", "passed, best order", "box left")
    about = (
        f"{command}, training worlds. Share of the blocks that can be passed through for 0.02 dB, in the order of the "
        "errors that the references show of themselves, and in the best order, which nobody knows beforehand; and the "
        "share of the image that the rectangle around the others takes.\n"
    )
    return f"{about}\n{Table(heads, tuple(rows)).markdown()}"


def _losses(pairs: Sequence[tuple[Record, Record]], metric: str) -> list[float]:
    """What each view loses in a metric, positive where it became worse; views without a finite number are left out."""
    sign = -1.0 if metric.startswith("lpips") else 1.0
    known = ((base.metrics.get(metric), own.metrics.get(metric)) for base, own in pairs)
    return [sign * (a - b) for a, b in known if a is not None and b is not None and math.isfinite(a - b)]


def _section(section: Section) -> Iterator[str]:
    yield f"## {section.title}\n"
    command = "gaussian-enhancer plan_study" + ("" if section.name == "test" else f" worlds={section.name}")
    if not section.records:
        yield f"Not measured yet: `{command}`.\n"
        return
    yield f"Made by `{command}`, weights as shipped.\n"
    for plan in section.plans():
        cells = section.cells(plan)
        yield f"### `{plan}` against `{section.aims.baseline}`\n"
        yield 'Positive numbers under "lost" are worse; PSNR in dB.\n'
        yield cost_table(cells, section.aims).markdown()
        if plan == section.aims.shown:
            yield "What was left out:\n"
            yield _left_out(cells)
    missing = [f"- {record.scene}: {record.reasons['row']}\n" for record in section.records if record.kind == MISSING]
    yield "Missing:\n\n" + "".join(missing) if missing else "Nothing is missing.\n"
    told = [record for record in section.records if record.kind == KIND]
    if told:
        machines = "; ".join(sorted({record.machine for record in told}))
        how = "; ".join(sorted({record.protocol for record in told}))
        commits = ", ".join(sorted({record.commit for record in told}))
        yield f"Machine: {machines}. Times: {how}. Commit: {commits}.\n"


def cost_table(cells: Sequence[Cell], aims: Aims) -> Table:
    """One line a scene: times, memory, errors, whether the aims are met.

    Args:
        cells: a plan on every scene.
        aims: what it is held to.
    """
    rows = []
    for cell in cells:
        fast, good = cell.verdicts(aims)
        base, own = cell.base.metrics, cell.own.metrics
        rows.append(
            (
                cell.scene,
                f"{cell.own.size[0]}x{cell.own.size[1]}",
                f"{base['milliseconds']:.0f} → {own['milliseconds']:.0f}",
                "" if cell.ratio is None else f"{cell.ratio:.2f} ({cell.between[0]:.2f} to {cell.between[1]:.2f})",
                f"{base['peak_memory_mb']:.0f} → {own['peak_memory_mb']:.0f}",
                *(f"{cell.costs[name]:+.{d}f}" if name in cell.costs else "" for name, d in _ERRORS.items()),
                f"{cell.worst:+.3f}",
                VERDICTS[fast],
                VERDICTS[good],
            )
        )
    heads = ("scene", "size", "ms a view", "times faster", "peak MB", *(f"{name} lost" for name in _ERRORS))
    return Table((*heads, "worst view, dB", "time", "error"), tuple(rows))


_ERRORS = {"psnr": 3, "ssim": 4, "lpips_alex": 4}


def _left_out(cells: Sequence[Cell]) -> str:
    """By scene: pixels, candidates and parts that were left out, each with its reason."""
    lines = []
    for cell in cells:
        found = cell.own.metrics
        taken, left, unseeing = (
            int(found.get(f"candidates_{name}") or 0) for name in ("taken", "left_out", "unseeing")
        )
        words = [f"{found.get('passed') or 0:.0%} of the pixels (background alone)"]
        if taken + left:
            few = f"{unseeing} see too little, the others less than those taken"
            words.append(f"{left} of {taken + left} candidates ({few})")
        for name, why in cell.own.reasons.items():
            if name.startswith("part ") and found.get(name) == 0:
                words.append(f"{name.removeprefix('part ')} ({why})")
        lines.append(f"- {cell.scene}: {', '.join(words)}\n")
    return "".join(lines)
