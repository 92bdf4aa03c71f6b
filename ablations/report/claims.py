"""The paper's claims, and whether our records support them.

Source of the claims: GaussianEnhancer++, Symmetry 17(3), 442, 2025, section 5 (discussion of its tables).
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from ablations.study.aims import improvement_sign
from ablations.study.description import FAITHFUL, TableDescription
from ablations.study.lines import Number, table_lines
from ablations.study.rendered_table import SPLATS
from ablations.study.results import Results
from ablations.study.statistics import interval
from gaussian_enhancer.report.quantities import quantities

VERDICTS = {True: "holds here", False: "does not", None: "undecided"}
RUNS = 3
"""Least number of repeated runs for comparing standard deviations."""


Finding = tuple[bool | None, str]
"""Whether one comparison agrees with the claim (None if undecided), and its numbers as text."""


@dataclass(frozen=True)
class Claim:
    """A claim and its verdict.

    Args:
        text: what the paper says.
        findings: the comparisons behind it.
    """

    text: str
    findings: tuple[Finding, ...]

    @property
    def verdict(self) -> str:
        """One of `VERDICTS`: "does not" if any comparison is against the claim, else "undecided" if any is open."""
        outcomes = [outcome for outcome, _ in self.findings]
        return VERDICTS[False if False in outcomes else None if None in outcomes or not outcomes else True]

    @property
    def counts_text(self) -> str:
        """The numbers of comparisons as claimed, against and open, as text."""
        outcomes = [outcome for outcome, _ in self.findings]
        against, undecided = outcomes.count(False), outcomes.count(None)
        return f"{outcomes.count(True)} of {len(outcomes)} as claimed, {against} against, {undecided} open"


def claims(tables: Sequence[Results]) -> tuple[Claim, ...]:
    """Judge the paper's claims on its own system alone: the rows whose mode is "paper".

    Args:
        tables: records of the tables.
    """
    by_name = {results.study.name: results for results in tables}
    return (
        Claim(
            "SSIF is ahead of SIF (table 10: GE with SSIF over GE)",
            tuple(_compare_methods(by_name, ("table_10",), "ge_ssif", ["ge"])),
        ),
        Claim(
            "SSIF gives more PSNR than TSDS does (table 10: GE with SSIF over GE with TSDS)",
            tuple(_compare_methods(by_name, ("table_10",), "ge_ssif", ["ge_tsds"], _psnr)),
        ),
        Claim(
            "TSDS helps SSIM and LPIPS (table 10: GE with TSDS over GE)",
            tuple(_compare_methods(by_name, ("table_10",), "ge_tsds", ["ge"], _structure)),
        ),
        Claim(
            "GE++ is ahead of every other method (tables 2, 4, 5 and 10)",
            tuple(_compare_methods(by_name, ("table_2", "table_4", "table_5", "table_10"), "gepp")),
        ),
        Claim(
            "GE is ahead of GE++ in PSNR on simple objects (table 6, the splats for which the paper has it so)",
            tuple(_compare_methods(by_name, ("table_6",), "ge", ["gepp"], _psnr, as_printed=True)),
        ),
        Claim("Standard deviations over runs are as small as the paper's (tables 7 to 9)", tuple(_deviations(by_name))),
        Claim(
            "SR is ahead of GE++ (LR) and bicubic enlargement (table 1)",
            tuple(_compare_methods(by_name, ("table_1",), "gepp_sr", ["gepp_lr_bicubic"])),
        ),
    )


def _compare_methods(
    by_name: Mapping[str, Results],
    names: Sequence[str],
    method: str,
    others: Sequence[str] | None = None,
    metric_filter: Callable[[str], bool] | None = None,
    as_printed: bool = False,
) -> Iterator[Finding]:
    """Compare a method with others in tables.

    Args:
        by_name: records by name of the table.
        names: names of the tables.
        method: the paper's name of the method.
        others: the paper's names of the methods it is compared with; None for the baseline and all others of the paper.
        metric_filter: selects metrics; None for all.
        as_printed: leave out comparisons in which the paper's own numbers do not support the claim.
    """
    for name in names:
        if name not in by_name:
            yield None, f"{name} was not made"
            continue
        results = by_name[name]
        method_row, compared_rows = FAITHFUL + method, _compared_methods(results.study, method, others)
        missing_rows = [row for row in (method_row, *compared_rows) if row not in results.study.methods]
        if missing_rows:
            yield None, f"{name} has no method {missing_rows[0]}"
            continue
        for block in results.blocks:
            for other in compared_rows:
                for metric in filter(metric_filter, results.study.metrics):
                    if not as_printed or _paper_agrees(results.study, block, method_row, other, metric):
                        yield _difference(results, block, method_row, other, metric)


def _compared_methods(table: TableDescription, method: str, others: Sequence[str] | None) -> list[str]:
    """The rows that a method of the paper is compared with: the named ones, else the baseline and all of the paper."""
    if others is not None:
        return [FAITHFUL + other for other in others]
    paper_rows = [name for name, row in table.methods.items() if row.mode == "paper" and name != FAITHFUL + method]
    return [table.baseline, *paper_rows]


def _difference(results: Results, block: str, method: str, other: str, metric: str) -> Finding:
    """One difference with its interval; decided if nothing is missing and the interval excludes zero."""
    gains = results.gains(block, method, metric, other)
    label = quantities({metric})[0].label
    context = f"{results.study.name}, {SPLATS.get(block, block)}, {method} over {other}, {label}"
    if not gains.values:
        return None, f"{context}: missing"
    low, high = interval(gains)
    ends = sorted((improvement_sign(metric) * low, improvement_sign(metric) * high))
    outcome = None if not gains.complete else True if ends[0] > 0 else False if ends[1] < 0 else None
    missing_note = (
        "" if gains.complete else f", {len(gains.missing)} of {len(gains.missing) + len(gains.values)} cells missing"
    )
    interval_text = "" if math.isnan(low) else f" [{low:+.4f}, {high:+.4f}]"
    return outcome, f"{context} {gains.mean():+.4f}{interval_text}{missing_note}"


def _deviations(by_name: Mapping[str, Results]) -> Iterator[Finding]:
    """Compare our standard deviation with the paper's, by dataset and metric."""
    for name in ("table_7", "table_8", "table_9"):
        if name not in by_name:
            yield None, f"{name} was not made"
            continue
        results = by_name[name]
        table = results.study
        for line in table_lines(results, results.records):
            if line.statistic == "std" and table.methods[line.method].mode == "paper":
                for metric, number in line.numbers.items():
                    context = f"{table.name}, {table.datasets[line.dataset].title}, {quantities({metric})[0].label}"
                    yield _compare_deviation(context, number)


def _compare_deviation(context: str, number: Number) -> Finding:
    """Whether our standard deviation is at most the paper's; undecided without the paper's or with too few runs."""
    ours, paper = number.gain, number.paper_gain
    if paper is None:
        return None, f"{context}: none printed"
    if ours is None or number.seeds < RUNS:
        return None, f"{context}: {number.seeds} runs"
    return ours <= paper, f"{context} {ours:.2g} against {paper:g} ({number.seeds} runs)"


def _paper_agrees(table: TableDescription, block: str, method: str, other: str, metric: str) -> bool:
    """Whether a method is better than another in the paper's numbers; True if the paper has none."""
    cells = table.paper.get(block, {})
    method_values, other_values = cells.get(method), cells.get(other)
    column = table.metrics.index(metric)
    return (
        method_values is None
        or other_values is None
        or improvement_sign(metric) * (method_values[column] - other_values[column]) > 0
    )


def _psnr(metric: str) -> bool:
    return metric == "psnr"


def _structure(metric: str) -> bool:
    return metric == "ssim" or metric.startswith("lpips")
