"""A study's records by cell and row: mean gains with intervals, frames made worse, and whether aims are met.

A cell is one scene fitted by one method from so many views. Every cell counts alike in a scene's mean, however many
frames it has; what is missing is carried along with its reason and leaves the aims that it touches undecided.
"""

import math
import random
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from gaussian_enhancer.metrics.comparison import Pair
from gaussian_enhancer.metrics.records import HIGHER_IS_BETTER, MISSING, Record

Cell = tuple[str, str]
"""Scene and splat as records name them, for instance ("fox", "3dgs/sparse")."""


@dataclass(frozen=True)
class Aims:
    """What a study wants to show of its own rows.

    Args:
        gains: least mean improvement over the baseline, by scene and metric, in the metric's unit and its better
            direction; 0 asks for any improvement.
        ahead: metrics in which a row of ours is to be better than every other row on every scene.
        allowed: loss that a single frame may suffer, by metric.
    """

    gains: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    ahead: tuple[str, ...] = ()
    allowed: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Gain:
    """A mean improvement, in the metric's own unit and sign.

    Args:
        value: mean over cells of the mean over frames; NaN without any.
        low: lower end of the interval.
        high: upper end.
        frames: frames that count.
        cells: cells that count.
        missing: cells that do not.
        unknown: frames of those cells without a finite gain, which the mean leaves out.
    """

    value: float
    low: float
    high: float
    frames: int
    cells: int
    missing: int
    unknown: int = 0

    @property
    def whole(self) -> bool:
        """Whether nothing is missing."""
        return bool(self.cells) and not self.missing and not self.unknown

    def told(self) -> str:
        """Value, interval and what is missing, in words."""
        if not self.cells:
            return "missing"
        lacking = f"; {self.missing} of {self.cells + self.missing} cells missing" if self.missing else ""
        lacking += f"; {self.unknown} frames without it" if self.unknown else ""
        return f"{self.value:+.4f} [{self.low:+.4f}, {self.high:+.4f}]{lacking}"


@dataclass(frozen=True)
class Verdict:
    """Whether one aim is met; None where a missing cell leaves it open."""

    row: str
    scene: str
    aim: str
    found: str
    met: bool | None


VERDICTS = {True: "met", False: "**missed**", None: "open"}
"""How pages word whether an aim is met."""


