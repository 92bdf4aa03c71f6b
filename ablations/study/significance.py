"""Tests the significance of a table's gains: a p-value of every method against the baseline, corrected by Holm."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ablations.study.lines import ALL, Line
from ablations.study.results import Results
from ablations.study.statistics import holm, sign_flip, units_of

TestKey = tuple[str, str, str, str]
"""Block, dataset, method and metric."""


@dataclass(frozen=True)
class Significance:
    """A paired sign-flip test of a method against the baseline.

    Args:
        p: two-sided p-value; NaN below two units.
        corrected: p-value corrected by Holm over the methods and blocks of the table, by metric and dataset.
        units: number of paired means.
        unit: what one mean is taken for: "scene and seed" or "view".
    """

    p: float
    corrected: float
    units: int
    unit: str


def significance(results: Results, lines: Sequence[Line]) -> Mapping[TestKey, Significance]:
    """Test every gain of a table of means; tables of repeated runs and of cost have no tests.

    Args:
        results: the table's records.
        lines: its lines, from `table_lines`.
    """
    table = results.study
    if table.kind not in ("quality", "images"):
        return {}
    units_by_place: dict[TestKey, tuple[str, tuple[float, ...]]] = {}
    for line in lines:
        if line.method != table.baseline:
            scenes = results.scenes if line.dataset == ALL else table.datasets[line.dataset].scenes
            for metric in table.metrics:
                gains = results.gains(line.block, line.method, metric, None, scenes)
                units_by_place[line.block, line.dataset, line.method, metric] = units_of(gains)
    values = {place: sign_flip(units) for place, (_, units) in units_by_place.items()}
    families: dict[tuple[str, str], dict[TestKey, float]] = {}
    for place, value in values.items():
        families.setdefault((place[1], place[3]), {})[place] = value
    corrected = {place: value for family in families.values() for place, value in holm(family).items()}
    return {p: Significance(values[p], corrected[p], len(units), unit) for p, (unit, units) in units_by_place.items()}