class Study:
    """The records of one table.

    Args:
        records: quality records, and one of kind "missing" for every row that a cell lacks.
        baseline: the row that gains are measured over.
        others: the rows to be compared with.
        ours: the rows that the aims are about.
    """

    def __init__(
        self, records: Iterable[Record], baseline: str, others: Sequence[str] = (), ours: Sequence[str] = ()
    ) -> None:
        self.baseline, self.others, self.ours = baseline, tuple(others), tuple(ours)
        self.records: dict[tuple[Cell, str], dict[str, Record]] = {}
        self.reasons: dict[tuple[Cell, str], str] = {}
        cells: dict[Cell, None] = {}
        for record in records:
            cell = (record.scene, record.splat)
            cells[cell] = None
            if record.kind == MISSING:
                self.reasons[cell, record.variant] = record.reasons["row"]
            elif record.kind == "quality":
                self.records.setdefault((cell, record.variant), {})[record.view] = record
        self.cells = tuple(cells)
        self.scenes = tuple(dict.fromkeys(scene for scene, _ in self.cells))

    @property
    def rows(self) -> tuple[str, ...]:
        """All rows, the baseline first."""
        return (self.baseline, *self.others, *self.ours)

    def why_missing(self, cell: Cell, row: str) -> str:
        """Why a row was not measured in a cell; empty where it was."""
        if (cell, row) in self.records:
            return ""
        return self.reasons.get((cell, row), "no record")

    def of_scene(self, scene: str) -> tuple[Cell, ...]:
        """A scene's cells."""
        return tuple(cell for cell in self.cells if cell[0] == scene)

    def pairs(self, cell: Cell, row: str, over: str | None = None) -> tuple[Pair, ...]:
        """A cell's frames under the baseline (or another row) and a row; those that both have."""
        before, after = self.records.get((cell, over or self.baseline), {}), self.records.get((cell, row), {})
        return tuple(Pair(before[view], after[view]) for view in before if view in after)

    def gain(self, cells: Sequence[Cell], row: str, metric: str, over: str | None = None) -> Gain:
        """Mean gain of a row over the baseline, or over another row, with its 95% interval."""
        pairs = [self.pairs(cell, row, over) for cell in cells]
        known = [gains for members in pairs if (gains := _finite(members, metric))]
        if not known:
            return Gain(math.nan, math.nan, math.nan, 0, 0, len(pairs))
        low, high = interval(known)
        value = statistics.fmean(map(statistics.fmean, known))
        frames = sum(map(len, known))
        unknown = sum(len(members) for members in pairs if _finite(members, metric)) - frames
        return Gain(value, low, high, frames, len(known), len(pairs) - len(known), unknown)

    def worse(self, row: str, allowed: Mapping[str, float]) -> tuple[tuple[Pair, str, float], ...]:
        """Frames that lose more than is allowed, each with metric and gain, the greatest loss of a metric first."""
        found = []
        for metric, limit in allowed.items():
            frames = [(pair, loss_of(pair, metric)) for cell in self.cells for pair in self.pairs(cell, row)]
            beyond = sorted(((p, loss) for p, loss in frames if loss > limit), key=lambda entry: -entry[1])
            found += [(pair, metric, -better(metric) * loss) for pair, loss in beyond]
        return tuple(found)

    def worst(self, row: str, metric: str) -> tuple[Pair, float] | None:
        """The frame that gains least, with its gain; None where no frame is known."""
        frames = [(pair, loss_of(pair, metric)) for cell in self.cells for pair in self.pairs(cell, row)]
        known = [(pair, loss) for pair, loss in frames if math.isfinite(loss)]
        if not known:
            return None
        pair, loss = max(known, key=lambda entry: entry[1])
        return pair, -better(metric) * loss

    def verdicts(self, row: str, aims: Aims) -> tuple[Verdict, ...]:
        """Every aim for a row of ours: gains by scene, being ahead by scene, no frame made worse."""
        found = [
            self._gained(row, scene, metric, least)
            for scene in self.scenes
            for metric, least in aims.gains.get(scene, {}).items()
        ]
        found += [self._ahead(row, scene, aims.ahead) for scene in self.scenes if aims.ahead and self.others]
        found += [self._harmless(row, metric, limit) for metric, limit in aims.allowed.items()]
        return tuple(found)

    def _gained(self, row: str, scene: str, metric: str, least: float) -> Verdict:
        gain = self.gain(self.of_scene(scene), row, metric)
        improvement = better(metric) * gain.value
        met = None if not gain.whole else improvement >= least if least > 0 else improvement > 0
        wanted = f"{metric} {better(metric) * least:+g} or better" if least > 0 else f"{metric} better"
        return Verdict(row, scene, wanted, gain.told(), met)

    def _ahead(self, row: str, scene: str, metrics: Sequence[str]) -> Verdict:
        """Whether a row is better than each other row; one that is behind decides, whatever else is missing."""
        cells, behind, open_ = self.of_scene(scene), [], []
        for other in self.others:
            for metric in metrics:
                gain = self.gain(cells, row, metric, other)
                if gain.cells and not better(metric) * gain.value > 0:
                    behind.append(f"{other} ({metric} {gain.value:+.3f})")
                elif not gain.whole:
                    open_.append(other)
        met = False if behind else None if open_ else True
        told = f"behind {', '.join(behind)}" if behind else ""
        lacking = f"not compared in full with {', '.join(dict.fromkeys(open_))}" if open_ else ""
        found = "; ".join(part for part in (told, lacking) if part) or f"ahead of {', '.join(self.others)}"
        return Verdict(row, scene, f"ahead of every other row in {', '.join(metrics)}", found, met)

    def _harmless(self, row: str, metric: str, limit: float) -> Verdict:
        frames = [pair for cell in self.cells for pair in self.pairs(cell, row)]
        count = sum(loss_of(pair, metric) > limit for pair in frames)
        unknown = sum(math.isnan(loss_of(pair, metric)) for pair in frames)
        lacking = sum(bool(self.why_missing(cell, row)) for cell in self.cells)
        met = False if count else None if unknown or lacking or not frames else True
        found = f"{count} of {len(frames)} frames do"
        found += f"; {lacking} cells missing" if lacking else ""
        found += f"; {unknown} frames without it" if unknown else ""
        return Verdict(row, "all", f"no frame loses more than {limit:g} in {metric}", found, met)


def interval(gains: Sequence[Sequence[float]], resamples: int = 2000, level: float = 0.95) -> tuple[float, float]:
    """Percentile bootstrap interval of the mean over cells, with each cell's frames drawn again.

    Args:
        gains: by cell, the gains of its frames.
        resamples: number of bootstrap samples.
        level: share of the samples within the interval.
    """
    generator = random.Random(0)
    means = sorted(
        statistics.fmean(statistics.fmean(generator.choices(cell, k=len(cell))) for cell in gains)
        for _ in range(resamples)
    )
    outside = (1 - level) / 2 * (resamples - 1)
    return means[round(outside)], means[round(resamples - 1 - outside)]


def better(metric: str) -> int:
    """1 where a higher value is better, -1 where a lower one is."""
    return 1 if HIGHER_IS_BETTER[metric] else -1


def loss_of(pair: Pair, metric: str) -> float:
    """How much a frame lost, positive where it became worse; NaN where it is not known."""
    gain = pair.gain(metric)
    return math.nan if gain is None else -better(metric) * gain


def _finite(pairs: Sequence[Pair], metric: str) -> list[float]:
    gains = (pair.gain(metric) for pair in pairs)
    return [gain for gain in gains if gain is not None and math.isfinite(gain)]
